"""Monte Carlo tracing of receptions: host side of ``trace.cl``.

The model is that of J. Braeunig et al., "A Realistic Radar Ray Tracing Simulator for Hand Pose
Imaging", EuRAD 2023; E3 to E6 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clradar.geometry.bvh import TraversalOptions
from clradar.model import TraceStatistics
from clradar.model.progress import Progress
from clradar.opencl import build
from clradar.opencl.double_single import antenna_rows
from clradar.tracing.antenna_packets import GROUP
from clradar.tracing.lit_surface import TILE_SAMPLES, LitSurface

RECEPTION_BYTES = 8 + 16
"""Device memory per reception: key and path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceOptions(TraversalOptions):
    """Options of ``trace.cl``."""

    width: int = 1
    nvidia_registers: ClassVar[int] = 144  # 96 spill
    spreading: bool
    group: int = GROUP


@dataclass(frozen=True, slots=True, eq=False)
class Receptions:
    """Receptions of one tile, sorted by pair, then sample, ray and bounce.

    Attributes
    ----------
    pair : ndarray, shape (n,), uint32
    length_m : ndarray, shape (n,), float64, metres
    amplitude : ndarray, shape (n,), float32
    bounces : ndarray, shape (n,), uint8
    face : ndarray, shape (n,), int32
        Of the first reflection.
    statistics : TraceStatistics
    """

    pair: np.ndarray
    length_m: np.ndarray
    amplitude: np.ndarray
    bounces: np.ndarray
    face: np.ndarray
    statistics: TraceStatistics


