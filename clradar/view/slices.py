"""The three slices through a place of a volume, and the place that is clicked in the scene."""

from __future__ import annotations

import numpy as np

from clradar.model import Volume, VoxelGrid
from clradar.view.framed import Axis, framed
from clradar.view.pictures import amplitude_bar, amplitude_pixels, length_axes
from clradar.view.wish import Place

REACH = 2.0
"""A click hits what is within so many voxels of its ray."""


def strongest_m(volume: Volume) -> Place:
    """Return the centre of the strongest voxel, metres."""
    grid = volume.grid
    z, y, x = np.unravel_index(int(np.abs(volume.data).argmax()), volume.data.shape)
    return float(grid.x_m[x]), float(grid.y_m[y]), float(grid.z_m[z])


def clicked_m(
    points_m: np.ndarray, origin_m: np.ndarray, direction: np.ndarray, voxel_m: float
) -> Place | None:
    """Return the point that a ray meets first, None where it meets none.

    Parameters
    ----------
    points_m : ndarray, shape (n, 3), metres
    origin_m, direction : ndarray, shape (3,)
    voxel_m : float, metres
        Size of the points.
    """
    direction = direction / np.linalg.norm(direction)
    from_eye = points_m.astype(np.float64) - origin_m
    along = from_eye @ direction
    aside = np.linalg.norm(from_eye - along[:, None] * direction, axis=1)
    hit = np.flatnonzero((aside <= REACH * voxel_m) & (along > 0))
    if len(hit) == 0:
        return None
    # Of what is met, the nearest to the ray in the layer nearest to the eye.
    layer = hit[along[hit] <= along[hit].min() + REACH * voxel_m]
    x, y, z = points_m[layer[aside[layer].argmin()]]
    return float(x), float(y), float(z)


def pointed_m(volume: Volume, at_m: Place, drawing: str, across: float, down: float) -> Place:
    """Return the voxel that a click on a drawing means, metres.

    Parameters
    ----------
    volume : Volume
    at_m : tuple of three floats, metres
        Where the slices are now.
    drawing : {"projection", "xy", "xz", "zy"}
        In a projection it is the strongest voxel along z.
    across, down : float
        From 0 at the left and upper edge to 1.
    """
    grid = volume.grid
    i, j, k = _nearest(grid, at_m)
    nx, ny, nz = grid.counts

    def index(share: float, n: int) -> int:
        return min(n - 1, max(0, int(share * n)))

    if drawing != "zy":
        i = nx - 1 - index(across, nx)
    else:
        k = index(across, nz)
    if drawing != "xz":
        j = ny - 1 - index(down, ny)
    else:
        k = nz - 1 - index(down, nz)
    if drawing == "projection":
        k = int(np.abs(volume.data[:, j, i]).argmax())
    return float(grid.x_m[i]), float(grid.y_m[j]), float(grid.z_m[k])


def _nearest(grid: VoxelGrid, at_m: Place) -> tuple[int, int, int]:
    i, j, k = (
        int(np.abs(axis - value).argmin())
        for axis, value in zip((grid.x_m, grid.y_m, grid.z_m), at_m, strict=True)
    )
    return i, j, k


def slice_drawings(volume: Volume, at_m: Place, dynamic_range_db: float) -> tuple[str, str, str]:
    """Return x-y, x-z and z-y slices through the voxel nearest to a place, as SVG.

    x is to the left, as the radar sees it, z away from it. Levels are relative to the volume's
    strongest voxel.
    """
    grid = volume.grid
    i, j, k = _nearest(grid, at_m)
    unit, (x, y, z) = length_axes({"x": grid.x_m, "y": grid.y_m, "z": grid.z_m})
    at_x, at_y, at_z = (
        round(unit.per_m * float(v), 6) for v in (grid.x_m[i], grid.y_m[j], grid.z_m[k])
    )
    peak = float(np.abs(volume.data).max())
    bar = amplitude_bar(dynamic_range_db)
    left = Axis(x.name, x.last, x.first)

    def drawn(
        name: str, title: str, rows: np.ndarray, across: Axis, up: Axis, *marked: float
    ) -> str:
        pixels = amplitude_pixels(np.abs(rows), peak, dynamic_range_db)
        return framed(title, pixels, across, up, bar, marked=(marked[0], marked[1]), clicked=name)

    return (
        drawn("xy", f"z = {at_z:g} {unit.name}", volume.data[k, ::-1, ::-1], left, y, at_x, at_y),
        drawn("xz", f"y = {at_y:g} {unit.name}", volume.data[::-1, j, ::-1], left, z, at_x, at_z),
        drawn("zy", f"x = {at_x:g} {unit.name}", volume.data[:, ::-1, i].T, z, y, at_z, at_y),
    )
