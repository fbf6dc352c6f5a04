"""Back-projection voxel by voxel, tile by tile, for the exact sum and the range profiles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, VoxelGrid
from clradar.model.progress import Progress
from clradar.opencl import Buffers, Device, build
from clradar.opencl.buffers import hi_lo

RX_CHUNK = 96
"""Receivers per call, whose path lengths are in private memory. Part of the summation order."""


@dataclass(frozen=True, slots=True)
class KernelSizes:
    """Compile-time constants of both kernels."""

    width: int
    rx_chunk: int


@dataclass(frozen=True, slots=True)
class Tile:
    """Voxels of one piece of the volume: slices along z and y, all of x."""

    z: slice
    y: slice

    @property
    def n_z(self) -> int:
        return self.z.stop - self.z.start

    @property
    def n_y(self) -> int:
        return self.y.stop - self.y.start


class TiledImager:
    """Axes on the device and the loop over tiles; a subclass forms the image of one tile."""

    kernel_file = ""
    kernel_sizes = KernelSizes
    gpu_rx_chunk = 20
    """Receivers that an item on a GPU holds in private memory at a time: 240 bytes."""

    def __init__(
        self, capture: Capture, grid: VoxelGrid, weights: np.ndarray, device: Device
    ) -> None:
        self.capture, self.grid, self.device = capture, grid, device
        self.weighted = (capture.data * weights).astype(np.complex64)
        self.width = device.width
        self.n_x = -(-grid.counts[0] // self.width) * self.width
        self.k = capture.waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        chunk = RX_CHUNK if self.width == 8 else self.gpu_rx_chunk
        self.program = build(device, self.kernel_file, self.kernel_sizes(self.width, chunk))

    def run(self, progress: Progress | None) -> np.ndarray:
        """Return the unscaled sum, shape (n_z, n_y, n_x), complex64."""
        out = np.empty(self.grid.shape, dtype=np.complex64)
        tiles = list(self.tiles())
        steps = self.steps_per_tile()
        with Buffers(self.device) as buffers:
            axes = buffers.upload(self._axes())
            volume = buffers.empty(8 * max(t.n_z * t.n_y for t in tiles) * self.n_x)
            for i, tile in enumerate(tiles):
                shape = (2, tile.n_z, tile.n_y, self.n_x)
                buffers.write(volume, np.zeros(shape, np.float32))
                for j in self.add_all(buffers, axes, volume, tile):
                    if progress is not None:
                        progress(i * steps + j, len(tiles) * steps)
                part = buffers.read(volume, shape, np.float32)[..., : self.grid.counts[0]]
                out.real[tile.z, tile.y], out.imag[tile.z, tile.y] = part
                if progress is not None:
                    progress((i + 1) * steps, len(tiles) * steps)
        return out

    def tiles(self) -> Iterator[Tile]:
        raise NotImplementedError

    def steps_per_tile(self) -> int:
        raise NotImplementedError

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: Tile) -> Iterator[int]:
        """Add all samples to the tile; yield the number of steps done before each step."""
        raise NotImplementedError

    def launch(self, kernel: str, tile: Tile, *args: Any, work: float) -> None:
        """Run a kernel over the voxels of a tile; `args` follow those of tile and axes."""
        u = np.uint32
        self.program.launch(
            kernel, (self.n_x // self.width, tile.n_y, tile.n_z), u(self.n_x), u(tile.n_y),
            u(tile.n_z), u(tile.y.start), u(tile.z.start), u(self.grid.counts[1]), *args,
            work=work,
        )  # fmt: skip

    def _axes(self) -> np.ndarray:
        """Return voxel centres in the layout of ``kernels/common/voxel.h``."""
        grid = self.grid
        x_m = grid.origin_m[0] + grid.spacing_m[0] * np.arange(self.n_x)
        columns = [np.stack(hi_lo(x_m), axis=0).ravel()]
        columns += [np.stack(hi_lo(axis), axis=1).ravel() for axis in (grid.y_m, grid.z_m)]
        return np.concatenate(columns)

    def tile_size(self, n_bytes: int) -> tuple[int, int]:
        """Return how many planes along z, and rows of one plane, fit `n_bytes` of volume."""
        return planes_and_rows(self.grid, n_bytes // (8 * self.n_x))


def planes_and_rows(grid: VoxelGrid, rows: int) -> tuple[int, int]:
    """Return the size of a tile of at most `rows` rows along x (at least one): n_z and n_y."""
    _, ny, nz = grid.counts
    return (min(nz, rows // ny), ny) if rows >= ny else (1, max(1, rows))


def tiles_of(grid: VoxelGrid, n_z: int, n_y: int) -> Iterator[Tile]:
    """Yield the tiles of a grid, row by row of each plane, the last ones smaller."""
    _, ny, nz = grid.counts
    for z in range(0, nz, n_z):
        for y in range(0, ny, n_y):
            yield Tile(slice(z, min(z + n_z, nz)), slice(y, min(y + n_y, ny)))
