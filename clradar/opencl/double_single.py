"""How float64 on the host becomes float32 for the kernels without losing the carrier's phase."""

from __future__ import annotations

from typing import Any

import numpy as np


def hi_lo(values: Any) -> tuple[Any, Any]:
    """Split float64 into two float32 whose sum is it, to 2^-48 of its size."""
    hi = np.float32(values)
    return hi, np.float32(values - np.float64(hi))


def antenna_rows(positions_m: np.ndarray) -> np.ndarray:
    """Return antennas, shape (n, 3), as shape (n, 6) float32: x, y, z as hi, then as lo."""
    return np.concatenate(hi_lo(positions_m), axis=1)
