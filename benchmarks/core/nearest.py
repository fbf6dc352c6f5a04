"""Closest-hit queries for rays given one by one: host side of ``nearest.cl``."""

from __future__ import annotations

import numpy as np

from clradar.geometry.bvh import RAY_WORK, TraversalOptions, upload_tree
from clradar.model import checks
from clradar.opencl import Device, build
from clradar.opencl.buffers import OnDevice

CACHE_BYTES = 2**22  # of a tree of up to this size a core's cache holds what rays need most


class NearestHits(OnDevice):
    """Triangles, shape (n_faces, 3, 3), and rays on a device; origins and unit vectors (n, 3)."""

    def __init__(
        self, triangles_m: np.ndarray, origins_m: np.ndarray, directions: np.ndarray, device: Device
    ) -> None:
        super().__init__(device)
        at = checks.read_only("NearestHits: origins_m", origins_m, np.float32, (None, 3))
        away = checks.read_only("NearestHits: directions", directions, np.float32, at.shape)
        self._triangles, self._rays = np.asarray(triangles_m, dtype=np.float64), (at, away)

    def _prepare(self) -> None:
        (origins, _), upload = self._rays, self._buffers.upload
        n = len(origins)
        self._tree = upload_tree(self._triangles, [origins.astype(np.float64)], self._buffers)
        options = TraversalOptions(width=self.device.width, **self._tree.traversal)
        self._program = build(self.device, "nearest.cl", options)
        self._uploaded_rays = [upload(a) for a in self._rays]
        self._order = upload(np.arange(n, dtype=np.uint32))
        self._cells = self._buffers.empty(2 * n)
        self._out = [self._buffers.empty(size * n) for size in (4, 4, 8)]
        # Sorting pays where a tree does not stay in the cache. A GPU would wait for the host.
        info = self.device.info
        tree_bytes = sum(buffer.size for buffer in self._tree.buffers)
        self._sorts = (info.kind == "cpu" or info.is_interpreter) and tree_bytes >= CACHE_BYTES

    def trace(self) -> None:
        """Find the hits, which stay on the device."""
        n = len(self._rays[0])
        if self._sorts:
            self._sort()
        self._program.launch(
            "nearest_hits", (n,), np.uint32(n), *self._tree.buffers, self._order,
            *self._uploaded_rays, *self._out, work=RAY_WORK,
        )  # fmt: skip

    def _sort(self) -> None:
        """Order rays by where they start, so that a CPU reads least from memory."""
        n, origins = len(self._rays[0]), self._uploaded_rays[0]
        nodes = self._tree.buffers[0]
        self._program.launch("ray_cells", (n,), np.uint32(n), nodes, origins, self._cells)
        cells = self._buffers.read(self._cells, n, np.uint16)
        self._buffers.write(self._order, np.argsort(cells, kind="stable").astype(np.uint32))

    def hits(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `trace` found: distance and face, -1 for none, weights (n, 2) of corners 2 and 3."""
        n, read = len(self._rays[0]), self._buffers.read
        kinds = (n, np.float32), (n, np.int32), ((n, 2), np.float32)
        distance, face, weights = (
            read(out, *kind) for out, kind in zip(self._out, kinds, strict=True)
        )
        return distance, face, weights
