"""Views of a volume: the axis that it is projected along, and what is drawn of the other two."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from clradar.compare.images import depth_map_of
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, VoxelGrid, checks
from clradar.model.length_unit import unit_for

THIN = 1 / 8
"""An axis is thin where its extent is at most this share of either other axis' extent. Along the
paper's z it is 2 / 5; a projection along an axis that is not thin is at least an eighth as high as
wide."""


class View(NamedTuple):
    """The axes drawn to the left and upwards, and the axis of the projection."""

    horizontal: str
    vertical: str
    along: str


VIEWS = {"xy": View("x", "y", "z"), "xz": View("x", "z", "y"), "yz": View("z", "y", "x")}
"""As the radar sees the scene; from above, with the radar below; from the side, with the radar to
the left. x increases to the left, as in all pictures, z away from the radar."""

FRONT = VIEWS["xy"]


def view_of(image: Volume | DepthMap, name: str | None) -> View:
    """The view of a name; None: along the thin axis of a volume, along z if there is none."""
    if name is None:
        return VIEWS[thin_view(image.grid)] if isinstance(image, Volume) else FRONT
    checks.one_of("view", name, tuple(VIEWS))
    if name != "xy" and isinstance(image, DepthMap):
        raise CompareError(f"view: expected 'xy', which a depth map is, got {name!r}")
    return VIEWS[name]


def thin_view(grid: VoxelGrid) -> str:
    """The view along the thin axis of a grid; "xy" if none is thin, or z is."""
    extents = grid.spacing_m * (np.array(grid.counts) - 1)
    for name, axis in (("xy", 2), ("xz", 1), ("yz", 0)):
        if extents[axis] <= THIN * np.delete(extents, axis).min():
            return name
    return "xy"


def plane_of(volume: Volume, axis: str, at_m: float | None = None) -> Volume:
    """Return the plane of voxels across an axis, "x", "y" or "z", that is nearest to a place.

    By default through the strongest voxel. A place outside of the volume is a `CompareError`.
    """
    checks.instance("plane_of: volume", volume, Volume)
    checks.one_of("plane_of: axis", axis, ("x", "y", "z"))
    grid, number = volume.grid, "xyz".index(axis)
    if at_m is None:
        index = int(np.unravel_index(np.abs(volume.data).argmax(), volume.data.shape)[2 - number])
    else:
        index = plane_index(grid, axis, checks.real("plane_of: at_m", at_m))
    origin_m, counts = grid.origin_m.copy(), list(grid.counts)
    origin_m[number], counts[number] = getattr(grid, f"{axis}_m")[index], 1
    data = np.take(volume.data, [index], axis=2 - number)
    plane = VoxelGrid(origin_m, grid.spacing_m, (counts[0], counts[1], counts[2]))
    return replace(volume, data=data, grid=plane)


def plane_index(grid: VoxelGrid, axis: str, at_m: float) -> int:
    """The number of the plane that is nearest to a place, which is in the grid."""
    places_m, step_m = getattr(grid, f"{axis}_m"), grid.spacing_m["xyz".index(axis)]
    index = round((at_m - places_m[0]) / step_m)
    if not 0 <= index < len(places_m):
        unit = unit_for(at_m, *places_m[[0, -1]])
        first, last, at = (unit.per_m * v for v in (places_m[0], places_m[-1], at_m))
        raise CompareError(
            f"slice: expected {axis} from {first:g} to {last:g} {unit.name}, got {at:g}"
        )
    return index


def rcs_image(image: Volume | DepthMap) -> Volume:
    """Return a volume whose squared amplitude is in m^2."""
    if not isinstance(image, Volume):
        raise CompareError("dbsm: expected a Volume, got a DepthMap, whose amplitude is relative")
    return image.as_rcs()


def projected(
    image: Volume | DepthMap, view: View, dynamic_range_db: float, label: str
) -> DepthMap:
    """The maximum along the view's axis, with that axis' coordinate as depth.

    `x_m` and `y_m` of the result are the axes drawn to the side and upwards.
    """
    if view is FRONT or not isinstance(image, Volume):
        return depth_map_of(image, dynamic_range_db, label)
    axes = ["xyz".index(name) for name in view]
    grid = image.grid
    counts = cast("tuple[int, int, int]", tuple(grid.counts[axis] for axis in axes))
    turned = VoxelGrid(grid.origin_m[axes], grid.spacing_m[axes], counts)
    data = image.data.transpose([2 - axis for axis in reversed(axes)])
    return depth_map_of(Volume(data, turned), dynamic_range_db, label)
