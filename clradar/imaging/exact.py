"""Back-projection by the brute-force sum: host side of ``kernels/backproject_exact.cl``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.imaging.tiled import RX_CHUNK, KernelSizes, Tile, TiledImager, tiles_of
from clradar.opencl import Buffers
from clradar.opencl.buffers import antenna_rows, hi_lo

TX_BLOCK = 4  # transmitters that the kernel goes through side by side
TX_CHUNK = 512  # transmitters per call; a multiple of `TX_BLOCK`
FREQUENCY_CHUNK = 8  # frequencies per call, so that their part of the cube stays in the cache


@dataclass(frozen=True, slots=True)
class ExactSizes(KernelSizes):
    """Compile-time constants of the brute-force sum."""

    tx_block: int = TX_BLOCK


class ExactImager(TiledImager):
    """The brute-force sum, a block of frequencies and antennas per call."""

    kernel_file = "backproject_exact.cl"
    kernel_sizes = ExactSizes
    gpu_rx_chunk = 30  # 240 bytes

    def tiles(self) -> Iterator[Tile]:
        limit_bytes = min(self.device.budget_bytes // 2, self.device.max_buffer_bytes)
        yield from tiles_of(self.grid, *self.tile_size(limit_bytes))

    def steps_per_tile(self) -> int:
        return -(-len(self.k) // FREQUENCY_CHUNK)

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: Tile) -> Iterator[int]:
        array = self.capture.array
        for step, n0 in enumerate(range(0, len(self.k), FREQUENCY_CHUNK)):
            yield step
            block = slice(n0, n0 + FREQUENCY_CHUNK)
            cube = np.ascontiguousarray(self.weighted[:, :, block].transpose(2, 0, 1))
            k = [buffers.upload(half) for half in hi_lo(self.k[block])]
            for rx0 in range(0, array.n_rx, RX_CHUNK):
                for tx0 in range(0, array.n_tx, TX_CHUNK):
                    tx, rx = slice(tx0, tx0 + TX_CHUNK), slice(rx0, rx0 + RX_CHUNK)
                    part, tx_m = cube[:, tx, rx], array.tx_m[tx]
                    pad = (0, -len(tx_m) % TX_BLOCK)
                    part = np.pad(part, ((0, 0), pad, (0, 0)))
                    antennas = [np.pad(tx_m, (pad, (0, 0)), mode="edge"), array.rx_m[rx]]
                    held = [buffers.upload(a) for a in (part, *map(antenna_rows, antennas))]
                    n_tx, n_rx, n_k = counts = [len(a) for a in (*antennas, cube)]
                    self.launch(
                        "backproject_exact", tile, *map(np.uint32, counts), held[0], *k, *held[1:],
                        axes, volume,
                        work=n_k * (8.0 * n_tx * n_rx + 50.0 * (n_tx + n_rx)),
                    )  # fmt: skip
                    for buffer in held:
                        buffers.release(buffer)
            for half in k:
                buffers.release(half)
