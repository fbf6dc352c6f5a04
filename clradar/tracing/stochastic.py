"""Monte Carlo tracing of receptions: host side of ``trace.cl``.

The model is that of J. Braeunig et al., "A Realistic Radar Ray Tracing Simulator for Hand Pose
Imaging", EuRAD 2023; E3 to E6 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.geometry.bvh import RAY_WORK, TraversalOptions
from clradar.model import TraceStatistics
from clradar.model.progress import Progress
from clradar.opencl import build
from clradar.opencl.buffers import antenna_rows
from clradar.tracing.antenna_packets import GROUP
from clradar.tracing.lit_surface import TILE_SAMPLES, LitSurface, Receptions

APPENDED_BYTES, SORTED_BYTES = 8 + 16, 4 + 4 + 4 + 8 + 4
"""Device memory per reception: key and path as they are appended; within and source, then place,
length and amplitude."""

MOST_BINS = 2**17
"""Bins of all pairs into which the receptions of a tile are counted, but eight per pair at least,
since an item goes through all receptions of its bin."""

FEWEST_KEYS = 32  # receptions that a bin can hold where there are as many bins as are of use
SHARE = 512  # receptions that an item brings into order on a CPU
LISTED_BYTES = 64  # device memory of a ray of a list
MOST_LISTED = 2**19
"""Rays that are drawn at a time; fewer where memory is short. No result depends on it."""

MOST_ORDINAL = 2**32 - 1  # of a ray, and of a reception in a tile

LISTS = 64  # lists that are drawn until their counters are set back
CPU_ITEMS = 64  # items that share a list on a CPU


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceOptions(TraversalOptions):
    """Options of ``trace.cl``."""

    spreading: bool
    group: int = GROUP


@dataclass(frozen=True, slots=True)
class OrderOptions:
    """Options of ``receptions.cl``."""

    width: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class PathColumns:
    """Receptions of one tile on the host, (n,), sorted by pair, then sample, ray and bounce."""

    pair: np.ndarray  # uint32
    length_m: np.ndarray  # float64
    amplitude: np.ndarray  # float32
    bounces: np.ndarray  # uint8
    face: np.ndarray  # int32: of the first reflection


class Tracer(LitSurface):
    """Traces random rays from the illuminated samples, tile by tile."""

    def _prepare_rays(self) -> None:
        array, up = self.array, self._buffers.upload
        self._surface = [*self._sampling[2:4], up(self._face_alpha)]
        # No ray meets padding of the receivers; that of the Tx is not visible.
        self._antennas = [up(_columns(array.tx_m, 0.0)), up(_columns(array.rx_m, np.nan))]
        self._box = self._reception_box()
        self._longest = self._longest_m(self.settings.max_bounces)
        spreading = self.settings.amplitude == "spreading"
        options = TraceOptions(width=self.device.width, **self._tree.traversal, spreading=spreading)
        self._trace = build(self.device, "trace.cl", options)
        self._order = build(self.device, "receptions.cl", OrderOptions())

    def _size_tiles(self) -> None:
        """Divide the free memory between samples and receptions."""
        per_sample = 4 * 12 + 4 + 4 + self._n_tx_groups
        free = min(self._room_bytes, 8 * self.device.max_buffer_bytes)
        rays = self._rays_per_sample * self.settings.max_bounces
        most = max(1, MOST_ORDINAL // (rays * self.array.n_tx * self.array.n_rx))
        wanted = min(TILE_SAMPLES, self.n_samples, most, max(1, free // 4 // per_sample))
        self._tile_samples = int(wanted)
        self._tile = self._sample_buffers(self._tile_samples)
        n_pairs = self.array.n_tx * self.array.n_rx
        most = max(1, min(max(MOST_BINS, 8 * n_pairs), free // 64) // n_pairs)
        bins = min(most, -(-self._tile_samples * rays // FEWEST_KEYS))
        self._bin_samples = -(-self._tile_samples // bins)
        self._n_bins = -(-self._tile_samples // self._bin_samples)
        self._tally = self._buffers.empty(4 * (3 + n_pairs * self._n_bins))
        self._starts = self._buffers.empty(4 * (n_pairs * self._n_bins + 1))
        lists = min(2, self.settings.max_bounces)
        drawn = self._tile_samples * self.array.n_tx * self._rays_per_sample
        listed = min(MOST_LISTED, drawn, free // 4 // (lists * LISTED_BYTES))
        self._listed = max(listed, self.array.n_tx)
        self._lists = [self._buffers.empty(LISTED_BYTES * self._listed) for _ in range(lists)]
        self._fresh = np.zeros(LISTS * self.settings.max_bounces, np.uint32)
        self._n_listed = self._buffers.empty(self._fresh.nbytes)
        self._appended: list[Any] = []
        self._sorted: list[Any] = []
        self._capacity = 0
        self._grow(max(1, min(64 * wanted, self._most_receptions())))

    def _most_receptions(self) -> int:
        """How many receptions fit into free memory and their present buffers."""
        each = APPENDED_BYTES + SORTED_BYTES
        room = (self._room_bytes + self._capacity * each) // each
        return int(min(room, self.device.max_buffer_bytes // 16, MOST_ORDINAL))

    def _grow(self, capacity: int) -> None:
        for buffer in (*self._appended, *self._sorted):
            self._buffers.release(buffer)
        self._capacity, self._appended, self._sorted = 0, [], []
        # The phasor sum reads eight paths at a time.
        least, buffers = max(8, capacity), self._buffers
        self._appended = [buffers.empty(n * least) for n in (8, 16)]
        self._sorted = [buffers.empty(4 * least) for _ in range(3)]
        self._sorted += [buffers.zeros(n * least) for n in (8, 4)]
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
        faces, visible = self._illuminate(first, count)
        for at, (index, alpha) in enumerate(alphas):
            received, outgoing, absorbed = self._send(first, visible, faces, alpha)
            if received > self._capacity:
                if received > self._most_receptions() and count > 1:
                    half = self._tile_samples = count // 2
                    yield from self._tile_of(first, half, alphas[at:])
                    yield from self._tile_of(first + half, count - half, alphas[at:])
                    return
                self._grow(received)  # raises where one sample alone does not fit
                received, outgoing, absorbed = self._send(first, visible, faces, alpha)
            self._faces = faces
            start = self._sort(received)
            statistics = TraceStatistics(count, int(visible.sum()), outgoing, absorbed)
            length, amplitude = self._sorted[3:]
            yield index, Receptions(start, length, amplitude, self._longest, statistics)

    def _send(
        self, first: int, visible: np.ndarray, faces: np.ndarray, face_alpha: np.ndarray
    ) -> tuple[int, int, int]:
        """Trace the rays of a tile; returns how many receptions, outgoing and absorbed draws."""
        s, array, u = self.settings, self.array, np.uint32
        ground, shading, geometric, _, alpha, visible_bits, points = self._tile
        self._buffers.write(alpha, face_alpha[faces])
        self._buffers.write(self._surface[2], face_alpha)
        bins = array.n_tx * array.n_rx * self._n_bins
        self._buffers.write(self._tally, np.zeros(3 + bins, np.uint32))
        radius, (tx, rx) = np.float32(s.radius_m), self._antennas
        tx_stride, rx_stride = u(self._n_tx_groups * GROUP), u(self._n_rx_groups * GROUP)
        rays, bounces = u(self._rays_per_sample), u(s.max_bounces)
        drawing = (
            u(first),
            u(self._tx_before),
            *self._seed_words(),
            self._tree.delta_m,
            *self._box,
        )
        for at, (start, count, first_ray, last_ray, most) in enumerate(self._batches(visible)):
            counter, listing = at % LISTS * s.max_bounces, self._lists
            if counter == 0:
                self._buffers.write(self._n_listed, self._fresh)
            items = most if self.device.width == 1 else min(CPU_ITEMS, most)
            self._trace.start(
                "draw_rays", (-(-array.n_tx // self.device.width), count), u(count), u(start),
                u(array.n_tx), u(self._n_tx_groups), tx_stride, rays, u(first_ray), u(last_ray),
                bounces, *drawing, tx, ground, shading, geometric, points, alpha, visible_bits,
                self._tally, u(counter), self._n_listed, listing[0],
                work=350.0 * (last_ray - first_ray),
            )  # fmt: skip
            for bounce in range(s.max_bounces):
                of = (u(counter + bounce), self._n_listed, listing[0])
                last = bounce + 1 == s.max_bounces
                self._trace.start(
                    "trace_rays", (items,), u(items), rx_stride, u(last), radius,
                    *self._tree.buffers, rx, *of, work=RAY_WORK,
                )  # fmt: skip
                self._trace.start(
                    "receive_rays", (items,), u(items), u(array.n_rx), rx_stride, tx_stride, rays,
                    bounces, u(bounce), radius, np.float32(s.pattern_exponent), u(self._capacity),
                    u(self._bin_samples), u(self._n_bins), rx, tx, points, *of, self._tally,
                    *self._appended, work=30.0 * array.n_rx,
                )  # fmt: skip
                if not last:
                    self._trace.start(
                        "bounce_rays", (items,), u(items), rays, bounces, u(bounce + 1), *drawing,
                        *self._tree.buffers, *self._surface, self._tally, *of, listing[1],
                    )  # fmt: skip
                    listing = listing[::-1]
        tally = self._buffers.read(self._tally, 3 + bins, np.uint32)
        self._counts = tally[3:]
        received, further, absorbed = (int(n) for n in tally[:3])
        return received, int(visible.sum()) * self._rays_per_sample + further, absorbed

    def _batches(self, visible: np.ndarray) -> Iterator[tuple[int, int, int, int, int]]:
        """Samples whose rays fit into a list: first, number, range of rays, and rays at most."""
        seen, rays = int(visible.max()), self._rays_per_sample
        step = min(rays, max(1, self._listed // max(1, seen)))
        running = np.concatenate([[0], np.cumsum(visible)])
        start = 0
        while start < len(visible):
            most = running[start] + max(seen, self._listed // step)
            stop = int(np.searchsorted(running, most, side="right")) - 1
            if drawn := int(running[stop] - running[start]):
                for ray in range(0, rays, step):
                    yield start, stop - start, ray, min(ray + step, rays), drawn * step
            start = stop

    def _reception_box(self) -> list[np.ndarray]:
        """Corners of the box around all receivers' spheres, float4, padded for rounding."""
        pad = self.settings.radius_m * (1 + 1e-5) + float(self._tree.delta_m)
        corners = (self.array.rx_m.min(axis=0) - pad, self.array.rx_m.max(axis=0) + pad)
        return [np.append(corner, 0.0).astype(np.float32) for corner in corners]

    def _sort(self, received: int) -> np.ndarray:
        """Bring the tile's receptions into order; returns `Receptions.start`."""
        start = np.zeros(len(self._counts) + 1, np.uint32)
        np.cumsum(self._counts, out=start[1:])
        if received:
            self._buffers.write(self._starts, start)
            keys, paths = self._appended
            within, source, *ordered = self._sorted
            share = 1 if self.device.width == 1 else SHARE
            of = (np.uint32(received), np.uint32(share), keys, paths, self._starts, within, source)
            items = (-(-received // share),)
            self._order.start("place_receptions", items, *of)
            self._order.start("order_receptions", items, *of, *ordered)
        return np.ascontiguousarray(start[:: self._n_bins])

    def read(self, tile: Receptions) -> PathColumns:
        """Read a tile's receptions, before the next is requested."""
        n, most = int(tile.start[-1]), self.settings.max_bounces
        place, length, amplitude = self._sorted[2:]
        within = self._buffers.read(place, n, np.uint32)
        return PathColumns(
            pair=np.repeat(np.arange(len(tile.start) - 1, dtype=np.uint32), np.diff(tile.start)),
            length_m=self._buffers.read(length, n, np.float64),
            amplitude=self._buffers.read(amplitude, n, np.float32),
            bounces=(within % most + 1).astype(np.uint8),
            face=self._faces[within // (self._rays_per_sample * most)],
        )


def _columns(positions_m: np.ndarray, filler_m: float) -> np.ndarray:
    """Antennas by coordinate, (6, n) with n a multiple of `GROUP`: x, y, z as hi, then as lo."""
    fill = ((0, -len(positions_m) % GROUP), (0, 0))
    padded = np.pad(positions_m, fill, constant_values=filler_m)
    return np.ascontiguousarray(antenna_rows(padded).T)
