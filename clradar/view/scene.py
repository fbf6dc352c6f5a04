"""The 3-D scene in the browser: points or voxels, and where the grid is."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.model import VoxelGrid
from clradar.view.session import Shown

UNITS_PER_M = 10.0
"""Of the scene: with a hand of two units, steps and clipping of the camera's defaults fit."""

BOX_COLOUR = (128, 128, 128)


class SceneView:
    """Draws results into the scene of a viser server."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._grid: VoxelGrid | None = None
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False

    def show(self, shown: Shown) -> None:
        grid = shown.volume.grid
        if self._grid is None or not self._grid.same_voxels(grid):
            self._draw_box(grid)
        centre_m = _middle(grid)
        # Relative to the middle: the browser gets half floats, of 0.06 mm for 100 mm.
        self._server.scene.add_point_cloud(
            "/image",
            points=(UNITS_PER_M * (shown.cloud.points_m - centre_m)).astype(np.float32),
            colors=shown.cloud.colours,
            point_size=UNITS_PER_M * float(grid.spacing_m.max()),
            point_shape="square" if shown.wish.voxels else "circle",
            position=UNITS_PER_M * centre_m,
        )

    def _draw_box(self, grid: VoxelGrid) -> None:
        ends = UNITS_PER_M * np.array([[a[0], a[-1]] for a in (grid.x_m, grid.y_m, grid.z_m)])
        self._server.scene.add_line_segments(
            "/box",
            points=box_edges(ends),
            colors=BOX_COLOUR,
            thickness=1.0,
            thickness_units="screen",
        )
        if self._grid is None:
            # As the radar sees it: from the middle of the antennas' side, x to the left.
            centre = UNITS_PER_M * _middle(grid)
            away = 1.1 * float((ends[:2, 1] - ends[:2, 0]).max()) + 0.5
            camera = self._server.initial_camera
            camera.position = tuple(centre - [0.0, 0.0, away])
            camera.look_at = tuple(centre)
            camera.up = (0.0, 1.0, 0.0)
            camera.fov = np.radians(50.0)
        self._grid = grid


def box_edges(ends: np.ndarray) -> np.ndarray:
    """Return the edges of a box with these ends (3, 2) as segments, shape (12, 2, 3), float32."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    places = ends[np.arange(3), corners]
    pairs = [(i, i | 1 << axis) for axis in range(3) for i in range(8) if not i >> axis & 1]
    return places[np.array(pairs)].astype(np.float32)


def _middle(grid: VoxelGrid) -> np.ndarray:
    return grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1) / 2
