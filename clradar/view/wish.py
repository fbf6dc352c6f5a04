"""What is wished to be shown, and the voxel grids that images of captures begin with."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.model import VoxelGrid, checks

Place: TypeAlias = tuple[float, float, float]

BY_ALPHA = "by \N{GREEK SMALL LETTER ALPHA}"  # in place of a material: the paper's roughness

LAYOUTS = ("2-D and 3-D", "2-D", "3-D")

SIDES = ("Both", "Measured", "Simulated")  # in the order in which the key B goes through them
LIVE_VOXELS = 500_000  # of the grid at the start: 2 mm on the paper's extent has 418 241
QUICK_DB = -30.0
"""Tolerance of images of followed frames: the depth of a hand is 0.07 mm off in the median, and
the image takes 0.6 of the time."""

MOST_VOXELS = 2**24  # of any grid here: its image takes 128 MiB


@dataclass(frozen=True, slots=True)
class Wish:
    """What is to be shown: a frame by its number in the source, and how.

    A grid, of images of captures, is None until one shows the object of the first of them
    (`live_grid`); `at_m` is where slices meet, None in the strongest voxel; `tx` and `rx` are the
    pair whose channel data are shown; `side` is one of `SIDES`, `other` one of several second
    images, `alpha` and `material` those of a mesh that is simulated. Method, window and tolerance
    are those of `clradar.backproject`. A `quick` image is one of `QUICK_DB`, unless a tolerance is
    given: of frames that are followed.
    """

    frame: int = 0
    grid: VoxelGrid | None = None
    method: str = "fast"
    window: str = "rect"
    tolerance_db: float | None = None
    quick: bool = False
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    voxels: bool = False
    at_m: Place | None = None
    tx: int = 0
    rx: int = 0
    side: str = SIDES[0]
    other: int = 0
    alpha: float = 0.5
    material: str = BY_ALPHA
    layout: str = LAYOUTS[0]

    @property
    def image_db(self) -> float | None:
        """The tolerance of images of captures; None: the usual one, or none for the method."""
        if self.method != "fast":
            return None
        return QUICK_DB if self.quick and self.tolerance_db is None else self.tolerance_db


def live_grid(placed: VoxelGrid) -> VoxelGrid:
    """Return a grid of the same extent with whole multiples of its steps, if it has many voxels."""
    for factor in itertools.count(1):
        nx, ny, nz = ((n - 1) // factor + 1 for n in placed.counts)
        if nx * ny * nz <= LIVE_VOXELS:
            return VoxelGrid(placed.origin_m, factor * placed.spacing_m, (nx, ny, nz))
    raise AssertionError


def grid_mm(x_mm: Any, y_mm: Any, z_mm: Any, step_mm: float) -> VoxelGrid:
    """Return the grid between two ends each, from the first as far as whole steps reach; mm."""
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


def escaped(text: str) -> str:
    """Return text of a file so that Markdown and HTML show it as it is."""
    return "".join(f"&#{ord(c)};" if c in "\\`*_{}[]<>()#+!|&~$" else c for c in text)
