"""Roughness and correlation length of regions, with intervals, from the statistics' likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from calibration.roughness.emulator import (
    UNLIKELY,
    Emulator,
    Interval,
    at_ends,
    compared,
    fit_probability,
    plain,
)
from calibration.roughness.slope import slope_of_roughness
from calibration.roughness.texture import COHERENT, REST, Statistic

TOLD_SHARE = 0.3
"""A height or slope is told if half its 68 % interval is at most this share of it."""

TOLD_RATIO = 2.0
"""A length is told if its 68 % interval is at most an octave."""

SMOOTHER_BY = 3.0
"""Standard deviations below the lowest simulated height from which a surface counts as smoother."""

N_HEIGHTS, N_LENGTHS = 72, 24
GAIN_SPAN_DB, GAIN_STEP_DB, GAIN_SEARCH_DB = 15.0, 0.2, 2.0
NATURAL_PER_DB = math.log(10.0) / 10.0


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessEstimate:
    """Roughness h and correlation length l of a region, from simulations.

    Attributes
    ----------
    name : str
        Of the region; "all" for the whole mesh.
    roughness_m : Interval
        Of the height's root mean square h, metres.
    correlation_m : Interval
        Of the correlation length l, metres; one value where it was given.
    slope : Interval
        Of sqrt(2) h / l.
    heights_m, lengths_m : ndarray, shape (n_heights,) and (n_lengths,), metres
    probability : ndarray, shape (n_heights, n_lengths)
        Of each pair; they add up to 1. Before the measurement all are alike: equal ratios of
        heights, and of lengths, are equally likely.
    statistics : tuple of Statistic
    measured, fitted, spread : ndarray, shape (n_statistics,)
        The statistics of the measurement; the mean of simulations at the best pair and gain, and
        the standard deviation of one simulation.
    fit_probability : float
        Of a fit as bad as this, or worse, if the measurement were a simulation.
    n_points : int
        Points of the surface that were read.

    Examples
    --------
    >>> from calibration.roughness.roughness_estimate import Interval
    >>> import numpy as np
    >>> import calibration
    >>> height = Interval(0.31e-3, 0.28e-3, 0.34e-3, 0.25e-3, 0.37e-3)
    >>> length = Interval(3e-3, 1.4e-3, 5.5e-3, 1.1e-3, 5.9e-3, True, True)
    >>> slope = Interval(0.15, 0.08, 0.3, 0.06, 0.4)
    >>> found = calibration.RoughnessEstimate(
    ...     "palm", height, length, slope, np.ones(1), np.ones(1), np.ones((1, 1)), (), np.ones(0),
    ...     np.ones(0), np.ones(0), 0.4, 900)
    >>> found.text()
    'h = 0.31 ± 0.03 mm; the correlation length cannot be told'
    >>> found.tells_roughness, found.tells_correlation, found.tells_slope
    (True, False, False)
    """

    name: str
    roughness_m: Interval
    correlation_m: Interval
    slope: Interval
    heights_m: np.ndarray
    lengths_m: np.ndarray
    probability: np.ndarray
    statistics: tuple[Statistic, ...]
    measured: np.ndarray
    fitted: np.ndarray
    spread: np.ndarray
    fit_probability: float
    n_points: int

    @property
    def tells_roughness(self) -> bool:
        """Whether the measurement tells h: within 30 %, and not at an end of its range."""
        height = self.roughness_m
        return not height.bounded and height.std <= TOLD_SHARE * height.median

    @property
    def tells_correlation(self) -> bool:
        """Whether it tells l: within an octave, and not at an end of its range."""
        length = self.correlation_m
        return not length.bounded and length.high <= TOLD_RATIO * length.low

    @property
    def tells_slope(self) -> bool:
        """Whether it tells the slope: within 30 %."""
        return self.slope.std <= TOLD_SHARE * self.slope.median

    @property
    def is_smooth(self) -> bool:
        """Whether h is as small as the range has it, and only an upper limit is known."""
        return self.roughness_m.bounded_below and not self.roughness_m.bounded_above

    def text(self) -> str:
        """What the measurement tells, and what it does not."""
        height, length = self.roughness_m, self.correlation_m
        if self.is_smooth:
            return f"h below {1e3 * height.high95:.2g} mm (95 %), too smooth for more"
        if self.tells_roughness:
            told = f"h = {height.text(1e3, 'mm')}"
            if len(self.lengths_m) == 1 and self.tells_correlation:
                return f"{told} for l = {1e3 * length.median:.2g} mm, as given"
            if self.tells_correlation:
                return f"{told}, l = {length.text(1e3, 'mm')}, slope {self.slope.text(1, '')}"
            if self.tells_slope:
                return f"{told}, slope {self.slope.text(1, '')}; l alone cannot be told"
            return f"{told}; the correlation length cannot be told"
        between = f"h between {1e3 * height.low95:.2g} and {1e3 * height.high95:.2g} mm (95 %)"
        if self.tells_slope:
            return f"only the slope {self.slope.text(1, '')} can be told; {between}"
        return f"neither h nor the slope can be told; {between}"

    def remarks(self) -> list[str]:
        """Reasons to doubt the estimate, one clause each."""
        found = []
        if self.roughness_m.bounded_above:
            found.append(
                f"the roughness may be above {1e3 * self.heights_m[-1]:.3g} mm, the end of its "
                "range: take a wider one"
            )
        if self.fit_probability < UNLIKELY and not self.is_smooth:
            found.append(
                "no simulation has the statistics of the measurement (probability "
                f"{self.fit_probability:.1g}): another pose, shape or material, or clutter"
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has."""
        return {
            "text": self.text(),
            "roughness_m": self.roughness_m.to_dict(),
            "correlation_m": self.correlation_m.to_dict(),
            "slope": self.slope.to_dict(),
            "tells_roughness": self.tells_roughness,
            "tells_correlation": self.tells_correlation,
            "tells_slope": self.tells_slope,
            "fit_probability": plain(self.fit_probability),
            "points": self.n_points,
            "statistics": compared(
                [one.name for one in self.statistics], self.measured, self.fitted, self.spread
            ),
            "heights_m": plain(self.heights_m),
            "lengths_m": plain(self.lengths_m),
            "probability": plain(self.probability),
        }


