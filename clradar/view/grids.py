"""Voxel grids for a live view: coarse enough to follow the hand on the slider."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from clradar.model import VoxelGrid, checks

LIVE_VOXELS = 500_000
"""Of the grid at the start: 2 mm on the paper's extent has 418 241."""

MOST_VOXELS = 2**24
"""Of any grid here: its image takes 128 MiB."""

Extent: TypeAlias = tuple[float, float]


def live_grid(placed: VoxelGrid) -> VoxelGrid:
    """Return a grid of the same extent with whole multiples of its steps, if it has many voxels."""
    factor = 1
    while True:
        counts = [(n - 1) // factor + 1 for n in placed.counts]
        if math.prod(counts) <= LIVE_VOXELS:
            nx, ny, nz = counts
            return VoxelGrid(placed.origin_m, factor * placed.spacing_m, (nx, ny, nz))
        factor += 1


def grid_mm(x_mm: Extent, y_mm: Extent, z_mm: Extent, step_mm: float) -> VoxelGrid:
    """Return the grid from the first ends on, as far as whole steps reach; millimetres.

    Raises
    ------
    ModelError
        Ends that descend, a step that is not positive, more than `MOST_VOXELS` voxels; otherwise as
        `VoxelGrid`.
    """
    step_mm = checks.positive("voxel size", step_mm)
    counts = []
    for name, (first, last) in zip("xyz", (x_mm, y_mm, z_mm), strict=True):
        if last < first:
            checks.fail(f"{name} (mm)", "first <= last", f"({first:g}, {last:g})")
        counts.append(math.floor((last - first) / step_mm + 1e-6) + 1)
    nx, ny, nz = counts
    if nx * ny * nz > MOST_VOXELS:
        checks.fail("grid", f"at most {MOST_VOXELS} voxels to view", f"{nx} x {ny} x {nz}")
    origin_m = 1e-3 * np.array([x_mm[0], y_mm[0], z_mm[0]])
    return VoxelGrid(origin_m, np.full(3, 1e-3 * step_mm), (nx, ny, nz))


def extents_mm(grid: VoxelGrid) -> tuple[Extent, Extent, Extent]:
    """Return the ends along x, y and z, millimetres, without digits of rounding."""
    x, y, z = (
        (round(1e3 * float(axis[0]), 6), round(1e3 * float(axis[-1]), 6))
        for axis in (grid.x_m, grid.y_m, grid.z_m)
    )
    return x, y, z
