"""What is wished to be shown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.model import VoxelGrid

Place: TypeAlias = tuple[float, float, float]

BY_ALPHA = "by \N{GREEK SMALL LETTER ALPHA}"
"""The choice of material that takes the roughness of the paper instead."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is to be shown.

    Attributes
    ----------
    frame : int
        Its number in the source.
    grid : VoxelGrid or None
        Of images of captures. None: one that shows the object of the first of them (`live_grid`).
        Volumes have theirs.
    method, window : str
        As `clradar.backproject` takes them.
    dynamic_range_db : float, decibel
    voxels : bool
        Show voxels instead of depth points.
    at_m : tuple of three floats or None, metres
        Where the slices meet; None: in the strongest voxel.
    tx, rx : int
        The pair whose channel data are shown.
    side : {"both", "measured", "simulated"}
        What is shown where there is a second image.
    other : int
        Which of several second images.
    alpha : float
    material : str
        Of a mesh that is simulated; one of `clradar.view.beside.MATERIALS`.
    """

    frame: int = 0
    grid: VoxelGrid | None = None
    method: str = "fast"
    window: str = "rect"
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    voxels: bool = False
    at_m: Place | None = None
    tx: int = 0
    rx: int = 0
    side: str = "both"
    other: int = 0
    alpha: float = 0.5
    material: str = BY_ALPHA
