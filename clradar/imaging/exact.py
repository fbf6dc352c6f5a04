"""The brute-force sum: host side of ``kernels/backproject_exact.cl``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from clradar.imaging.tiled import CHUNK_RX, Former, Tile, length
from clradar.opencl import Buffers
from clradar.opencl.double_single import antenna_rows, hi_lo

CHUNK_TX = 512
"""Transmitters per call of the exact sum; a multiple of the kernel's block of 4."""

CHUNK_FREQ = 8
"""Frequencies per call of the exact sum, so that their part of the cube stays in the cache."""


class Exact(Former):
    """The brute-force sum, a block of frequencies and antennas per call."""

    kernel_file = "backproject_exact.cl"

    def tiles(self) -> Iterator[Tile]:
        room = min(self.device.budget_bytes // 2, self.device.max_buffer_bytes)
        yield from self.cut(*self.whole_within(room))

    def steps_per_tile(self) -> int:
        return -(-len(self.k) // CHUNK_FREQ)

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: Tile) -> Iterator[int]:
        array = self.capture.array
        for step, n0 in enumerate(range(0, len(self.k), CHUNK_FREQ)):
            yield step
            block = slice(n0, n0 + CHUNK_FREQ)
            cube = np.ascontiguousarray(self.weighted[:, :, block].transpose(2, 0, 1))
            k_hi, k_lo = (buffers.upload(half) for half in hi_lo(self.k[block]))
            for rx0 in range(0, array.n_rx, CHUNK_RX):
                for tx0 in range(0, array.n_tx, CHUNK_TX):
                    self._add(buffers, axes, volume, tile, cube, tx0, rx0, k_hi, k_lo)
            buffers.release(k_hi)
            buffers.release(k_lo)

    def _add(
        self,
        buffers: Buffers,
        axes: Any,
        volume: Any,
        tile: Tile,
        cube: np.ndarray,
        tx0: int,
        rx0: int,
        k_hi: Any,
        k_lo: Any,
    ) -> None:
        u = np.uint32
        part = cube[:, tx0 : tx0 + CHUNK_TX, rx0 : rx0 + CHUNK_RX]
        pad = -part.shape[1] % 4
        part = np.pad(part, ((0, 0), (0, pad), (0, 0)))
        tx_m = np.pad(
            self.capture.array.tx_m[tx0 : tx0 + CHUNK_TX], ((0, pad), (0, 0)), mode="edge"
        )
        rx_m = self.capture.array.rx_m[rx0 : rx0 + CHUNK_RX]
        held = [buffers.upload(a) for a in (part, antenna_rows(tx_m), antenna_rows(rx_m))]
        n_z, n_y = length(tile.z), length(tile.y)
        self.program.launch(
            "backproject_exact", (self.n_x // self.width, n_y, n_z), u(self.n_x), u(n_y), u(n_z),
            u(tile.y.start), u(tile.z.start), u(self.grid.counts[1]), u(len(tx_m)), u(len(rx_m)),
            u(len(cube)), held[0], k_hi, k_lo, held[1], held[2], axes, volume,
        )  # fmt: skip
        for buffer in held:
            buffers.release(buffer)
