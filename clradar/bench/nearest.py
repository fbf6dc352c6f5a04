"""What rays hit first, for rays given one by one: the question of a bounce, asked by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.geometry.bvh import build_bvh, error_bound_m, flatten
from clradar.model import checks
from clradar.opencl import Buffers, Device, build

CACHE_BYTES = 2**22
"""Of a tree of up to this size a core's cache holds what rays need most."""


@dataclass(frozen=True, slots=True)
class _NearestOptions:
    width: int
    stack: int


class NearestHits:
    """A mesh and rays on a device.

    A context manager: its device memory is freed when the block ends.

    Parameters
    ----------
    triangles_m : array_like, shape (n_faces, 3, 3), metres
    origins_m : array_like, shape (n, 3), metres
    directions : array_like, shape (n, 3)
        Unit vectors.
    device : Device
    """

    def __init__(
        self, triangles_m: np.ndarray, origins_m: np.ndarray, directions: np.ndarray, device: Device
    ) -> None:
        at = checks.read_only("NearestHits: origins_m", origins_m, np.float32, (None, 3))
        away = checks.read_only("NearestHits: directions", directions, np.float32, at.shape)
        self._triangles, self._rays, self._device = triangles_m, (at, away), device
        self._buffers = Buffers(device)

    def __enter__(self) -> NearestHits:
        try:
            triangles, (at, away) = np.asarray(self._triangles, dtype=np.float64), self._rays
            delta_m = error_bound_m(triangles, at.astype(np.float64))
            nodes, records, stack = flatten(build_bvh(triangles, self._device), triangles, delta_m)
            options = _NearestOptions(self._device.width, stack)
            self._program = build(self._device, "nearest.cl", options)
            self._put = [self._buffers.upload(a) for a in (nodes, records, at, away)]
            self._order = self._buffers.upload(np.arange(len(at), dtype=np.uint32))
            self._cells = self._buffers.empty(2 * len(at))
            self._sorts = self._pays_to_sort()
            self._out = [self._buffers.empty(size * len(at)) for size in (4, 4, 8)]
        except BaseException:
            self._buffers.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        self._buffers.__exit__(None, None, None)

    def trace(self) -> None:
        """Find the hits, which stay on the device."""
        n = len(self._rays[0])
        nodes, triangles, *rays = self._put
        if self._sorts:
            self._buffers.write(self._order, self._neighbours_first(n))
        self._program.launch(
            "nearest_hits", (n,), np.uint32(n), nodes, triangles, self._order, *rays, *self._out
        )

    def _pays_to_sort(self) -> bool:
        """Return whether a tree does not stay in the cache. A GPU would wait for the host."""
        info, (nodes, records, *_) = self._device.info, self._put
        waits = info.kind != "cpu" and not info.is_interpreter
        return not waits and nodes.size + records.size >= CACHE_BYTES

    def _neighbours_first(self, n: int) -> np.ndarray:
        """Return in which order a CPU reads least from memory."""
        nodes, _, origins, _ = self._put
        self._program.launch("ray_cells", (n,), np.uint32(n), nodes, origins, self._cells)
        cells = self._buffers.read(self._cells, n, np.uint16)
        return np.argsort(cells, kind="stable").astype(np.uint32)

    def hits(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what `trace` found.

        Returns
        -------
        distance_m : ndarray, shape (n,), float32, metres
            -1 where nothing is hit.
        face : ndarray, shape (n,), int32
            -1 where nothing is hit.
        weights : ndarray, shape (n, 2), float32
            Barycentric weights of the face's second and third corner.
        """
        n, read = len(self._rays[0]), self._buffers.read
        distance, face, weights = self._out
        return (
            read(distance, n, np.float32),
            read(face, n, np.int32),
            read(weights, (n, 2), np.float32),
        )
