"""The 3-D scene in the browser: points or voxels, a mesh, and where the grid is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import Scene, VoxelGrid
from clradar.view.session import Drawn, Shown
from clradar.view.slices import clicked_m
from clradar.view.wish import Place

UNITS_PER_M = 10.0
"""Of the scene: with a hand of two units, steps and clipping of the camera's defaults fit."""

BOX_COLOUR = (128, 128, 128)

MESH_COLOUR = (170, 170, 180)


@dataclass(frozen=True, slots=True, eq=False)
class _CloudInScene:
    handle: Any
    drawn: Drawn


class SceneView:
    """Draws results into the scene of a viser server."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._grid: VoxelGrid | None = None
        self._clouds: dict[str, _CloudInScene] = {}
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False

    def show(self, shown: Shown) -> None:
        """Draw the points or voxels of a result."""
        grid = shown.first.volume.grid
        if self._grid is None or not self._grid.same_voxels(grid):
            self._draw_box(grid)
        drawn = [("/image", shown.first, "simulated")]
        if shown.second is not None:
            drawn.append(("/simulated", shown.second, "measured"))
        elif self._clouds.pop("/simulated", None) is not None:
            self._server.scene.remove_by_name("/simulated")
        for name, one, hidden in drawn:
            visible = shown.second is None or shown.wish.side != hidden
            self._draw_cloud(name, one, "square" if shown.wish.voxels else "circle", visible)

    def _draw_cloud(self, name: str, drawn: Drawn, shape: str, visible: bool) -> None:
        last = self._clouds.get(name)
        if last is not None and last.drawn is drawn:
            if last.handle.visible != visible:
                last.handle.visible = visible
            return
        grid = drawn.volume.grid
        centre_m = _middle(grid)
        # Relative to the middle: the browser gets half floats, of 0.06 mm for 100 mm.
        handle = self._server.scene.add_point_cloud(
            name,
            points=(UNITS_PER_M * (drawn.cloud.points_m - centre_m)).astype(np.float32),
            colors=drawn.cloud.colours,
            point_size=UNITS_PER_M * float(grid.spacing_m.max()),
            point_shape=shape,
            position=UNITS_PER_M * centre_m,
            visible=visible,
        )
        self._clouds[name] = _CloudInScene(handle, drawn)

    def draw_mesh(self, scene: Scene) -> Any:
        """Draw a mesh, half transparent, and return its handle of viser."""
        return self._server.scene.add_mesh_simple(
            "/mesh",
            vertices=(UNITS_PER_M * scene.vertices_m).astype(np.float32),
            faces=scene.faces.astype(np.uint32),
            color=MESH_COLOUR,
            opacity=0.4,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def on_click(self, act: Callable[[Place], None]) -> None:
        """Let a click on a point or voxel call this with its place, metres."""

        def clicked(event: Any) -> None:
            seen = [one.drawn for one in list(self._clouds.values()) if one.handle.visible]
            if not seen:
                return
            points_m = np.concatenate([drawn.cloud.points_m for drawn in seen])
            voxel_m = max(float(drawn.volume.grid.spacing_m.max()) for drawn in seen)
            origin_m = np.array(event.ray_origin) / UNITS_PER_M
            at_m = clicked_m(points_m, origin_m, np.array(event.ray_direction), voxel_m)
            if at_m is not None:
                act(at_m)

        self._server.scene.on_click()(clicked)

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
