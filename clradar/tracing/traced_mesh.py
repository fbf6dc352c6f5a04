"""A mesh on a device with its tree, and which antennas are visible from points on it.

Host side of ``visibility.cl``; equation E2 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from clradar.geometry.bvh import RAY_WORK, upload_tree
from clradar.opencl import build
from clradar.opencl.buffers import OnDevice
from clradar.tracing.antenna_packets import GROUP, VisibilityOptions, items, n_groups


class TracedMesh(OnDevice):
    """A mesh that blocks rays. Subclasses choose the points on it."""

    def _prepare_tree(self, triangles_m: np.ndarray, antennas_m: Iterable[np.ndarray]) -> None:
        """Upload the mesh's tree, for rays to any of `antennas_m`, shapes (n, 3)."""
        self._tree = upload_tree(triangles_m, antennas_m, self._buffers)
        options = VisibilityOptions(width=self.device.width, **self._tree.traversal)
        self._visibility = build(self.device, "visibility.cl", options)

    def _find_visible(
        self,
        n_points: int,
        points: Any,
        normals: Any,
        n_antennas: int,
        antennas: Any,
        bits: Any,
        radius_m: float | None = None,
    ) -> None:
        """Write which antennas are visible from points, one byte per group, to the buffer `bits`.

        Antennas are points, or spheres of radius `radius_m`.
        """
        kernel, radius = "visible_antennas", []
        if radius_m is not None:
            kernel, radius = "visible_spheres", [np.float32(radius_m)]
        u, groups = np.uint32, n_groups(n_antennas)
        self._visibility.launch(
            kernel, items(self.device, n_points, groups), u(n_points), u(n_antennas), u(groups),
            self._tree.delta_m, *radius, *self._tree.buffers, antennas, points, normals, bits,
            work=GROUP * RAY_WORK,
        )  # fmt: skip
