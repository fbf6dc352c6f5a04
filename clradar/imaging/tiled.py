"""What the methods that go voxel by voxel share: axes on the device, tiles, the loop over them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, VoxelGrid
from clradar.model.progress import Progress
from clradar.opencl import Buffers, Device, build
from clradar.opencl.double_single import hi_lo

CHUNK_RX = 96
"""Receivers per call: their legs are held in private memory. Part of the order of summation."""


@dataclass(frozen=True, slots=True)
class Options:
    """Compile-time constants of the kernels."""

    width: int
    chunk: int


@dataclass(frozen=True, slots=True)
class Tile:
    """Voxels of one piece of the volume: slices along z and y, all of x."""

    z: slice
    y: slice


class Former:
    """What both methods share: axes and antennas on the device, tiles, the loop over them."""

    kernel_file = ""

    def __init__(
        self, capture: Capture, grid: VoxelGrid, weights: np.ndarray, device: Device
    ) -> None:
        self.capture, self.grid, self.device = capture, grid, device
        self.weighted = (capture.data * weights).astype(np.complex64)
        self.width = device.width
        self.n_x = -(-grid.counts[0] // self.width) * self.width
        self.k = capture.waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        chunk = min(CHUNK_RX, capture.array.n_rx)
        self.program = build(device, self.kernel_file, Options(self.width, chunk))

    def run(self, progress: Progress | None) -> np.ndarray:
        """Return the unscaled sum, shape (n_z, n_y, n_x), complex64."""
        out = np.empty(self.grid.shape, dtype=np.complex64)
        tiles = list(self.tiles())
        steps = self.steps_per_tile()
        with Buffers(self.device) as buffers:
            axes = buffers.upload(self._axes())
            largest = max(length(t.z) * length(t.y) for t in tiles)
            volume = buffers.empty(8 * largest * self.n_x)
            for i, tile in enumerate(tiles):
                shape = (2, length(tile.z), length(tile.y), self.n_x)
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
        """Add everything to the tile; yield the number of steps done before each step."""
        raise NotImplementedError

    def _axes(self) -> np.ndarray:
        """Return voxel centres in the layout of ``kernels/common/voxel.h``."""
        grid = self.grid
        x_m = grid.origin_m[0] + grid.spacing_m[0] * np.arange(self.n_x)
        columns = [np.stack(hi_lo(x_m), axis=0).ravel()]
        columns += [np.stack(hi_lo(axis), axis=1).ravel() for axis in (grid.y_m, grid.z_m)]
        return np.concatenate(columns)

    def whole_within(self, n_bytes: int) -> tuple[int, int]:
        """Return how many planes along z, and rows of one plane, fit `n_bytes` of volume."""
        _, ny, nz = self.grid.counts
        rows = max(1, n_bytes // (8 * self.n_x))
        return (min(nz, rows // ny), ny) if rows >= ny else (1, min(rows, ny))

    def cut(self, n_z: int, n_y: int) -> Iterator[Tile]:
        _, ny, nz = self.grid.counts
        for z in range(0, nz, n_z):
            for y in range(0, ny, n_y):
                yield Tile(slice(z, min(z + n_z, nz)), slice(y, min(y + n_y, ny)))


def length(part: slice) -> int:
    return part.stop - part.start