@dataclass(frozen=True, slots=True, eq=False)
class RegionStatistics:
    """What a region's estimate is made from.

    Attributes
    ----------
    name : str
    statistics : tuple of Statistic
    measured : ndarray, shape (n_statistics,)
    simulated : ndarray, shape (n_simulations, n_statistics)
    n_points : int
    """

    name: str
    statistics: tuple[Statistic, ...]
    measured: np.ndarray
    simulated: np.ndarray
    n_points: int

    @property
    def shift(self) -> np.ndarray:
        """What the logarithm of a gain adds to: 1 or 0, shape (n_statistics,)."""
        return np.array([float(one.of_power) for one in self.statistics])


def estimate_roughness(
    regions: Sequence[RegionStatistics],
    height_m: np.ndarray,
    length_m: np.ndarray,
    *,
    calibrated: bool,
) -> tuple[list[RoughnessEstimate], Interval]:
    """Estimate h and l of regions that were measured with one gain.

    Parameters
    ----------
    regions : sequence of RegionStatistics
    height_m, length_m : ndarray, shape (n_simulations,), metres
        Of the simulations.
    calibrated : bool
        Whether the gain is 1, and not to be found.

    Returns
    -------
    estimates : list of RoughnessEstimate
    gain_db : Interval
        Of the measurement over the simulation.
    """
    heights_m = np.geomspace(height_m.min(), height_m.max(), N_HEIGHTS)
    lengths_m = np.unique(length_m)
    if len(lengths_m) > 1:
        lengths_m = np.geomspace(lengths_m[0], lengths_m[-1], N_LENGTHS)
    height_grid, length_grid = np.meshgrid(heights_m, lengths_m, indexing="ij")
    emulators = [Emulator.fitted(height_m, length_m, region.simulated) for region in regions]
    both = list(zip(regions, emulators, strict=True))
    shifts = np.zeros(1) if calibrated else _gains(both, height_grid, length_grid)
    found = [
        emulator.log_likelihood(region.measured, height_grid, length_grid, region.shift, shifts)
        for region, emulator in both
    ]
    of_gain = np.stack([special.logsumexp(likelihood, axis=(0, 1)) for likelihood, _ in found])
    of_all = np.exp(of_gain.sum(axis=0) - special.logsumexp(of_gain.sum(axis=0)))
    estimates = []
    for (region, emulator), own, (likelihood, chi2) in zip(both, of_gain, found, strict=True):
        joint = likelihood + of_gain.sum(axis=0) - own
        estimates.append(_estimate(region, emulator, heights_m, lengths_m, shifts, joint, chi2))
    gain_db = Interval.of(shifts / NATURAL_PER_DB, of_all)
    return estimates, gain_db


