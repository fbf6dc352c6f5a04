"""Stratified surface samples of a scene and their visibility from the transmitters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from clradar.errors import MeshError
from clradar.geometry.bvh import build_bvh, error_bound_m, face_normals, flatten
from clradar.geometry.normals import corner_normals
from clradar.model import AntennaArray, Scene, checks
from clradar.opencl import Buffers, Device, build
from clradar.tracing.antenna_packets import GROUP, bundled, items
from clradar.tracing.settings import SimulationSettings

TILE_SAMPLES = 16384
"""Samples per tile, fewer where memory is short. No result depends on it."""

Lit = TypeVar("Lit", bound="LitSurface")


@dataclass(frozen=True, slots=True)
class _SampleOptions:
    width: int


@dataclass(frozen=True, slots=True)
class _VisibilityOptions:
    width: int
    stack: int


def samples_per_face(scene: Scene, settings: SimulationSettings) -> np.ndarray:
    """Return how many samples each face gets, shape (n_faces,), int64.

    By density: face f gets the whole numbers between the running areas before and after it, so that
    the total is right to one sample whatever the tessellation. Faces without area get none.
    """
    area_mm2 = face_normals(scene.triangles_m)[1] * 1e6
    if not (area_mm2 > 0).any():
        raise MeshError("scene: expected at least one face with an area, got only degenerate faces")
    if settings.rays_per_face is not None:
        return np.where(area_mm2 > 0, settings.rays_per_face, 0).astype(np.int64)
    assert settings.samples_per_mm2 is not None
    # The offset of one half keeps a scene smaller than one sample from getting none at random.
    running = np.floor(np.cumsum(area_mm2) * settings.samples_per_mm2 + 0.5)
    counts = np.diff(running, prepend=0.0).astype(np.int64)
    if counts.sum() == 0:
        counts[int(area_mm2.argmax())] = 1
    return counts


class LitSurface:
    """A scene and an array on a device: samples of the surface, and which Tx see them.

    A context manager: its device memory is freed when the block ends. What follows from the samples
    is up to those that inherit.
    """

    def __init__(
        self, scene: Scene, array: AntennaArray, settings: SimulationSettings, device: Device
    ) -> None:
        self.array, self.settings, self.device = array, settings, device
        assert settings.rays_per_sample is not None, "settings are resolved"
        self._rays_per_sample = settings.rays_per_sample
        counts = samples_per_face(scene, settings)
        self.n_samples = int(counts.sum())
        if self.n_samples >= 2**31:
            raise MeshError(
                f"scene: expected fewer than 2^31 samples, got {self.n_samples}; lower "
                f"samples_per_mm2 or rays_per_face, or check the unit of the mesh"
            )
        if array.n_tx * array.n_rx >= 2**32:
            checks.fail("array", "fewer than 2^32 pairs", f"{array.n_tx} x {array.n_rx}")
        self._scene = scene
        self._face_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
        self._buffers = Buffers(device)
        self._tile_samples = 0
        self._tile: list[Any] = []

    def __enter__(self: Lit) -> Lit:
        try:
            self._prepare()
        except BaseException:
            self._buffers.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        self._buffers.__exit__(None, None, None)

    def _prepare(self) -> None:
        scene, array, device, up = self._scene, self.array, self.device, self._buffers.upload
        triangles = scene.triangles_m
        bvh = build_bvh(triangles, device)
        self._delta = np.float32(error_bound_m(triangles, array.tx_m, array.rx_m))
        nodes, records, stack = flatten(bvh, triangles, float(self._delta))
        corners, faces = corner_normals(scene, self.settings.normals, self.settings.crease_deg)
        alpha = np.asarray(scene.alpha, dtype=np.float32)
        self._sampling = [
            up(self._face_start),
            up(triangles.astype(np.float32)),
            up(corners.astype(np.float32)),
            up(faces.astype(np.float32)),
        ]
        self._tree = [up(nodes), up(records)]
        self._face_alpha = alpha
        self._n_tx_groups = -(-array.n_tx // GROUP)
        self._n_rx_groups = -(-array.n_rx // GROUP)
        self._tx_soa = up(bundled(array.tx_m))
        out_of_reach = array.rx_m.max(axis=0) + 1e3 + self.settings.reception_radius_m * 10
        self._rx_soa = up(bundled(array.rx_m, out_of_reach))
        self._sample = build(device, "sample.cl", _SampleOptions(1))
        self._visibility = build(device, "visibility.cl", _VisibilityOptions(device.width, stack))
        self._prepare_rays(stack)
        self._size_tiles()

    def _prepare_rays(self, stack: int) -> None:
        """Upload and build what comes after the samples; `stack` is what a traversal needs."""
        raise NotImplementedError

    def _size_tiles(self) -> None:
        """Set `_tile_samples` and `_tile`, and take what memory is needed per tile."""
        raise NotImplementedError

    def _sample_buffers(self, count: int) -> list[Any]:
        """Buffers for points, shading and face normals, faces, alpha and visible Tx."""
        lengths = (12, 12, 12, 4, 4, self._n_tx_groups)
        return [self._buffers.empty(length * count) for length in lengths]

    def _see(self, first: int, count: int) -> tuple[np.ndarray, int]:
        """Make the samples and ask which Tx see them; return their faces, and how many do."""
        u = np.uint32
        points, shading, geometric, face, _, visible = self._tile
        self._sample.launch(
            "sample_surface", (count,), u(len(self._face_start) - 1), u(first), u(count),
            *self._seed_words(), *self._sampling, points, shading, geometric, face,
        )  # fmt: skip
        self._visibility.launch(
            "visible_antennas", items(self.device, count, self._n_tx_groups), u(count),
            u(self.array.n_tx), u(self._n_tx_groups), self._delta, *self._tree, self._tx_soa,
            points, geometric, visible,
        )  # fmt: skip
        bits = self._buffers.read(visible, count * self._n_tx_groups, np.uint8)
        return self._buffers.read(face, count, np.int32), int(np.unpackbits(bits).sum())

    def _seed_words(self) -> tuple[np.uint32, np.uint32]:
        seed = self.settings.seed
        return np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32)
