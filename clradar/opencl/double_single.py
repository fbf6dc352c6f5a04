"""Double-single numbers: a float64 as the unevaluated sum of two float32 (``common/dual.h``)."""

from __future__ import annotations

from typing import Any

import numpy as np


def hi_lo(values: Any) -> tuple[Any, Any]:
    """Split float64 into two float32 whose sum equals it to 2^-48, relative."""
    hi = np.asarray(values, np.float32)[()]  # of one number np.float32 warns (numpy 1.26)
    return hi, np.asarray(values - np.asarray(hi, np.float64), np.float32)[()]


def antenna_rows(positions_m: np.ndarray) -> np.ndarray:
    """Antennas, shape (n, 3), as float32 of shape (n, 6): x, y, z as hi, then as lo."""
    return np.concatenate(hi_lo(positions_m), axis=1)
