"""Signed distance field of a hand's flesh on a device: host side of ``flesh.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.errors import DeviceError
from clradar.hand.flesh import (
    CONTACT_BLEND_M,
    CUT_BLEND_M,
    DIGIT_BLEND_M,
    PALM_BLEND_M,
    ROOT_BLEND_M,
    STUB_M,
    Flesh,
)
from clradar.opencl import Buffers, build

# Nodes along an edge of a cell. The distance at the middle of a cell tells whether the surface can
# cross it; only then are its nodes evaluated.
_NODES = 4

# Lanes of the widest item. Arrays are padded to it on every device.
_PADDED = 8


@dataclass(frozen=True, slots=True)
class _FleshOptions:
    width: int
    palm: int
    root: int
    end: int
    nodes: int = _NODES
    palm_blend_m: float = PALM_BLEND_M
    root_blend_m: float = ROOT_BLEND_M
    digit_blend_m: float = DIGIT_BLEND_M
    contact_blend_m: float = CONTACT_BLEND_M
    cut_blend_m: float = CUT_BLEND_M


class FleshField:
    """The flesh of a posed hand on a device, with a grid of nodes around it.

    Coordinates are float32 about the middle of the hand's box on the device, so that distances are
    within 0.1 um. The nodes lie half a spacing inside cells of 4 x 4 x 4; each cell has a bit mask
    of the cones that matter in it. `first_m` is the first node, a spacing below the box of the
    flesh; the last one is not below its top.
    """

    def __init__(self, flesh: Flesh, spacing_m: float, buffers: Buffers) -> None:
        low_m, high_m = flesh.bounds_m()
        self.first_m = low_m - spacing_m
        self._cells = tuple(
            int(n) for n in np.ceil((high_m + spacing_m - self.first_m) / (_NODES * spacing_m))
        )
        n_x, n_y, n_z = self._cells
        n_z_padded = n_z + -n_z % _PADDED
        self._shape = [np.uint32(n) for n in (*self._cells, n_z_padded)]
        self._middle_m = 0.5 * (low_m + high_m)
        self._buffers, self._device = buffers, buffers.device
        options = _FleshOptions(
            self._device.width, len(flesh.palm), len(flesh.roots[0]), len(flesh.ends[0])
        )
        self._program = build(self._device, "flesh.cl", options)
        corner_m = self.first_m - 0.5 * spacing_m - self._middle_m
        above_cut_m = self._middle_m @ flesh.forearm + STUB_M
        frame = np.array([*corner_m, spacing_m, *flesh.forearm, above_cut_m])
        self._put = [
            buffers.upload(numbers.astype(np.float32))
            for numbers in (frame, _records(flesh, self._middle_m))
        ]
        self._near = [buffers.empty(4 * n_x * n_y * n_z_padded) for _ in range(2)]
        self._distance = buffers.empty(4 * n_x * n_y * n_z_padded)
        self._program.launch(
            "flesh_cells",
            (n_z_padded // self._device.width, n_y, n_x),
            self._shape[0], self._shape[1], self._shape[3],
            *self._put, *self._near, self._distance,
        )  # fmt: skip

    def node_distances_m(self) -> np.ndarray:
        """Return signed distances at all nodes, shape (n_x, n_y, n_z), float32, metres.

        Nodes of cells without surface have the distance of the cell's middle: right in sign only.
        """
        n_x, n_y, n_z = self._cells
        out = np.empty((_NODES * n_x, _NODES * n_y, _NODES * n_z), np.float32)
        layers = self._at_once(4 * _NODES**3 * n_y * n_z)
        _, *shape = self._shape
        for first in range(0, n_x, layers):
            some = out[_NODES * first : _NODES * (first + layers)]
            buffer = self._buffers.empty(some.nbytes)
            count = len(some) // _NODES
            self._program.launch(
                "flesh_nodes",
                (n_z * _NODES**3 // self._device.width, n_y, count),
                np.uint32(count), *shape, np.uint32(first),
                *self._put, *self._near, self._distance, buffer,
            )  # fmt: skip
            some[:] = self._buffers.read(buffer, some.shape, np.float32)
            self._buffers.release(buffer)
        return out

    def distances_m(self, points_m: np.ndarray) -> np.ndarray:
        """Return the signed distances (N,) of points (N, 3), float32, negative inside, metres.

        A lower bound of the distance to the surface in magnitude, up to rounding.
        """
        return self._of_points("flesh_distances", points_m, (1, np.float32))[0]

    def gradients(self, points_m: np.ndarray) -> np.ndarray:
        """Return the gradients (N, 3), float32, of the signed distances of points (N, 3)."""
        return self._of_points("flesh_gradients", points_m, (3, np.float32)).T

    def nearest_parts(self, points_m: np.ndarray) -> np.ndarray:
        """Return for points (N, 3) the index (N,), int32, into `PART_NAMES` of the nearest part."""
        return self._of_points("flesh_parts", points_m, (1, np.int32))[0]

    def _of_points(self, name: str, points_m: np.ndarray, rows: tuple[int, Any]) -> np.ndarray:
        n_rows, dtype = rows
        out = np.empty((n_rows, len(points_m)), dtype)
        at_once = self._at_once(4 * (3 + n_rows) * _PADDED) * _PADDED
        for first in range(0, len(points_m), at_once):
            some_m = points_m[first : first + at_once]
            n = len(some_m)
            columns = np.zeros((3, n + -n % _PADDED), np.float32)
            columns[:, :n] = (some_m - self._middle_m).T
            n_padded = columns.shape[1]
            points = self._buffers.borrow(columns)
            result = self._buffers.empty(4 * n_rows * n_padded)
            self._program.launch(
                name, (n_padded // self._device.width,),
                np.uint32(n_padded), *self._shape, *self._put, *self._near, points, result,
            )  # fmt: skip
            out[:, first : first + n] = self._buffers.read(result, (n_rows, n_padded), dtype)[:, :n]
            for buffer in (points, result):
                self._buffers.release(buffer)
        return out

    def _at_once(self, n_bytes: int) -> int:
        """Return how many pieces of `n_bytes` a launch handles; no result depends on it."""
        free_bytes = min(self._buffers.free_bytes, self._device.max_buffer_bytes)
        if free_bytes < n_bytes:
            raise DeviceError(
                f"device {self._device.info.label}: a hand's surface needs {n_bytes} bytes more "
                f"than are left ({free_bytes}); use longer edges, or choose another device with "
                f"CLRADAR_DEVICE=..."
            )
        return free_bytes // n_bytes


def _records(flesh: Flesh, origin_m: np.ndarray) -> np.ndarray:
    """Return the cones as records of ten numbers (n, 10), see ``flesh.cl``."""
    (begin_m, radius_m), (end_m, end_radius_m) = (
        np.split(spheres, [3], axis=1) for spheres in flesh.cones().swapaxes(0, 1)
    )
    axis_m = end_m - begin_m
    length_m = np.linalg.norm(axis_m, axis=1, keepdims=True)
    sine = (radius_m - end_radius_m) / length_m
    tangent = sine / np.sqrt(1.0 - sine * sine)
    return np.hstack([begin_m - origin_m, axis_m / length_m, length_m, radius_m, sine, tangent])
