"""Alpha of a region with its interval, from statistics that are smooth functions of alpha."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.roughness.emulator import (
    SHRINKAGE,
    UNLIKELY,
    Interval,
    compared,
    fit_probability,
    plain,
    student_log_likelihood,
)

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


@dataclass(frozen=True, slots=True, eq=False)
class AlphaEmulator:
    """Mean and covariance of statistics over alpha.

    Attributes
    ----------
    alphas : ndarray, shape (A,)
    mean, variance : ndarray, shape (A, n_statistics)
        The variance is that of a measurement from this mean.
    interpolation : ndarray, shape (A, n_statistics)
        What the mean at an alpha would be off by if it was interpolated between the others.
    correlation : ndarray, shape (n_statistics, n_statistics)
    freedom : int
    """

    alphas: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    interpolation: np.ndarray
    correlation: np.ndarray
    freedom: int

    @classmethod
    def fitted(
        cls, alphas: np.ndarray, statistics: np.ndarray, displaced: np.ndarray
    ) -> AlphaEmulator:
        """Fit to simulations.

        `statistics` has shape (n_seeds, A, n_statistics); `displaced`, shape (A, n_statistics), is
        their variance by a mesh that is not quite in its place.
        """
        n_seeds, n_alphas, n = statistics.shape
        mean = statistics.mean(axis=0)
        without = np.zeros_like(mean)
        for i in range(1, n_alphas - 1):
            others = np.arange(n_alphas) != i
            without[i] = (
                PchipInterpolator(alphas[others], mean[others], axis=0)(alphas[i]) - mean[i]
            )
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
        correlation = covariance / np.outer(deviation, deviation)
        correlation = (1 - SHRINKAGE) * correlation + SHRINKAGE * np.eye(n)
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
    statistics : tuple of str
    measured, fitted, spread : ndarray, shape (n_statistics,)
        Of the measurement, and mean and standard deviation of simulations at the best alpha.
    fit_probability : float
        Of a fit as bad as this, or worse, if the measurement were a simulation.
    n_points : int
        Points of the surface that were read.

    Examples
    --------
    >>> import calibration, numpy as np
    >>> from calibration.roughness.emulator import Interval
    >>> found = calibration.AlphaEstimate(
    ...     "palm", Interval(0.55, 0.53, 0.57, 0.5, 0.6), np.ones(1), np.ones(1), (), np.ones(0),
    ...     np.ones(0), np.ones(0), 0.4, 900)
    >>> found.text(), found.remarks()
    ('0.55 ± 0.02', [])
    """

    name: str
    interval: Interval
    alphas: np.ndarray
    probability: np.ndarray
    statistics: tuple[str, ...]
    measured: np.ndarray
    fitted: np.ndarray
    spread: np.ndarray
    fit_probability: float
    n_points: int

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
        found = []
        for bounded, end in (
            (self.interval.bounded_below, self.alphas[0]),
            (self.interval.bounded_above, self.alphas[-1]),
        ):
            if bounded:
                found.append(
                    f"alpha may lie beyond {end:g}, an end of its range: take a wider range"
                )
        if self.fit_probability < UNLIKELY:
            found.append(
                "no simulation has the statistics of the measurement (probability "
                f"{self.fit_probability:.1g}): another pose or shape, several alphas, or clutter"
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has."""
        return {
            "text": self.text(),
            "alpha": self.interval.to_dict(),
            "uncertainty": plain(self.uncertainty),
            "fit_probability": plain(self.fit_probability),
            "points": self.n_points,
            "statistics": compared(self.statistics, self.measured, self.fitted, self.spread),
            "alphas": plain(self.alphas),
            "probability": plain(self.probability),
        }


def estimate_alpha(
    name: str, statistics: tuple[str, ...], measured: np.ndarray, emulator: AlphaEmulator,
    n_points: int,
) -> AlphaEstimate:  # fmt: skip
    """Return the alpha of a region whose statistics were measured."""
    first, last = emulator.alphas[[0, -1]]
    alphas = np.linspace(first, last, GRID)
    mean, spread = emulator.at(alphas)
    likelihood, chi2 = student_log_likelihood(
        (measured - mean) / spread, emulator.correlation, emulator.freedom
    )
    likelihood = likelihood - np.log(spread).sum(axis=-1)
    probability = np.exp(likelihood - likelihood.max())
    probability /= probability.sum()
    ends = probability[[0, -1]] > EDGE_LIKELIHOOD * probability.max()
    bounded = (bool(ends[0] and first > 0), bool(ends[1] and last < 1))  # beyond these is nothing
    best = int(np.argmax(likelihood))
    return AlphaEstimate(
        name, Interval.of(alphas, probability, bounded), alphas, probability, statistics, measured,
        mean[best], spread[best],
        fit_probability(float(chi2[best]), len(measured) - 1, emulator.freedom), n_points,
    )  # fmt: skip
