"""Back-projection of range profiles by linear interpolation: ``kernels/backproject_range.cl``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.tiled import RX_CHUNK, Tile, TiledImager, tiles_of
from clradar.model import Capture, VoxelGrid
from clradar.opencl import Buffers, Device
from clradar.opencl.buffers import antenna_rows, hi_lo

OVERSAMPLING = 16
"""Bins of the range profile per resolution cell c / span. Linear interpolation between bins a
phase of 2 pi u / OVERSAMPLING apart, u the offset from the carrier in spans (-1/2 ... 1/2), errs by
at most (pi u / OVERSAMPLING)^2 / 2: at worst 4.8e-3, and 1.6e-3 RMS (-56 dB) over a flat band."""

STEPS_PER_TILE = 16  # steps of progress


class RangeImager(TiledImager):
    """Range profiles first, then one interpolated read per voxel and pair."""

    kernel_file = "backproject_range.cl"

    def __init__(
        self, capture: Capture, grid: VoxelGrid, weights: np.ndarray, device: Device
    ) -> None:
        super().__init__(capture, grid, weights, device)
        waveform = capture.waveform
        span_hz = waveform.span_hz if waveform.n_freq > 1 else waveform.center_hz
        self.bins_per_m = np.float32(OVERSAMPLING * span_hz / SPEED_OF_LIGHT_M_PER_S)
        self.carrier = waveform.center_hz / SPEED_OF_LIGHT_M_PER_S

    def tiles(self) -> Iterator[Tile]:
        array = self.capture.array
        limit_bytes = min(self.device.budget_bytes // 3, self.device.max_buffer_bytes)
        n_z, n_y = self.tile_size(limit_bytes)
        # A smaller tile has shorter profiles; one transmitter's have to fit, more are better.
        n_bins = limit_bytes // (8 * min(RX_CHUNK, array.n_rx) * array.n_tx)
        while n_z > 1 or n_y > 1:
            bins = map(self.bins, tiles_of(self.grid, n_z, n_y))
            if max(stop - first for first, stop in bins) <= n_bins:
                break
            n_z, n_y = (-(-n_z // 2), n_y) if n_z > 1 else (1, -(-n_y // 2))
        yield from tiles_of(self.grid, n_z, n_y)

    def steps_per_tile(self) -> int:
        return STEPS_PER_TILE

    def bins(self, tile: Tile) -> tuple[int, int]:
        """Return the first and the last bin (not included) that the tile's voxels read."""
        grid, array = self.grid, self.capture.array
        last_x = grid.origin_m[0] + grid.spacing_m[0] * (self.n_x - 1)
        low = np.array([grid.origin_m[0], grid.y_m[tile.y.start], grid.z_m[tile.z.start]])
        high = np.array([last_x, grid.y_m[tile.y.stop - 1], grid.z_m[tile.z.stop - 1]])
        near = far = 0.0
        for antennas in (array.tx_m, array.rx_m):
            inside = np.clip(antennas, low, high)
            near += float(np.linalg.norm(antennas - inside, axis=1).min())
            corner = np.maximum(np.abs(antennas - low), np.abs(antennas - high))
            far += float(np.linalg.norm(corner, axis=1).max())
        first = max(0, int(near * self.bins_per_m) - 1)
        n_bins = int(far * self.bins_per_m) + 3 - first
        return first, first + -(-n_bins // self.width) * self.width

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: Tile) -> Iterator[int]:
        u, array = np.uint32, self.capture.array
        first, stop = self.bins(tile)
        n_bins, n_freq = stop - first, len(self.k)
        table = buffers.upload(self._table(first, stop))
        n_rx = min(RX_CHUNK, array.n_rx)
        per_tx = 8 * n_rx * (n_bins + n_freq)
        limit_bytes = min(buffers.free_bytes // 2, self.device.max_buffer_bytes)
        n_tx = int(max(1, min(array.n_tx, limit_bytes // per_tx)))
        cube = buffers.empty(8 * n_tx * n_rx * n_freq)
        profiles = buffers.empty(8 * n_tx * n_rx * n_bins)
        parts = [
            (slice(tx0, tx0 + n_tx), slice(rx0, rx0 + RX_CHUNK))
            for rx0 in range(0, array.n_rx, RX_CHUNK)
            for tx0 in range(0, array.n_tx, n_tx)
        ]
        for i, (tx, rx) in enumerate(parts):
            yield i * STEPS_PER_TILE // len(parts)
            buffers.write(cube, self.weighted[tx, rx])
            antennas = (array.tx_m[tx], array.rx_m[rx])
            counts = [len(a) for a in antennas]
            n_pairs = counts[0] * counts[1]
            self.program.launch(
                "range_profiles", (n_bins // self.width, n_pairs), u(n_pairs), u(n_freq),
                u(n_bins), cube, table, profiles, work=8.0 * n_freq,
            )  # fmt: skip
            held = [buffers.upload(antenna_rows(a)) for a in antennas]
            self.launch(
                "backproject_range", tile, *map(u, counts), u(n_bins), np.int32(first),
                self.bins_per_m, *hi_lo(np.float64(self.carrier)), profiles, *held, axes, volume,
                work=25.0 * n_pairs,
            )  # fmt: skip
            for buffer in held:
                buffers.release(buffer)
        for buffer in (table, cube, profiles):
            buffers.release(buffer)

    def _table(self, first: int, stop: int) -> np.ndarray:
        """Return cosine and sine of 2 pi (f_n - f_c) d / c, shape (n_freq, 2, n_bins), float32."""
        d_m = np.arange(first, stop) / np.float64(self.bins_per_m)
        cycles = np.outer(self.k - self.carrier, d_m)
        angle = 2 * np.pi * (cycles - np.round(cycles))
        return np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
