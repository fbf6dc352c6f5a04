"""Statistics as smooth functions of roughness and correlation length, and their likelihood.

A synthetic likelihood [1]_: the statistics of a measurement are taken for normal, with a mean and a
covariance that are those of simulations. Since the covariance is estimated from n of them, the
density is Student's [2]_.

References
----------
.. [1] S. N. Wood, "Statistical inference for noisy nonlinear ecological dynamic systems", Nature
   466 (2010) 1102, doi 10.1038/nature09319.
.. [2] E. Sellentin, A. F. Heavens, "Parameter inference with estimated covariance matrices",
   Monthly Notices of the Royal Astronomical Society 456 (2016) L132, doi 10.1093/mnrasl/slv190.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FLOOR_M = 0.06e-3
"""Heights far below it reflect as smooth ones do: g = 0.04 at 77 GHz."""

UNIT_M = (0.3e-3, 3e-3)
"""Height and length whose logarithms are 0."""

SHRINKAGE = 0.2
"""Share of the diagonal in the correlation of the residuals, which few simulations tell badly."""

TREND_SHARE = 0.7
"""Share kept of the trend of the residuals' variance, which squares of few of them tell badly."""

WIDENED = 1.15
"""Of the standard deviations. The statistics are not quite normal: leaving out one simulation at a
time, errors of h were 1.06 to 1.18 times the stated ones for plates, a ball and a hand."""

MEAN_LOG_CHI2 = -1.27
"""Mean of the logarithm of the square of a standard normal number."""


@dataclass(frozen=True, slots=True, eq=False)
class Emulator:
    """Mean and covariance of statistics over height and length.

    Attributes
    ----------
    powers : ndarray, shape (n_terms, 2)
        Exponents of the logarithms of height and length in each term of the mean.
    mean : ndarray, shape (n_terms, n_statistics)
    trend : ndarray, shape (2, n_statistics)
        Slope of the logarithm of the residuals' variance along both logarithms.
    covariance : ndarray, shape (n_statistics, n_statistics)
        Of the residuals without that trend.
    unscaled : ndarray, shape (n_terms, n_terms)
        Covariance of the mean's coefficients over that of the residuals.
    freedom : int
        Simulations less terms.
    """

    powers: np.ndarray
    mean: np.ndarray
    trend: np.ndarray
    covariance: np.ndarray
    unscaled: np.ndarray
    freedom: int

    @classmethod
    def fitted(cls, height_m: np.ndarray, length_m: np.ndarray, statistics: np.ndarray) -> Emulator:
        """Fit to simulations: heights and lengths, shape (n,), statistics (n, n_statistics)."""
        powers = terms(len(np.unique(height_m)), len(np.unique(length_m)))
        at = logarithms(height_m, length_m)
        design = _design(at, powers)
        mean = np.linalg.lstsq(design, statistics, rcond=None)[0]
        left = statistics - design @ mean
        freedom = len(statistics) - len(powers)
        trend = _variance_trend(at, left)
        left = left * np.exp(-0.5 * at @ trend)
        covariance = left.T @ left / freedom
        covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance))
        return cls(powers, mean, trend, covariance, np.linalg.pinv(design.T @ design), freedom)

    def at(self, height_m: np.ndarray, length_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the statistics, shape (..., n_statistics).

        The deviation is that of a measurement from this mean, which has an error of its own.
        """
        at = logarithms(height_m, length_m)
        design = _design(at, self.powers)
        leverage = np.einsum("...i,ij,...j->...", design, self.unscaled, design)[..., None]
        own = np.exp(0.5 * at @ self.trend) * np.sqrt(np.diag(self.covariance))
        return design @ self.mean, WIDENED * own * np.sqrt(1.0 + leverage)

    def log_likelihood(
        self,
        statistics: np.ndarray,
        height_m: np.ndarray,
        length_m: np.ndarray,
        shift: np.ndarray,
        shifts: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the likelihood but for a constant, and chi squared.

        Parameters
        ----------
        statistics : ndarray, shape (n_statistics,)
        height_m, length_m : ndarray, shape (...,)
        shift : ndarray, shape (n_statistics,)
            What a gain adds to: 1 or 0.
        shifts : ndarray, shape (n_gains,)
            The logarithms of gains to try.

        Returns
        -------
        two of ndarray, shape (..., n_gains)
        """
        mean, spread = self.at(height_m, length_m)
        scale = spread / np.sqrt(np.diag(self.covariance))
        inverse = np.linalg.inv(np.linalg.cholesky(self.covariance)).T
        left, gain = (statistics - mean) / scale @ inverse, shift / scale @ inverse
        squares = (left**2).sum(axis=-1), (left * gain).sum(axis=-1), (gain**2).sum(axis=-1)
        own, cross, unit = (square[..., None] for square in squares)
        chi2 = own - 2 * shifts * cross + shifts**2 * unit
        n = self.freedom
        volume = np.log(scale).sum(axis=-1)[..., None]
        return -0.5 * (n + 1) * np.log1p(chi2 / n) - volume, chi2


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


def _variance_trend(at: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Slopes of the logarithm of the variance, shape (2, n_statistics)."""
    floor = 1e-4 * left.var(axis=0) + 1e-300
    logarithm = np.log(left**2 + floor) - MEAN_LOG_CHI2
    design = np.column_stack([np.ones(len(at)), at])
    return TREND_SHARE * np.linalg.lstsq(design, logarithm, rcond=None)[0][1:]