def _gains(
    both: list[tuple[RegionStatistics, Emulator]], height_m: np.ndarray, length_m: np.ndarray
) -> np.ndarray:
    """Logarithms of gains around the most likely one."""
    off = [
        (region.measured - emulator.at(height_m, length_m)[0])[..., region.shift > 0]
        for region, emulator in both
    ]
    low, high = min(o.min() for o in off), max(o.max() for o in off)
    coarse = np.arange(low, high + NATURAL_PER_DB, GAIN_SEARCH_DB * NATURAL_PER_DB)
    of_gain = sum(
        special.logsumexp(
            emulator.log_likelihood(region.measured, height_m, length_m, region.shift, coarse)[0],
            axis=(0, 1),
        )
        for region, emulator in both
    )
    span = np.arange(-GAIN_SPAN_DB, GAIN_SPAN_DB + GAIN_STEP_DB, GAIN_STEP_DB)
    return coarse[np.argmax(of_gain)] + NATURAL_PER_DB * span


def _estimate(
    region: RegionStatistics,
    emulator: Emulator,
    heights_m: np.ndarray,
    lengths_m: np.ndarray,
    shifts: np.ndarray,
    joint: np.ndarray,
    chi2: np.ndarray,
) -> RoughnessEstimate:
    i, j, k = (int(index) for index in np.unravel_index(np.argmax(joint), joint.shape))
    probability = np.exp(special.logsumexp(joint, axis=2) - special.logsumexp(joint))
    if _is_smoother(region, emulator, heights_m[0], lengths_m):
        i, k = 0, int(np.argmax(joint[0, j]))
        probability = np.zeros_like(probability)
        probability[0] = 1 / len(lengths_m)
    mean, spread = emulator.at(heights_m[i], lengths_m[j])
    slopes = slope_of_roughness(1.0, 1.0) * heights_m[:, None] / lengths_m
    of_heights, of_lengths = probability.sum(axis=1), probability.sum(axis=0)
    given = len(lengths_m) == 1
    parameters = 1 + (len(lengths_m) > 1) + (len(shifts) > 1)
    return RoughnessEstimate(
        name=region.name,
        roughness_m=Interval.of(heights_m, of_heights, at_ends(heights_m, of_heights)),
        correlation_m=Interval.of(
            lengths_m, of_lengths, (False, False) if given else at_ends(lengths_m, of_lengths)
        ),
        slope=Interval.of(slopes, probability),
        heights_m=heights_m,
        lengths_m=lengths_m,
        probability=probability,
        statistics=region.statistics,
        measured=region.measured,
        fitted=mean + shifts[k] * region.shift,
        spread=spread,
        fit_probability=fit_probability(
            float(chi2[i, j, k]), len(mean) - parameters, emulator.freedom
        ),
        n_points=region.n_points,
    )


def _is_smoother(
    region: RegionStatistics, emulator: Emulator, lowest_m: float, lengths_m: np.ndarray
) -> bool:
    """Whether less power is in the rest than at the lowest height: below it nothing is known."""
    names = [one.name for one in region.statistics]
    rest = np.array([name.startswith(REST) for name in names])
    weight = rest / np.count_nonzero(rest) - np.array([name == COHERENT for name in names])
    mean, spread = emulator.at(np.full(len(lengths_m), lowest_m), lengths_m)
    share = mean @ weight - SMOOTHER_BY * np.sqrt(spread**2 @ weight**2)
    return bool(region.measured @ weight < share.min())
