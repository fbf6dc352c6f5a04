"""Places, lengths and grids in words, for warnings."""

from __future__ import annotations

import numpy as np

from clradar.model import VoxelGrid
from clradar.model.length_unit import METRES, unit_for


def place_words(at_m: np.ndarray) -> str:
    unit = unit_for(*at_m)
    decimals = 3 if unit is METRES else 0
    values = [round(unit.per_m * v, decimals) + 0.0 for v in at_m]  # + 0.0: no minus zero
    places = ", ".join(f"{n} {v:.{decimals}f}" for n, v in zip("xyz", values, strict=True))
    return f"{places} {unit.name}"


def length_words(length_m: float) -> str:
    unit = unit_for(length_m)
    return f"{unit.per_m * length_m:.4g} {unit.name}"


def lengths_words(lengths_m: np.ndarray) -> str:
    """Lengths along x, y and z."""
    unit = unit_for(*lengths_m)
    return f"{' x '.join(f'{unit.per_m * v:.3g}' for v in lengths_m)} {unit.name}"


def box_words(grid: VoxelGrid) -> str:
    ends = [getattr(grid, f"{name}_m")[[0, -1]] for name in "xyz"]
    unit = unit_for(*np.ravel(ends))
    ends = [unit.per_m * pair for pair in ends]
    parts = [f"{n} {a:g} to {b:g}" for n, (a, b) in zip("xyz", ends, strict=True)]
    return f"{', '.join(parts)} {unit.name}"
