"""Statistics as smooth functions of roughness and correlation length, their likelihood, intervals.

A synthetic likelihood: the statistics of a measurement are taken for normal, with a mean and a
covariance that are those of simulations. Since the covariance is estimated from n of them, the
density is Student's. docs/sweep-method.md has the references.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

FLOOR_M = 0.06e-3  # heights far below it reflect as smooth ones do: g = 0.04 at 77 GHz
UNIT_M = (0.3e-3, 3e-3)  # height and length whose logarithms are 0

SHRINKAGE, TREND_SHARE = 0.2, 0.7
"""Shares of the diagonal in the correlation of the residuals, and kept of the trend of their
variance: few simulations tell both badly."""

LEAST_VARIANCE = 1e-8  # of what all simulations share, such as that all of a plate is bright

WIDENED = 1.15
"""Of the standard deviations. The statistics are not quite normal: leaving out one simulation at a
time, errors of h were 1.06 to 1.18 times the stated ones for plates, a ball and a hand."""

MEAN_LOG_CHI2 = -1.27  # of the square of a standard normal number
UNLIKELY = 1e-3  # of as bad a fit: below it no simulation looks like the measurement
LEVELS = (0.025, 0.16, 0.5, 0.84, 0.975)  # of 95 % and 68 % of the probability, and the median

EDGE = 0.1  # of the highest probability, above which the truth may lie beyond an end of the range


@dataclass(frozen=True, slots=True)
class Interval:
    """Median of a quantity, and the limits of 68 % and 95 % of its probability.

    `bounded_below` and `bounded_above` are whether the range that was swept bounds it on that side,
    and not the measurement.
    """

    median: float
    low: float
    high: float
    low95: float
    high95: float
    bounded_below: bool = False
    bounded_above: bool = False

    @classmethod
    def of(
        cls, values: np.ndarray, probability: np.ndarray, bounded: tuple[bool, bool] = (False,) * 2
    ) -> Interval:
        """From the probabilities of values, of any order and shape."""
        order = np.argsort(values, axis=None)
        ascending, weight = values.ravel()[order], probability.ravel()[order]
        reached = np.cumsum(weight) - 0.5 * weight
        low95, low, median, high, high95 = np.interp(LEVELS, reached, ascending).tolist()
        return cls(median, low, high, low95, high95, *bounded)

    @property
    def std(self) -> float:
        """Half the 68 % interval."""
        return 0.5 * (self.high - self.low)

    @property
    def bounded(self) -> bool:
        return self.bounded_below or self.bounded_above

    def text(self, scale: float, unit: str) -> str:
        """Median and half the 68 % interval, to the first digit of that."""
        std = scale * self.std
        digits = max(0, -math.floor(math.log10(std))) if std > 0 else 3
        value = f"{scale * self.median:.{digits}f} \N{PLUS-MINUS SIGN} {std:.{digits}f}"
        return f"{value} {unit}".rstrip()


def at_ends(probability: np.ndarray) -> tuple[bool, bool]:
    """Whether the truth may lie beyond the lower and the upper end of the range."""
    first, last = probability[[0, -1]] > EDGE * probability.max()
    return bool(first), bool(last)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The statistics of a region, measured and of simulations at the best values."""

    statistics: tuple[str, ...]
    measured: np.ndarray
    fitted: np.ndarray  # mean of the simulations
    spread: np.ndarray  # their standard deviation
    probability: float  # of a fit as bad as this, or worse, if the measurement were a simulation
    n_points: int  # of the surface, that were read

    def remarks(self, instead: str) -> list[str]:
        """Whether no simulation looks like the measurement, and what it may be instead."""
        if not self.probability < UNLIKELY:
            return []
        return [
            "no simulation has the statistics of the measurement (probability "
            f"{self.probability:.1g}): {instead}, or clutter"
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Emulator:
    """Mean and covariance of statistics over coordinates in which they are smooth."""

    powers: np.ndarray  # exponents of a polynomial of the coordinates
    mean: np.ndarray  # its coefficients, a column for each statistic
    trend: np.ndarray  # slope of the logarithm of the residuals' variance
    covariance: np.ndarray  # of the residuals without the trend
    unscaled: np.ndarray  # that of the mean's coefficients over it
    freedom: int

    @classmethod
    def fitted(cls, at: np.ndarray, powers: np.ndarray, statistics: np.ndarray) -> Emulator:
        """Fit to simulations: coordinates, shape (n, n_axes), statistics (n, n_statistics)."""
        design = _design(at, powers)
        mean = np.linalg.lstsq(design, statistics, rcond=None)[0]
        left = statistics - design @ mean
        freedom = len(statistics) - len(powers)
        # Slopes of the logarithm of the variance.
        logarithm = np.log(left**2 + (1e-4 * left.var(axis=0) + 1e-300)) - MEAN_LOG_CHI2
        line = np.column_stack([np.ones(len(at)), at])
        trend = TREND_SHARE * np.linalg.lstsq(line, logarithm, rcond=None)[0][1:]
        left = left * np.exp(-0.5 * at @ trend)
        covariance = left.T @ left / freedom
        covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance))
        np.fill_diagonal(covariance, np.maximum(np.diag(covariance), LEAST_VARIANCE))
        return cls(powers, mean, trend, covariance, np.linalg.pinv(design.T @ design), freedom)

    def at(self, at: np.ndarray, variance: np.ndarray | float = 0.0) -> tuple[Any, np.ndarray]:
        """Mean and standard deviation of the statistics, shape (..., n_statistics).

        The deviation is that of a measurement from this mean, which has an error of its own, with
        a variance for what simulations do not have.
        """
        design = _design(at, self.powers)
        leverage = np.einsum("...i,ij,...j->...", design, self.unscaled, design)[..., None]
        own = WIDENED**2 * np.exp(at @ self.trend) * np.diag(self.covariance)
        return design @ self.mean, np.sqrt(own * (1.0 + leverage) + variance)

    def log_likelihood(
        self, statistics: np.ndarray, at: np.ndarray, variance: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of Student's density but for a constant, and chi squared."""
        mean, spread = self.at(at, variance)
        scale = spread / np.sqrt(np.diag(self.covariance))
        left = (statistics - mean) / scale @ np.linalg.inv(np.linalg.cholesky(self.covariance)).T
        chi2 = (left**2).sum(axis=-1)
        density = -0.5 * (self.freedom + 1) * np.log1p(chi2 / self.freedom)
        return density - np.log(scale).sum(axis=-1), chi2

    def fit(
        self,
        names: tuple[str, ...],
        measured: np.ndarray,
        at: np.ndarray,
        n_found: int,
        n_points: int,
        variance: np.ndarray | float = 0.0,
    ) -> Fit:
        """How well the statistics fit at the best values of so many quantities."""
        mean, spread = self.at(at, variance)
        n, chi2 = len(measured) - n_found, self.log_likelihood(measured, at, variance)[1]
        left, as_bad = self.freedom - n + 1, math.nan
        if n > 0 and left > 0:
            as_bad = float(special.fdtrc(n, left, chi2 * left / (n * self.freedom)))
        return Fit(names, measured, mean, spread, as_bad, n_points)


def logarithms(height_m: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Coordinates in which the statistics are smooth, shape (..., 2)."""
    height = 0.5 * np.log((np.square(height_m) + FLOOR_M**2) / UNIT_M[0] ** 2)
    return np.stack(np.broadcast_arrays(height, np.log(np.divide(length_m, UNIT_M[1]))), axis=-1)


def terms(n_heights: int, n_lengths: int) -> np.ndarray:
    """Exponents of a polynomial: at most cubic, and quadratic in the length."""
    most = min(3, n_heights - 1), min(2, n_lengths - 1)
    return np.array([(i, j) for i in range(most[0] + 1) for j in range(most[1] + 1) if i + j <= 3])


def _design(at: np.ndarray, powers: np.ndarray) -> np.ndarray:
    return np.prod(at[..., None, :] ** powers, axis=-1)
