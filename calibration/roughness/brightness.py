"""Statistics of an image's brightness that tell alpha, and no pixel of its speckle.

A smooth surface is bright where it faces the antennas and dark elsewhere; the rougher, the more
even and grainy. So what counts is the power at each tilt of the surface, the contrast, and how much
of it is nearly as bright as the brightest place: all relative to the region's own mean, so that the
gain of an instrument is of no account.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from calibration.roughness.surface_points import SurfacePoints
from calibration.roughness.texture import TILT_EDGES_DEG
from clradar.model import AntennaArray, DepthMap

LEAST_IN_BIN = 20
"""Points in a bin of the tilt."""

LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)
"""Below the brightest point."""

DARK = 1e-12
"""Power of a point that is 0, relative to the mean."""

PLACEMENT_STD_M = 1e-3
"""How well a mesh is taken to be in its place, along x and y each."""


class BrightnessMeter:
    """Measures the statistics of a region, or of the whole: in the image, at its surface's points.

    Attributes
    ----------
    names : tuple of str
        Of what `measure` returns; logarithms are natural.
    """

    def __init__(self, points: SurfacePoints, region: int | None, array: AntennaArray) -> None:
        mine = np.ones(len(points.region), bool) if region is None else points.region == region
        self._points_m = points.points_m[mine, :2]
        number = np.digitize(np.degrees(points.tilts([array])[0, mine]), TILT_EDGES_DEG) - 1
        bins = {i: number == i for i in range(len(TILT_EDGES_DEG) - 1)}
        self._bins = {i: own for i, own in bins.items() if np.count_nonzero(own) >= LEAST_IN_BIN}
        tilts = [f"{TILT_EDGES_DEG[i]:g} to {TILT_EDGES_DEG[i + 1]:g}" for i in self._bins]
        self.names = (
            *(f"power at {tilt} degrees" for tilt in tilts[:-1]),  # the last follows from the rest
            "contrast",
            *(f"points within {level:g} dB" for level in LEVELS_DB),
        )

    @property
    def n_points(self) -> int:
        return len(self._points_m)

    @property
    def has_bins(self) -> bool:
        """Whether any bin of the tilt has enough points."""
        return bool(self._bins)

    def sees(self, image: DepthMap) -> bool:
        """Whether anything of the region is bright."""
        return bool(self._amplitude(image, (0.0, 0.0)).any())

    def measure(self, image: DepthMap, shift_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Return the statistics, shape (n_statistics,).

        `shift_m` displaces the surface along x and y.
        """
        power = self._amplitude(image, shift_m).astype(np.float64) ** 2
        power = power / power.mean() + DARK
        bins = self._bins.values()
        means = [power[own].mean() for own in bins]
        grain = [np.log(power[own]).mean() - np.log(power[own].mean()) for own in bins]
        counts = [np.count_nonzero(own) for own in bins]
        near = [np.count_nonzero(power > power.max() * 10 ** (-level / 10)) for level in LEVELS_DB]
        return np.array([*np.log(means[:-1]), np.average(grain, weights=counts), *np.log(near)])

    def displaced(self, image: DepthMap) -> np.ndarray:
        """Return the variance of the statistics by a mesh that is not quite in its place."""
        middle = self.measure(image)
        variance = np.zeros_like(middle)
        for x, y in ((PLACEMENT_STD_M, 0.0), (0.0, PLACEMENT_STD_M)):
            one, other = self.measure(image, (x, y)), self.measure(image, (-x, -y))
            variance += ((one - other) ** 2 + (one + other - 2 * middle) ** 2) / 4
        return variance

    def _amplitude(self, image: DepthMap, shift_m: tuple[float, float]) -> np.ndarray:
        places_m = self._points_m + shift_m
        at = [
            (places_m[:, axis] - axis_m[0]) / (axis_m[1] - axis_m[0])
            for axis, axis_m in ((1, image.y_m), (0, image.x_m))
        ]
        read: np.ndarray = map_coordinates(image.amplitude, at, order=1, mode="nearest")
        return read
