"""Signed distances: rounded cones and their smooth union."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Slope = tuple[np.ndarray, np.ndarray]
"""Signed distances (N,), metres, and their gradients (N, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """A rounded cone: the convex hull of two spheres.

    Parameters
    ----------
    begin_m, end_m : ndarray, shape (3,), float64, metres
        Centres of the spheres; neither sphere may hold the other.
    begin_radius_m, end_radius_m : float, metres
    """

    begin_m: np.ndarray
    end_m: np.ndarray
    begin_radius_m: float
    end_radius_m: float

    def distance_m(self, points_m: np.ndarray) -> np.ndarray:
        """Return the exact signed distance (N,) of points (N, 3), negative inside, metres."""
        return self._nearest(points_m)[0]

    def slope(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return signed distances (N,), metres, and their gradients (N, 3), unit vectors."""
        distance_m, from_axis_m, foot_m = self._nearest(points_m)
        axis = (self.end_m - self.begin_m) / np.linalg.norm(self.end_m - self.begin_m)
        # The nearest of the spheres that the cone is made of stays the nearest for a small step.
        outward_m = points_m - self.begin_m - foot_m[:, None] * axis
        return distance_m, outward_m / np.maximum(from_axis_m, 1e-30)[:, None]

    def _nearest(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distance, and the nearest sphere: how far its centre is, and where on the axis."""
        axis_m = self.end_m - self.begin_m
        length_m = float(np.linalg.norm(axis_m))
        from_begin_m = points_m - self.begin_m
        # The problem in the half plane (t, q): along the axis, and away from it.
        # No matrix product: those round by the number of points.
        t_m = np.einsum("ij,j->i", from_begin_m, axis_m / length_m)
        squared_m2 = np.einsum("ij,ij->i", from_begin_m, from_begin_m)
        q_m = np.sqrt(np.maximum(squared_m2 - t_m * t_m, 0.0))
        sine = (self.begin_radius_m - self.end_radius_m) / length_m
        cosine = np.sqrt(1.0 - sine * sine)
        # Foot of the point on the axis, seen along the normal of the cone's flank.
        foot_m = np.clip(t_m - q_m * (sine / cosine), 0.0, length_m)
        from_axis_m = np.hypot(t_m - foot_m, q_m)
        return from_axis_m - (self.begin_radius_m - sine * foot_m), from_axis_m, foot_m

    def reach_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner (3,) of the bounding box, metres."""
        low_m = np.minimum(
            self.begin_m - self.begin_radius_m,
            self.end_m - self.end_radius_m,
        )
        high_m = np.maximum(
            self.begin_m + self.begin_radius_m,
            self.end_m + self.end_radius_m,
        )
        return low_m, high_m


def smooth_minimum(a_m: np.ndarray, b_m: np.ndarray, blend_m: float) -> np.ndarray:
    """Return a minimum without crease where |a - b| < `blend_m` (quadratic polynomial).

    At most `blend_m` / 4 lower than the minimum, equal to it elsewhere, and no steeper than the
    steeper of both, so that a smooth union of distances never overestimates a distance.
    """
    overlap_m = np.maximum(blend_m - np.abs(a_m - b_m), 0.0)
    return np.minimum(a_m, b_m) - overlap_m * overlap_m * (0.25 / blend_m)


def smooth_slope(a: Slope, b: Slope, blend_m: float) -> Slope:
    """Return `smooth_minimum` of two distances with its gradient, from theirs."""
    overlap_m = np.maximum(blend_m - np.abs(a[0] - b[0]), 0.0)
    value_m = np.minimum(a[0], b[0]) - overlap_m * overlap_m * (0.25 / blend_m)
    share = overlap_m * (0.5 / blend_m)
    of_b = np.where(a[0] <= b[0], share, 1.0 - share)[:, None]
    return value_m, a[1] + of_b * (b[1] - a[1])
