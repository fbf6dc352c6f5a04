"""The float64 reference of a posed hand's flesh, from the cones that the hand is made of."""

import numpy as np
from flesh_reference import flesh_distance_m

from clradar.hand.flesh import Cone, Flesh

STEP_M = 1e-6
"""Of the central differences: rounding of distances near 0.1 m, 1e-17 m, is 1e-11 of it."""


def rows(cones: tuple[Cone, ...]) -> np.ndarray:
    """Return cones as the reference takes them, shape (n_cones, 8)."""
    return np.array([[*c.begin_m, *c.end_m, c.begin_radius_m, c.end_radius_m] for c in cones])


def digits(flesh: Flesh) -> np.ndarray:
    return np.stack([rows(r + e) for r, e in zip(flesh.roots, flesh.ends, strict=True)])


def distances_m(flesh: Flesh, points_m: np.ndarray) -> np.ndarray:
    """Return the signed distances (N,) of points (N, 3)."""
    return flesh_distance_m(points_m, flesh.forearm, rows(flesh.palm), digits(flesh))


def gradients(flesh: Flesh, points_m: np.ndarray) -> np.ndarray:
    """Return the gradients (N, 3) of the distances, by central differences."""
    ahead, behind = (
        [distances_m(flesh, points_m + s * STEP_M * axis) for axis in np.eye(3)] for s in (1, -1)
    )
    return (np.stack(ahead, axis=1) - np.stack(behind, axis=1)) / (2 * STEP_M)
