"""Quadrature points of a scene that antennas see: host side of ``quadrature.cl``, ``roughness.cl``.

E12 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from clradar.geometry.curved import corner_heights
from clradar.geometry.normals import corner_normals
from clradar.model import AntennaArray, Scene, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, build
from clradar.tracing.antenna_packets import GROUP, bundled, n_groups
from clradar.tracing.height_field import WAVES, mended_texture, wave_table
from clradar.tracing.pieces import pieces_of
from clradar.tracing.settings import SimulationSettings
from clradar.tracing.surface_samples import sampled_triangles_m
from clradar.tracing.traced_mesh import TracedMesh

TILE_POINTS = 2**17
"""Points per tile, fewer where memory is short. No result depends on it."""

PART_POINTS = 2**20
"""Most points of a part, whose lit ones are in memory at a time, with some 500 bytes for each while
they are summed."""

FRAME_ROWS = 18  # numbers of a point that its roughness needs, beside those of `LitPoints`
OUT_ROWS = 12  # numbers of a point that `LitPoints` holds as floats
NEAREST_SPACINGS = 1.5
"""Least distance between points and antennas, in spacings of the points: closer by, 1/R^2 is no
longer integrated. An antenna on the surface is at most 1.4 of them away from a point: two thirds
of the longest edge of a cell, `LONGEST`."""


@dataclass(frozen=True, slots=True)
class QuadratureOptions:
    """Options of ``quadrature.cl``."""

    width: int
    group: int = GROUP


@dataclass(frozen=True, slots=True)
class RoughnessOptions:
    """Options of ``roughness.cl``."""

    width: int


@dataclass(frozen=True, slots=True, eq=False)
class LitPoints:
    """Points that some Tx and some Rx see from the same side, in the order of their ordinals.

    `edges_m` are two edges of the triangle that a point stands for, on the smooth surface; 0 of
    rough materials, over whose triangles the phase is not linear. A point that is seen from either
    side is there twice.
    """

    position_m: np.ndarray  # (n, 3), float32: on the rough surface, from `LitQuadrature.middle_m`
    area_m2: np.ndarray  # (n, 3), float32: N dA on the side that is seen, not normalised
    edges_m: np.ndarray  # (n, 2, 3), float32
    material: np.ndarray  # (n,), int32
    sample: np.ndarray  # (n,), uint32: ordinals
    tx: np.ndarray  # (n, n_groups), uint8: Tx that see it, eight as bits of a byte
    rx: np.ndarray  # the same of Rx


def _joined(parts: list[LitPoints]) -> LitPoints:
    columns = (np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(LitPoints))
    return LitPoints(*columns)


class LitQuadrature(TracedMesh):
    """Finds the points of a scene that antennas see, tile by tile; frees its memory as a context.

    `middle_m`, float32, shape (3,), is the middle of the scene and the origin of positions;
    `n_points` are those of all sides.
    """

    def __init__(
        self, scene: Scene, array: AntennaArray, settings: SimulationSettings, device: Device
    ) -> None:
        super().__init__(device)
        self.settings, self._scene, self._array = settings, scene, array
        assert settings.samples_per_mm2 is not None, "settings are resolved"
        self._pieces = pieces_of(sampled_triangles_m(scene), settings.samples_per_mm2)
        self.n_points = self._pieces.n_points
        used = scene.vertices_m[scene.faces].reshape(-1, 3)
        self.middle_m = (0.5 * (used.min(axis=0) + used.max(axis=0))).astype(np.float32)

    def _prepare(self) -> None:
        scene, array, s, up = self._scene, self._array, self.settings, self._buffers.upload
        triangles = scene.triangles_m
        self._prepare_tree(triangles, [array.tx_m, array.rx_m])
        corners, faces = corner_normals(scene, s.normals, s.crease_deg)
        heights = np.zeros((len(faces), 3, 2))
        if s.facets == "curved":
            heights = corner_heights(triangles, corners)
        columns = [heights, corners, faces]
        del heights, corners, faces
        # One after the other, since those of a body take hundreds of megabytes.
        later = [up(columns.pop(0).astype(np.float32)) for _ in range(3)]
        relative = triangles - self.middle_m.astype(np.float64)
        self._surface = [up(relative.astype(np.float32)), *later]
        del relative
        body_m = scene.vertices_m if scene.texture_m is None else scene.texture_m
        texture_m = body_m[scene.faces]
        if any(material.roughness_rms_m > 0 for material in scene.materials):
            texture_m = mended_texture(triangles, texture_m)
        self._texture = up(texture_m.astype(np.float32))
        p = self._pieces
        self._cuts = [up(column) for column in (p.start, p.face, p.corners, p.edge_points)]
        width = self.device.width
        self._program = build(self.device, "quadrature.cl", QuadratureOptions(width))
        self._roughness = build(self.device, "roughness.cl", RoughnessOptions(width))
        self._waves = [
            (index, material.roughness_rms_m, up(self._wave_table(index)))
            for index, material in enumerate(scene.materials)
            if material.roughness_rms_m > 0
        ]
        self._sides = [
            _Side(self, at_m, self.middle_m.astype(np.float64)) for at_m in (array.tx_m, array.rx_m)
        ]
        self._size_tiles()

    def _wave_table(self, index: int) -> np.ndarray:
        material = self._scene.materials[index]
        length_m = material.correlation_length_m
        assert length_m is not None, "checked by Material"
        seed = self.settings.seed
        return wave_table(self._roughness, self._buffers, seed, material.name, length_m)

    def _size_tiles(self) -> None:
        groups = sum(side.groups for side in self._sides)
        lit = 4 * (OUT_ROWS + FRAME_ROWS + 3)
        per_point = 4 * 12 + 2 * groups + 8 + 4 + 2 * lit
        room = min(self._buffers.free_bytes // 2 // per_point, self.device.max_buffer_bytes // 160)
        self._tile_points = int(max(1, min(TILE_POINTS, self.n_points, room)))
        n = self._tile_points
        self._vectors = [self._buffers.empty(12 * n) for _ in range(4)]
        self._nearest = self._buffers.empty(4 * n)
        for side in self._sides:
            side.allocate(n)

    def lit_parts(self, progress: Progress | None = None) -> Iterator[LitPoints]:
        """Yield the points that some Tx and some Rx see, in parts of all points of equal size.

        Raises
        ------
        ModelError
            An antenna is on the surface.
        """
        n_parts = -(-self.n_points // PART_POINTS)
        ends = [i * self.n_points // n_parts for i in range(n_parts + 1)]
        for first, stop in pairwise(ends):
            tiles = []
            for at in range(first, stop, self._tile_points):
                count = min(self._tile_points, stop - at)
                tiles.append(self._tile(at, count))
                if progress is not None:
                    progress(at + count, self.n_points)
            yield _joined(tiles)

    def lit_points(self) -> LitPoints:
        """Return the points of all parts as one."""
        return _joined(list(self.lit_parts()))

    def _tile(self, first: int, count: int) -> LitPoints:
        u = np.uint32
        flat, geometric, point, normal = self._vectors
        n_pieces, middle = u(len(self._pieces.face)), np.append(self.middle_m, np.float32(0))
        self._program.launch(
            "quadrature_points", (count,), n_pieces, u(first), u(count), middle, *self._cuts,
            *self._surface, flat, geometric, point, normal,
        )  # fmt: skip
        for i, side in enumerate(self._sides):
            self._find_visible(count, flat, geometric, side.n_antennas, side.bundles, side.front)
            self._program.launch(
                "sides_seen", (count,), u(count), u(side.groups), u(i == 0), side.columns, point,
                normal, geometric, side.front, side.back, side.count, self._nearest,
            )  # fmt: skip
        self._check_distance(count)
        tx, rx = self._sides
        seen = (tx.counts(count) > 0) & (rx.counts(count) > 0)
        which, back = np.nonzero(seen)
        columns = [side.bits(count, which, back) for side in self._sides]
        sample = (first + which).astype(np.uint32)
        material = self._material_of(sample)
        vectors = self._displaced(sample, back, material)
        position_m, area_m2, edges_m = (
            np.ascontiguousarray(part) for part in (vectors[:, 0], vectors[:, 1], vectors[:, 2:])
        )
        for index, _, _ in self._waves:
            edges_m[material == index] = 0.0
        return LitPoints(position_m, area_m2, edges_m, material, sample, *columns)

    def _check_distance(self, count: int) -> None:
        nearest_m = float(np.sqrt(self._buffers.read(self._nearest, count, np.float32).min()))
        assert self.settings.samples_per_mm2 is not None
        least_m = NEAREST_SPACINGS * 1e-3 / np.sqrt(self.settings.samples_per_mm2)
        if nearest_m < least_m:
            checks.fail(
                "simulate: array",
                f"antennas at least {1e3 * least_m:.2g} mm (1.5 times the spacing of the points) "
                "away from the surface with estimator='physical'",
                f"one at {1e3 * nearest_m:.2g} mm; move it, or take more samples_per_mm2",
            )

    def _material_of(self, sample: np.ndarray) -> np.ndarray:
        piece = np.searchsorted(self._pieces.start, sample, side="right") - 1
        return np.asarray(self._scene.material)[self._pieces.face[piece]].astype(np.int32)

    def _displaced(self, sample: np.ndarray, back: np.ndarray, material: np.ndarray) -> np.ndarray:
        """Return positions and N dA of lit points with their roughness, and edges: (n, 4, 3)."""
        n, width, u = len(sample), self.device.width, np.uint32
        if n == 0:
            return np.empty((0, 4, 3), np.float32)
        padded = -(-n // width) * width
        fill = (0, padded - n)
        buffers = self._buffers
        samples = buffers.upload(sample)
        side = buffers.upload((1.0 - 2.0 * back).astype(np.float32))
        materials = buffers.upload(np.pad(material, fill, constant_values=-1))
        out, frame = (buffers.zeros(4 * n_rows * padded) for n_rows in (OUT_ROWS, FRAME_ROWS))
        self._program.launch(
            "lit_points", (n,), u(len(self._pieces.face)), u(n), u(padded), *self._cuts,
            *self._surface, self._texture, samples, side, out, frame,
        )  # fmt: skip
        for index, rms_m, waves in self._waves:
            self._roughness.launch(
                "roughen", (padded // width,), u(padded), u(WAVES), np.int32(index),
                np.float32(rms_m * np.sqrt(2.0 / WAVES)), materials, waves, out, frame,
                work=40.0 * WAVES,
            )  # fmt: skip
        rows = buffers.read(out, (OUT_ROWS, padded), np.float32)[:, :n]
        for buffer in (samples, side, materials, out, frame):
            buffers.release(buffer)
        return rows.T.reshape(n, 4, 3)


class _Side:
    """The antennas of one side, Tx or Rx, and what of a tile they see."""

    def __init__(self, surface: LitQuadrature, at_m: np.ndarray, middle_m: np.ndarray) -> None:
        self.n_antennas, self.groups = len(at_m), n_groups(len(at_m))
        self._buffers = surface._buffers
        self.bundles = self._buffers.upload(bundled(at_m))
        relative = (at_m - middle_m).astype(np.float32)
        padded = relative[np.minimum(np.arange(GROUP * self.groups), len(at_m) - 1)]
        self.columns = self._buffers.upload(np.ascontiguousarray(padded.T))
        self.front: Any = None
        self.back: Any = None
        self.count: Any = None

    def allocate(self, n_points: int) -> None:
        self.front, self.back = (self._buffers.empty(self.groups * n_points) for _ in range(2))
        self.count = self._buffers.empty(8 * n_points)

    def counts(self, n_points: int) -> np.ndarray:
        """How many antennas see the front and the back of each point, shape (n_points, 2)."""
        return self._buffers.read(self.count, (n_points, 2), np.uint32)

    def bits(self, n_points: int, which: np.ndarray, back: np.ndarray) -> np.ndarray:
        """The antennas that see one side of some points, shape (n, groups)."""
        read, shape = self._buffers.read, (n_points, self.groups)
        front = read(self.front, shape, np.uint8)[which]
        if not back.any():
            return front
        return np.where(back[:, None] == 0, front, read(self.back, shape, np.uint8)[which])