class Tracer(LitSurface):
    """Traces random rays from the illuminated samples, tile by tile."""

    def _prepare_rays(self) -> None:
        array, up = self.array, self._buffers.upload
        self._surface = [*self._sampling[2:4], up(self._face_alpha)]
        self._antennas = [up(antenna_rows(at)) for at in (array.tx_m, array.rx_m)]
        self._box = self._reception_box()
        self._counter = self._buffers.zeros(12)
        spreading = self.settings.amplitude == "spreading"
        options = TraceOptions(**self._tree.traversal, spreading=spreading)
        self._trace = build(self.device, "trace.cl", options)

    def _size_tiles(self) -> None:
        """Divide the free memory between samples and receptions."""
        per_sample = 4 * 12 + 4 + 4 + self._n_tx_groups
        free = min(self._buffers.free_bytes, 8 * self.device.max_buffer_bytes)
        # Neither a ray's ordinal nor the count of receptions in a tile may exceed 32 bits.
        rays = self._rays_per_sample * self.settings.max_bounces
        most = max(1, (2**32 - 1) // (rays * self.array.n_tx * self.array.n_rx))
        wanted = min(TILE_SAMPLES, self.n_samples, most, max(1, free // 4 // per_sample))
        self._tile_samples = int(wanted)
        self._tile = self._sample_buffers(self._tile_samples)
        self._keys = self._paths = None
        self._capacity = 0
        self._grow(max(1, min(64 * wanted, self._most_receptions())))

    def _most_receptions(self) -> int:
        """How many receptions fit into free memory and their present buffers."""
        held = self._capacity * RECEPTION_BYTES
        room = (self._buffers.free_bytes + held) // RECEPTION_BYTES
        return int(min(room, self.device.max_buffer_bytes // 16, 2**32 - 1))

    def _grow(self, capacity: int) -> None:
        for buffer in (self._keys, self._paths):
            if buffer is not None:
                self._buffers.release(buffer)
        self._keys = self._paths = None
        self._capacity = 0
        self._keys = self._buffers.empty(8 * capacity)
        self._paths = self._buffers.empty(16 * capacity)
        self._capacity = capacity

    def tiles(self, progress: Progress | None = None) -> Iterator[Receptions]:
        """Yield the receptions of all samples, tile by tile, in the order of samples."""
        for _, tile in self.tiles_of([self._face_alpha], progress):
            yield tile

    def tiles_of(
        self, alphas: Sequence[np.ndarray], progress: Progress | None = None
    ) -> Iterator[tuple[int, Receptions]]:
        """As `tiles` for several alphas: yields the index of the alpha and its receptions.

        Samples and their visibility are found once for all. Each of `alphas` has shape (n_faces,),
        float32; the receptions of each come in the order of samples.
        """
        first = 0
        while first < self.n_samples:
            count = min(self._tile_samples, self.n_samples - first)
            yield from self._tile_of(first, count, list(enumerate(alphas)))
            first += count
            if progress is not None:
                progress(first, self.n_samples)

    def _tile_of(
        self, first: int, count: int, alphas: list[tuple[int, np.ndarray]]
    ) -> Iterator[tuple[int, Receptions]]:
        faces, n_visible = self._illuminate(first, count)
        for at, (index, alpha) in enumerate(alphas):
            received, outgoing, absorbed = self._send(first, count, faces, alpha)
            if received > self._capacity:
                if received > self._most_receptions() and count > 1:
                    half = self._tile_samples = count // 2
                    yield from self._tile_of(first, half, alphas[at:])
                    yield from self._tile_of(first + half, count - half, alphas[at:])
                    return
                self._grow(received)  # raises where one sample alone does not fit
                received, outgoing, absorbed = self._send(first, count, faces, alpha)
            statistics = TraceStatistics(count, n_visible, outgoing, absorbed)
            yield index, self._collect(received, faces, statistics)

    def _send(
        self, first: int, count: int, faces: np.ndarray, face_alpha: np.ndarray
    ) -> tuple[int, int, int]:
        """Trace the rays of a tile; returns how many receptions, outgoing and absorbed draws."""
        s, array = self.settings, self.array
        u = np.uint32
        ground, shading, geometric, _, alpha, visible, points = self._tile
        items = self._n_tx_groups if self._tree.wide else array.n_tx
        self._buffers.write(alpha, face_alpha[faces])
        self._buffers.write(self._surface[2], face_alpha)
        self._buffers.write(self._counter, np.zeros(3, np.uint32))
        self._trace.launch(
            "trace_rays", (items, count), u(count), u(array.n_tx), u(array.n_rx),
            u(self._n_tx_groups), u(self._n_rx_groups), u(self._rays_per_sample), u(s.max_bounces),
            u(first), *self._seed_words(), np.float32(s.reception_radius_m),
            np.float32(s.pattern_exponent), self._tree.delta_m, *self._box, u(self._capacity),
            *self._tree.buffers, *self._surface, *self._antennas, self._rx_bundles, ground,
            shading, geometric, points, alpha, visible, self._counter, self._keys, self._paths,
        )  # fmt: skip
        received, outgoing, absorbed = self._buffers.read(self._counter, 3, np.uint32)
        return int(received), int(outgoing), int(absorbed)

    def _reception_box(self) -> list[np.ndarray]:
        """Corners of the box around all receivers' spheres, float4, padded for rounding."""
        pad = self.settings.reception_radius_m * (1 + 1e-5) + float(self._tree.delta_m)
        corners = (self.array.rx_m.min(axis=0) - pad, self.array.rx_m.max(axis=0) + pad)
        return [np.append(corner, 0.0).astype(np.float32) for corner in corners]

    def _collect(self, found: int, faces: np.ndarray, statistics: TraceStatistics) -> Receptions:
        keys = self._buffers.read(self._keys, found, np.uint64)
        paths = self._buffers.read(self._paths, (found, 4), np.float32)
        order = np.argsort(keys)  # keys are unique, so any sort gives the same order
        keys, paths = keys[order], np.take(paths, order, axis=0)
        within = keys & 0xFFFFFFFF
        most = self.settings.max_bounces
        return Receptions(
            pair=(keys >> 32).astype(np.uint32),
            length_m=paths[:, 0].astype(np.float64) + paths[:, 1],
            amplitude=np.ascontiguousarray(paths[:, 2]),
            bounces=(within % most + 1).astype(np.uint8),
            face=faces[within // (self._rays_per_sample * most)],
            statistics=statistics,
        )
