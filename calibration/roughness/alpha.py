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
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates

from calibration.roughness.emulator import (
    Fit,
    Interval,
    fit_probability,
    plain,
    shrunk,
    student_log_density,
    whitening,
)
from calibration.roughness.surface_points import TILT_EDGES_DEG, SurfacePoints, tilt_bins
from clradar.model import AntennaArray, DepthMap

LEAST_IN_BIN = 20
"""Points in a bin of the tilt."""

LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)
"""Below the brightest point."""

DARK = 1e-12
"""Power of a point that is 0, relative to the mean."""

PLACEMENT_STD_M = 1e-3
"""How well a mesh is taken to be in its place, along x and y each."""

GRID = 1001
"""Alphas at which the likelihood is computed."""

WIDENED = 1.3
"""Of the standard deviations, which few seeds tell badly."""

INTERPOLATION_SHARE = 0.25
"""Of the error that the mean at a simulated alpha would have without it, half-way between two."""

FLOOR = 0.05
"""Least standard deviation of a statistic, a natural logarithm: 5 %."""

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
        tilts = [f"{TILT_EDGES_DEG[i]:g} to {TILT_EDGES_DEG[i + 1]:g}" for i in self.bins]
        self.names = (
            *(f"power at {tilt} degrees" for tilt in tilts[:-1]),  # the last follows from the rest
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
        grain = [np.log(power[own]).mean() - np.log(power[own].mean()) for own in bins]
        contrast = np.average(grain, weights=[np.count_nonzero(own) for own in bins])
        near = [np.count_nonzero(power > power.max() * 10 ** (-level / 10)) for level in LEVELS_DB]
        return np.array([*np.log(means[:-1]), contrast, *np.log(near)])

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
class AlphaEmulator:
    """Mean and covariance of statistics over alpha, arrays of shape (n_alphas, n_statistics)."""

    alphas: np.ndarray
    mean: np.ndarray
    variance: np.ndarray  # of a measurement from this mean
    interpolation: np.ndarray  # what the mean would be off by, interpolated between the others
    correlation: np.ndarray
    freedom: int

    @classmethod
    def fitted(
        cls, alphas: np.ndarray, statistics: np.ndarray, displaced: np.ndarray
    ) -> AlphaEmulator:
        """Fit to simulations, shape (n_seeds, n_alphas, n_statistics).

        `displaced` is their variance by a mesh that is not quite in its place.
        """
        n_seeds, n_alphas, n = statistics.shape
        mean = statistics.mean(axis=0)
        without = np.zeros_like(mean)
        for i in range(1, n_alphas - 1):
            others = np.arange(n_alphas) != i
            foretold = PchipInterpolator(alphas[others], mean[others], axis=0)(alphas[i])
            without[i] = foretold - mean[i]
        if n_seeds > 1:
            left = statistics - mean
            freedom = n_alphas * (n_seeds - 1)
            own = left.var(axis=0) * n_seeds / (n_seeds - 1)
        else:  # what neighbours do not foretell is chance, at most
            left, freedom = without[None, 1:-1], n_alphas - 2
            own = np.broadcast_to(np.mean(without[1:-1] ** 2, axis=0), mean.shape)
        own = np.stack([own[max(0, i - 1) : i + 2].mean(axis=0) for i in range(n_alphas)])
        own = own + FLOOR**2
        at = own if n_seeds > 1 else own[1:-1]
        scaled = (left / np.sqrt(at)).reshape(-1, n)
        covariance = scaled.T @ scaled + 1e-9 * np.eye(n)
        deviation = np.sqrt(np.diag(covariance))
        correlation = shrunk(covariance / np.outer(deviation, deviation))
        variance = own * (1 + 1 / n_seeds) + displaced
        return cls(alphas, mean, variance, without, correlation, freedom)

    def at(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and standard deviation of the statistics, shape (..., n_statistics)."""
        mean = PchipInterpolator(self.alphas, self.mean, axis=0)(alpha)
        interval = np.clip(np.searchsorted(self.alphas, alpha, "right"), 1, len(self.alphas) - 1)
        low, high = self.alphas[interval - 1], self.alphas[interval]
        share = ((alpha - low) / (high - low))[..., None]
        worse = np.maximum(*(np.abs(self.interpolation[interval - k]) for k in (0, 1)))
        off = INTERPOLATION_SHARE * 4 * share * (1 - share) * worse
        variance = (1 - share) * self.variance[interval - 1] + share * self.variance[interval]
        return mean, WIDENED * np.sqrt(variance + off**2)


@dataclass(frozen=True, slots=True, eq=False)
class AlphaEstimate:
    """Alpha of a region, from simulations at several alphas.

    Attributes
    ----------
    name : str
        Of the region; "all" for the whole mesh.
    interval : Interval
        Median, and the limits of 68 % and 95 % of the probability.
    alphas, probability : ndarray, shape (1001,)
        Values of the swept range and their probability; before the measurement all are alike.
    fit : Fit
        Statistics: measured, and of simulations at the best alpha.
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
        """One standard deviation: half of the interval of 68 %."""
        return self.interval.std

    def text(self) -> str:
        """The alpha and its uncertainty."""
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
    name: str, statistics: tuple[str, ...], measured: np.ndarray, emulator: AlphaEmulator,
    n_points: int,
) -> AlphaEstimate:  # fmt: skip
    """Return the alpha of a region whose statistics were measured."""
    first, last = emulator.alphas[[0, -1]]
    alphas = np.linspace(first, last, GRID)
    mean, spread = emulator.at(alphas)
    scaled = (measured - mean) / spread @ whitening(emulator.correlation)
    chi2 = np.square(scaled).sum(axis=-1)
    likelihood = student_log_density(chi2, emulator.freedom) - np.log(spread).sum(axis=-1)
    probability = np.exp(likelihood - likelihood.max())
    probability /= probability.sum()
    ends = probability[[0, -1]] > EDGE_LIKELIHOOD * probability.max()
    bounded = (bool(ends[0] and first > 0), bool(ends[1] and last < 1))  # beyond these is nothing
    best = int(np.argmax(likelihood))
    as_bad = fit_probability(float(chi2[best]), len(measured) - 1, emulator.freedom)
    fit = Fit(statistics, measured, mean[best], spread[best], as_bad, n_points)
    interval = Interval.of(alphas, probability, bounded)
    return AlphaEstimate(name, interval, alphas, probability, fit)
