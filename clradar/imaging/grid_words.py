"""Places, lengths and grids in words, for warnings."""

from __future__ import annotations

import numpy as np

from clradar.model import VoxelGrid


def _unit(*lengths_m: float) -> tuple[str, float, int]:
    """Metres from 1 m on, else millimetres: name, factor, decimals."""
    return ("m", 1.0, 3) if max(map(abs, lengths_m)) >= 1 else ("mm", 1e3, 0)


def place_words(at_m: np.ndarray) -> str:
    unit, scale, decimals = _unit(*at_m)
    values = [round(scale * v, decimals) + 0.0 for v in at_m]  # + 0.0: no minus zero
    return (
        ", ".join(f"{n} {v:.{decimals}f}" for n, v in zip("xyz", values, strict=True)) + f" {unit}"
    )


def length_words(length_m: float) -> str:
    unit, scale, _ = _unit(length_m)
    return f"{scale * length_m:.4g} {unit}"


def lengths_words(lengths_m: np.ndarray) -> str:
    """Lengths along x, y and z."""
    unit, scale, _ = _unit(*lengths_m)
    return f"{' x '.join(f'{scale * v:.3g}' for v in lengths_m)} {unit}"


def box_words(grid: VoxelGrid) -> str:
    ends = [getattr(grid, f"{name}_m")[[0, -1]] for name in "xyz"]
    unit, scale, _ = _unit(*np.ravel(ends))
    parts = [f"{n} {scale * a:g} to {scale * b:g}" for n, (a, b) in zip("xyz", ends, strict=True)]
    return f"{', '.join(parts)} {unit}"
