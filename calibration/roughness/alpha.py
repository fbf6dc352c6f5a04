"""Alpha of a region with its interval, from statistics of an image's brightness.

A smooth surface is bright where it faces the antennas and dark elsewhere; the rougher, the more
even and grainy. So what counts is the power at each tilt of the surface, the contrast, and how much
of it is nearly as bright as the brightest place: all relative to the region's own mean, so that the
gain of an instrument is of no account. Of these statistics mean and covariance are smooth in alpha.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special
from scipy.ndimage import map_coordinates

from calibration.roughness.emulator import Emulator, Fit, Interval, fit_probability, plain
from calibration.roughness.surface_points import SurfacePoints, contrast, tilt_bins
from clradar.model import AntennaArray, DepthMap

LEAST_IN_BIN = 20  # points, of the tilt
LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)  # below the brightest point
DARK = 1e-12  # power of a point that is 0, relative to the mean
PLACEMENT_STD_M = 1e-3  # how well a mesh is taken to be in its place, along x and y each
GRID = 1001  # alphas at which the likelihood is computed
SMOOTH = 0.07  # alphas far below it look like 0
MOST_POWER = 3
FLOOR = 0.05  # standard deviation of a logarithm that no simulation has: 5 %

NOT_SIMULATED = 1.7
"""Of the variance by this and by the mesh's place: so 95 % of the intervals hold the truth where it
is off by 1.6 mm, too."""

EDGE_LIKELIHOOD = 0.1
"""Of an end of the range, relative to the highest, above which the truth may lie beyond."""


class BrightnessMeter:
    """Measures the statistics of a region, or of the whole: in the image, at its surface's points.

    `names` are of what `measure` returns, natural logarithms.
    """

    def __init__(self, points: SurfacePoints, region: int | None, array: AntennaArray) -> None:
        mine = np.ones(len(points.region), bool) if region is None else points.region == region
        self._points_m = points.points_m[mine, :2]
        self.n_points = len(self._points_m)
        self.bins = tilt_bins(points.tilts([array])[0, mine], LEAST_IN_BIN)
        self.names = (
            *(f"power at {tilt}" for tilt in [*self.bins][:-1]),  # the last follows from the rest
            "contrast",
            *(f"points within {level:g} dB" for level in LEVELS_DB),
        )

    def sees(self, image: DepthMap) -> bool:
        """Whether anything of the region is bright."""
        return bool(self._amplitude(image, (0.0, 0.0)).any())

    def measure(self, image: DepthMap, shift_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Return the statistics, with the surface displaced along x and y."""
        power = self._amplitude(image, shift_m).astype(np.float64) ** 2
        power = power / power.mean() + DARK
        bins = self.bins.values()
        means = [power[own].mean() for own in bins]
        near = [np.count_nonzero(power > power.max() * 10 ** (-level / 10)) for level in LEVELS_DB]
        return np.array([*np.log(means[:-1]), contrast(power, bins), *np.log(near)])

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
        return np.asarray(map_coordinates(image.amplitude, at, order=1, mode="nearest"))


@dataclass(frozen=True, slots=True, eq=False)
class AlphaEstimate:
    """Alpha of a region, from simulations at several alphas.

    Attributes
    ----------
    name : str
        Of the region; "all" for the whole mesh.
    interval : Interval
        `median`, limits `low` and `high` of 68 %, `low95` and `high95` of 95 %; `bounded_below` and
        `bounded_above` where the swept range ends.
    alphas, probability : ndarray, shape (1001,)
    fit : Fit
        `statistics`, `measured` and `fitted`, with their `spread`; `probability` of as bad a fit.
    """

    name: str
    interval: Interval
    alphas: np.ndarray
    probability: np.ndarray
    fit: Fit

    @property
    def alpha(self) -> float:
        """The median."""
        return self.interval.median

    @property
    def uncertainty(self) -> float:
        """Half of the interval of 68 %."""
        return self.interval.std

    def text(self) -> str:
        """Alpha and its uncertainty."""
        return self.interval.text(1.0, "")

    def remarks(self) -> list[str]:
        """Reasons to doubt the estimate, one clause each."""
        interval, (first, last) = self.interval, self.alphas[[0, -1]]
        ends = ((first, interval.bounded_below), (last, interval.bounded_above))
        beyond = "alpha may lie beyond {:g}, an end of its range: take a wider range"
        doubts = self.fit.remarks("another pose or shape, several alphas")
        return [*(beyond.format(end) for end, bounded in ends if bounded), *doubts]

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has."""
        return {"text": self.text(), "uncertainty": plain(self.uncertainty), **plain(self)}


def estimate_alpha(
    name: str,
    statistics: tuple[str, ...],
    measured: np.ndarray,
    alphas: np.ndarray,
    simulated: np.ndarray,
    displaced: np.ndarray,
    n_points: int,
) -> AlphaEstimate:
    """Return the alpha of a region whose statistics were measured.

    `simulated` are those of simulations with these `alphas`, shape (n, n_statistics), and
    `displaced` their variance by a mesh that is not quite in its place.
    """
    levels, number = np.unique(alphas, return_inverse=True)
    most = max(0, min(MOST_POWER, len(levels) - 1, len(alphas) - 3))
    emulator = Emulator.fitted(_coordinate(alphas), np.arange(most + 1)[:, None], simulated)
    first, last = levels[[0, -1]]
    tried = np.linspace(first, last, GRID)
    at = _coordinate(tried)
    of_level = [displaced[number == i].mean(axis=0) for i in range(len(levels))]
    by_place = np.stack([np.interp(tried, levels, one) for one in np.transpose(of_level)], axis=-1)
    variance = NOT_SIMULATED * (FLOOR**2 + by_place)
    found = emulator.log_likelihood(measured, at, variance=variance)
    likelihood, chi2 = (values[:, 0] for values in found)
    probability = special.softmax(likelihood)
    ends = probability[[0, -1]] > EDGE_LIKELIHOOD * probability.max()
    # Beyond 0 and 1 there is nothing.
    bounded = (bool(ends[0] and first > 0), bool(ends[1] and last < 1))
    best = int(np.argmax(likelihood))
    mean, spread = emulator.at(at[best], variance[best])
    as_bad = fit_probability(float(chi2[best]), len(measured) - 1, emulator.freedom)
    fit = Fit(statistics, measured, mean, spread, as_bad, n_points)
    return AlphaEstimate(name, Interval.of(tried, probability, bounded), tried, probability, fit)


def _coordinate(alphas: np.ndarray) -> np.ndarray:
    """In which the statistics are polynomials."""
    return 0.5 * np.log(np.square(alphas) + SMOOTH**2)[:, None]
