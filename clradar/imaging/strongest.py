"""The strongest voxels along z of a volume on the device: host side of ``kernels/depth.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.opencl import Buffers, build


@dataclass(frozen=True, slots=True)
class DepthSizes:
    """Compile-time constants."""

    width: int


@dataclass(frozen=True, slots=True, eq=False)
class Strongest:
    """The strongest voxel of each pixel, (n_y, n_x), and its neighbours along z, complex64.

    `top` is its index, -1 where a voxel is not finite; of voxels that are equal to the rounding of
    float32 any. Neighbours outside the grid have the value of the `peak`.
    """

    top: np.ndarray  # int32
    before: np.ndarray
    peak: np.ndarray
    after: np.ndarray


class StrongestAlongZ:
    """Finds them in one volume after the other, of one shape (n_z, n_y, n_x)."""

    def __init__(self, shape: tuple[int, int, int], buffers: Buffers) -> None:
        self._n_z, *self._pixels = shape
        self._buffers, width = buffers, buffers.device.width
        self._program = build(buffers.device, "depth.cl", DepthSizes(width))
        self._n_pixels = self._pixels[0] * self._pixels[1]
        self._n_written = -(-self._n_pixels // width) * width
        self._top = buffers.empty(4 * self._n_written)
        self._values = buffers.empty(24 * self._n_written)

    def of(self, volume: Any, divisor: np.float32) -> Strongest:
        """Return those of the values of a volume, float32 (2, n_z, n_y, n_x), over the divisor."""
        u, n = np.uint32, self._n_written
        self._program.launch(
            "strongest_along_z", (n // self._buffers.device.width,), u(self._n_pixels), u(n),
            u(self._n_z), divisor, volume, self._top, self._values,
            work=10.0 * self._n_z,
        )  # fmt: skip
        top = self._buffers.read(self._top, n, np.int32)
        values = self._buffers.read(self._values, (3, n), np.complex64)
        planes = (plane[: self._n_pixels].reshape(self._pixels) for plane in (top, *values))
        return Strongest(*planes)
