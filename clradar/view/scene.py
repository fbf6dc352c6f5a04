"""The scene in the browser: points or voxels in a box with axes, and large pictures beside it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS
from clradar.model.length_unit import unit_for
from clradar.plot.drawing import InnerTicks
from clradar.view.drawn import Drawn, clicked_m
from clradar.view.pictures import SIZE_INCHES, Picture, image_pictures, slice_pictures
from clradar.view.session import Shown, View
from clradar.view.sources import Truth
from clradar.view.wish import LAYOUTS, Place

UNITS_PER_M = 10.0  # of the scene: steps and clipping of the camera fit a hand of two units
BONES = np.array([pair for chain in CHAINS for pair in pairwise((0, *chain))])

BOX_COLOUR = (128, 128, 128)

MESH_COLOUR, TRUTH_COLOUR = (170, 170, 180), (90, 200, 255)

FOV = np.radians(50.0)  # of the camera, upwards
PAGE_ASPECT = 1.2  # of the scene before a browser has said what it has: width over height
FACING = (0.0, 0.0, 0.0, 1.0)  # turns viser's pictures, rows along y, to the radar: x to the left
JPEG_QUALITY = 92

GAP = 0.03  # between pictures, of their width and height


class SceneView:
    """Draws results into the scene of a viser server, with mesh and truth of a view."""

    def __init__(self, server: Any, view: View) -> None:
        self._server = server
        self.mesh: Any = None
        """Handle of viser, if there is a mesh."""
        self.truth: Truth | None = None
        """That of the frame which is shown, if it is known."""
        self._truth_of, self._truth_nodes, self._frame = view.source.truth, list[Any](), -1
        self._ends_m = np.full((3, 2), np.nan)
        self._clouds: dict[str, tuple[Any, Drawn]] = {}
        """Handles of viser, and what they show."""
        self._pictures: dict[str, tuple[Any, Picture]] = {}
        self._layout = LAYOUTS[-1]
        self._view: Any = None
        """Middle, width, height and depth of what the camera is to show, units of the scene."""
        self._space = server.scene.add_frame("/3-D", show_axes=False)
        self.truth_node = server.scene.add_frame("/3-D/truth", show_axes=False)
        self._box: Any = None
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False
        server.scene.configure_default_lights(cast_shadow=False)  # drawn anew with every picture
        # A cloud out of sight: without one the browser would compile the shader of points anew for
        # each frame, since viser makes a material for new colours.
        server.scene.add_point_cloud(
            "/shader", points=np.zeros((2, 3), np.float32), colors=np.zeros((2, 3), np.uint8),
            position=(0.0, 0.0, -1e6),
        )  # fmt: skip
        if view.mesh is not None:
            self.mesh = server.scene.add_mesh_simple(
                "/3-D/mesh", vertices=(UNITS_PER_M * view.mesh.vertices_m).astype(np.float32),
                faces=view.mesh.faces.astype(np.uint32), color=MESH_COLOUR, opacity=0.4,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        server.on_client_connect(self._connect)

    def show(self, shown: Shown) -> None:
        """Draw the points or voxels of a result, and the pictures of its layout."""
        layout, ends_m = shown.wish.layout, shown.first.ends_m
        changed = not np.allclose(ends_m, self._ends_m, atol=1e-6)
        if changed:
            self._draw_box(ends_m)
        self._space.visible = layout != "2-D"
        drawn = [("/3-D/image", shown.first, "Simulated")]
        if shown.second is not None:
            drawn.append(("/3-D/simulated", shown.second, "Measured"))
        elif self._clouds.pop("/3-D/simulated", None) is not None:
            self._server.scene.remove_by_name("/3-D/simulated")
        for name, one, hidden in drawn:
            handle = self._cloud(name, one, "square" if shown.wish.voxels else "circle")
            handle.visible = shown.second is None or shown.wish.side != hidden
        pictures: dict[str, Picture] = {}
        if layout != "3-D":
            pictures = image_pictures(shown.first, shown.second, shown.chosen, shown.wish.at_m)
        if layout == "2-D":
            at_m = shown.wish.at_m or shown.chosen.strongest_m()
            pictures |= slice_pictures(shown.chosen, at_m)
        if changed or layout != self._layout or pictures.keys() != self._pictures.keys():
            self._layout = layout
            self._arrange(pictures)
        for name, picture in pictures.items():
            handle, last = self._pictures[name]
            if not np.array_equal(last.pixels, picture.pixels):
                handle.image = picture.pixels
            self._pictures[name] = handle, picture
        if shown.wish.frame != self._frame and self._truth_of is not None:
            self._frame = shown.wish.frame
            self.truth = self._truth_of(self._frame)
            for node in self._truth_nodes:
                node.remove()
            self._truth_nodes = draw_truth(self._server.scene, self.truth)

    def _cloud(self, name: str, drawn: Drawn, shape: str) -> Any:
        handle, last = self._clouds.get(name, (None, None))
        if last is not drawn:
            middle_m = drawn.ends_m.mean(axis=1)
            # Relative to the middle: the browser gets half floats, of 0.06 mm for 100 mm.
            handle = self._server.scene.add_point_cloud(
                name,
                points=(UNITS_PER_M * (drawn.points_m - middle_m)).astype(np.float32),
                colors=drawn.colours,
                point_size=UNITS_PER_M * drawn.size_m,
                point_shape=shape,
                position=UNITS_PER_M * middle_m,
            )
            self._clouds[name] = handle, drawn
        return handle

    def clicked_m(self, shown: Shown, event: Any) -> Place | None:
        """Return the place that a click on a picture, a point or a voxel means, metres."""
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        if not np.isfinite([origin, direction]).all() or not direction.any():
            return None
        at_m = shown.wish.at_m or shown.chosen.strongest_m()
        for name, (handle, picture) in list(self._pictures.items()):
            centre = np.array(handle.position)
            if direction[2] == 0.0:
                continue
            met = origin + direction * (centre[2] - origin[2]) / direction[2]
            # x is to the left.
            across = 0.5 - (met[0] - centre[0]) / handle.render_width
            down = 0.5 - (met[1] - centre[1]) / handle.render_height
            values_m = picture.values_m(across, down)
            if values_m is not None:
                return shown.chosen.pointed_m(at_m, name, *values_m)
        seen = [drawn for handle, drawn in list(self._clouds.values()) if handle.visible]
        if not seen or not self._space.visible:
            return None
        points_m = np.concatenate([drawn.points_m for drawn in seen])
        size_m = max(drawn.size_m for drawn in seen)
        return clicked_m(points_m, origin / UNITS_PER_M, direction, size_m)

    def _arrange(self, pictures: Mapping[str, Picture]) -> None:
        """Put pictures into columns, to the left of the box where that is shown; aim cameras."""
        for handle, _ in self._pictures.values():
            handle.remove()
        middle, sizes = (UNITS_PER_M * of(self._ends_m, axis=1) for of in (np.mean, np.ptp))
        room = 1.4 * max(float(sizes[:2].max()), 0.02)  # of the box with its labels
        flat = self._layout == "2-D"
        columns = 1 if not flat else 2 if len(pictures) < 5 else 3
        rows = max(1, -(-len(pictures) // columns))
        height = room * (1.35 if rows > 2 else 1.0) / rows
        width = height * SIZE_INCHES[0] / SIZE_INCHES[1]
        left = middle[0] + (columns * width / 2 if flat else room / 2 + width)
        self._pictures = {}
        for i, (name, picture) in enumerate(pictures.items()):
            row, column = divmod(i, columns)
            up = ((rows - 1) / 2 - row) * height
            handle = self._server.scene.add_image(
                f"/pictures/{name}", picture.pixels, (1 - GAP) * width, (1 - GAP) * height,
                jpeg_quality=JPEG_QUALITY, cast_shadow=False, receive_shadow=False, wxyz=FACING,
                position=(left - (column + 0.5) * width, middle[1] + up, middle[2]),
            )  # fmt: skip
            self._pictures[name] = handle, picture
        ends = [] if flat else [middle[0] - room / 2, middle[0] + room / 2]
        if pictures:
            ends += [left - share * width for share in (GAP / 2, columns - GAP / 2)]
        centre = np.array([(min(ends) + max(ends)) / 2, middle[1], middle[2]])
        high, depth = max(room, (rows - GAP) * height), 0.0 if flat else float(sizes[2])
        self._view = centre, 1.04 * (max(ends) - min(ends)), 1.02 * high, depth
        self._place(self._server.initial_camera, PAGE_ASPECT)
        for client in self._server.get_clients().values():
            self._aim(client)

    def _connect(self, client: Any) -> None:
        """Aim a browser's camera, and anew when its scene's shape changes: a panel is docked."""
        self._aim(client)
        aimed_for = client.camera.aspect

        def moved(camera: Any) -> None:
            nonlocal aimed_for
            if not np.isclose(camera.aspect, aimed_for, rtol=0.02):
                aimed_for = camera.aspect
                self._aim(client)

        client.camera.on_update(moved)

    def _aim(self, client: Any) -> None:
        if self._view is not None:
            with client.atomic():
                self._place(client.camera, client.camera.aspect)

    def _place(self, camera: Any, aspect: float) -> None:
        """As the radar sees it: from the middle of the antennas' side, x to the left."""
        centre, width, height, depth = self._view
        away = max(height, width / max(aspect, 0.1)) / 2 / np.tan(FOV / 2) + depth / 2
        name = "up_direction" if hasattr(camera, "up_direction") else "up"
        setattr(camera, name, (0.0, 1.0, 0.0))
        camera.position = tuple(centre - [0.0, 0.0, away])
        camera.look_at = tuple(centre)
        camera.fov = FOV

    def _draw_box(self, ends_m: np.ndarray) -> None:
        """Draw the edges of the box, ticks with numbers along three of them, and their names."""
        if self._box is not None:
            self._box.remove()  # and with it the labels, its children
        self._ends_m = ends_m
        unit = unit_for(*ends_m.ravel())
        sizes = np.ptp(ends_m, axis=1)
        tick_m = 0.02 * float(sizes.max())
        corners = np.stack(np.meshgrid(*ends_m, indexing="ij"), axis=-1)
        segments = [np.moveaxis(corners, axis, 2).reshape(4, 2, 3) for axis in range(3)]
        texts, locator = [], InnerTicks(-1e-6)  # to which ends belong that rounding put beside
        low, high = ends_m[:, 0], ends_m[:, 1]
        # Below, at the left as the radar sees it, and to the right into the depth.
        edges = (
            ([0, low[1], low[2]], [0.0, -1.0, 0.0], "top-center"),
            ([high[0], 0, low[2]], [1.0, 0.0, 0.0], "center-right"),
            ([low[0], low[1], 0], [-1.0, -0.5, 0.0], "center-left"),
        )
        for axis, (corner, out, anchor) in enumerate(edges):
            if sizes[axis] == 0.0:
                continue
            locator.set_params(nbins=4 if axis < 2 or sizes[axis] > sizes.max() / 2 else 2)
            for value in np.round(locator.tick_values(*(unit.per_m * ends_m[axis])), 9):
                at = np.array(corner, float)
                at[axis] = value / unit.per_m
                ends = np.stack([at, at + tick_m * np.array(out)])
                segments.append(ends[None])
                texts.append((f"{value:g}", ends[1], anchor))
            # The name of z stands beyond its far end, where the numbers end.
            middle = np.array(corner, float)
            middle[axis] = ends_m[axis].mean() if axis < 2 else high[2]
            name = f"{'xyz'[axis]} ({unit.name})"
            beside = np.array([[0, -3, 0], [3.6, 0, 0], [-3, 3, 0]])[axis]
            texts.append((name, middle + tick_m * beside, anchor))
        scene = self._server.scene
        self._box = scene.add_line_segments(
            "/3-D/box", points=(UNITS_PER_M * np.concatenate(segments)).astype(np.float32),
            colors=BOX_COLOUR, thickness=1.0, thickness_units="screen",
        )  # fmt: skip
        for i, (text, at, anchor) in enumerate(texts):
            scene.add_label(
                f"/3-D/box/{i}", text, position=UNITS_PER_M * at, anchor=anchor,
                font_size_mode="scene", font_scene_height=UNITS_PER_M * 1.2 * tick_m,
            )  # fmt: skip


def draw_truth(scene: Any, truth: Truth | None) -> list[Any]:
    """Draw mesh and joints, where they are known, into the scene of viser; return their nodes."""
    nodes = []
    if truth is not None and truth.vertices_m is not None:
        nodes.append(
            scene.add_mesh_simple(
                "/3-D/truth/mesh", vertices=UNITS_PER_M * truth.vertices_m, faces=truth.faces,
                color=TRUTH_COLOUR, opacity=0.4, side="double",
            )
        )  # fmt: skip
    if truth is not None and truth.joints_m is not None:
        joints_m = truth.joints_m.reshape(-1, len(JOINT_NAMES), 3)
        ends = (UNITS_PER_M * joints_m[:, BONES].reshape(-1, 2, 3)).astype(np.float32)
        nodes.append(
            scene.add_line_segments(
                "/3-D/truth/joints", points=ends[np.isfinite(ends).all(axis=(1, 2))],
                colors=TRUTH_COLOUR, thickness=3.0, thickness_units="screen",
            )
        )  # fmt: skip
    return nodes
