"""A hand's shape as eight logarithms of factors, and their spread among adults."""

from __future__ import annotations

import numpy as np

from clradar.hand import HandShape
from clradar.hand.shape import AVERAGE, BREADTH_LIMITS_M, FACTOR_LIMITS, LENGTH_LIMITS_M

SHAPE_NAMES = ("length", "breadth", "thumb", "index", "middle", "ring", "pinky", "girth")

N_SHAPE = len(SHAPE_NAMES)

SHAPE_STD = np.array([0.063, 0.082, 0.024, 0.024, 0.024, 0.024, 0.024, 0.045])
"""Standard deviations among adults of both sexes (`clradar.hand.random_shape` has the sources)."""

LENGTH_BREADTH_CORRELATION = 0.8  # among both sexes together; 0.6 within one


def vector_of(shape: HandShape) -> np.ndarray:
    """Logarithms of the factors to the average hand, shape (8,)."""
    return np.log(
        [
            shape.length_m / AVERAGE.length_m,
            shape.breadth_m / AVERAGE.breadth_m,
            *shape.finger_lengths,
            shape.girth,
        ]
    )


def shape_of(vector: np.ndarray) -> HandShape:
    """The shape of these logarithms, (8,), within the limits of `HandShape`."""
    factors = np.exp(vector)
    fingers = np.clip(factors[2:7], *FACTOR_LIMITS)
    return HandShape(
        float(np.clip(factors[0] * AVERAGE.length_m, *LENGTH_LIMITS_M)),
        float(np.clip(factors[1] * AVERAGE.breadth_m, *BREADTH_LIMITS_M)),
        (fingers[0], fingers[1], fingers[2], fingers[3], fingers[4]),
        float(np.clip(factors[7], *FACTOR_LIMITS)),
    )


def shape_covariance() -> np.ndarray:
    """Covariance of the vector among adults, (8, 8)."""
    correlation = np.eye(N_SHAPE)
    correlation[0, 1] = correlation[1, 0] = LENGTH_BREADTH_CORRELATION
    return correlation * np.outer(SHAPE_STD, SHAPE_STD)
