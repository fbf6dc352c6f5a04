"""Round cones: the convex hulls of two spheres, of which the hand's flesh is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """A round cone: the convex hull of two spheres, neither of which may hold the other."""

    begin_m: np.ndarray
    end_m: np.ndarray
    begin_radius_m: float
    end_radius_m: float

    def bounds_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner (3,) of the bounding box, metres."""
        low_m = np.minimum(self.begin_m - self.begin_radius_m, self.end_m - self.end_radius_m)
        high_m = np.maximum(self.begin_m + self.begin_radius_m, self.end_m + self.end_radius_m)
        return low_m, high_m
