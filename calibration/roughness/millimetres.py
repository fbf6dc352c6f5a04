"""Roughness and correlation length of regions, with intervals, from the statistics' likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from calibration.roughness.emulator import (
    Emulator,
    Fit,
    Interval,
    at_ends,
    fit_probability,
    logarithms,
)
from calibration.roughness.meters import COHERENT, REST, of_power
from clradar.model.record import plain

KNOWN_SHARE = 0.3  # of a height or slope, that half its 68 % interval is at most
KNOWN_RATIO = 2.0  # of the ends of the 68 % interval of a length that is known
SMOOTHER_BY = 3.0  # standard deviations below the lowest simulated height
N_HEIGHTS, N_LENGTHS = 72, 24
GAIN_SPAN_DB, GAIN_STEP_DB, GAIN_SEARCH_DB = 15.0, 0.2, 2.0
NATURAL_PER_DB = math.log(10.0) / 10.0


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessEstimate:
    """Roughness h and correlation length l of a region, from simulations.

    Attributes
    ----------
    name, fit
        As of `AlphaEstimate`.
    roughness_m, correlation_m, slope : Interval
        Of the height's root mean square h, of l (one value where it was given), and of sqrt(2) h/l;
        as `AlphaEstimate.interval`.
    heights_m, lengths_m : ndarray, shape (n_heights,) and (n_lengths,)
    probability : ndarray, shape (n_heights, n_lengths)
        Of each pair; before the measurement equal ratios are equally likely.
    """

    name: str
    roughness_m: Interval
    correlation_m: Interval
    slope: Interval
    heights_m: np.ndarray
    lengths_m: np.ndarray
    probability: np.ndarray
    fit: Fit

    @property
    def tells_roughness(self) -> bool:
        """Whether the measurement determines h within 30 %, not at an end of its range."""
        height = self.roughness_m
        return not height.bounded and height.std <= KNOWN_SHARE * height.median

    @property
    def tells_correlation(self) -> bool:
        """Whether it determines l within an octave, not at an end of its range."""
        length = self.correlation_m
        return not length.bounded and length.high <= KNOWN_RATIO * length.low

    @property
    def tells_slope(self) -> bool:
        """Whether it determines the slope within 30 %."""
        return self.slope.std <= KNOWN_SHARE * self.slope.median

    @property
    def is_smooth(self) -> bool:
        """Whether only an upper limit of h is known."""
        return self.roughness_m.bounded_below and not self.roughness_m.bounded_above

    def text(self) -> str:
        """What the measurement determines, and what it does not."""
        height, length = self.roughness_m, self.correlation_m
        if self.is_smooth:
            return f"h below {1e3 * height.high95:.2g} mm (95 %), too smooth for more"
        slope = f"slope {self.slope.text(1, '')}"
        if self.tells_roughness:
            known = f"h = {height.text(1e3, 'mm')}"
            if len(self.lengths_m) == 1 and self.tells_correlation:
                return f"{known} for l = {1e3 * length.median:.2g} mm, as given"
            if self.tells_correlation:
                return f"{known}, l = {length.text(1e3, 'mm')}, {slope}"
            if self.tells_slope:
                return f"{known}, {slope}; l alone is not observable"
            return f"{known}; the correlation length is not observable"
        between = f"h between {1e3 * height.low95:.2g} and {1e3 * height.high95:.2g} mm (95 %)"
        if self.tells_slope:
            return f"only the {slope} is observable; {between}"
        return f"neither h nor the slope is observable; {between}"

    def remarks(self) -> list[str]:
        """Reasons to doubt the estimate, one clause each."""
        if self.is_smooth:
            return []
        end = f"{1e3 * self.heights_m[-1]:.3g} mm, the end of its range: take a wider one"
        above = [f"the roughness may be above {end}"] if self.roughness_m.bounded_above else []
        return above + self.fit.remarks("another pose, shape or material")

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has."""
        known = ("tells_roughness", "tells_correlation", "tells_slope")
        told = {name: plain(getattr(self, name)) for name in known}
        return {"text": self.text(), **told, **plain(self)}


@dataclass(frozen=True, slots=True, eq=False)
class RegionStatistics:
    """What a region's estimate is made from: its statistics, and those of simulations."""

    name: str
    statistics: tuple[str, ...]
    measured: np.ndarray
    emulator: Emulator
    n_points: int

    @property
    def shift(self) -> np.ndarray:
        """What the logarithm of a gain adds to: 1 or 0, shape (n_statistics,)."""
        return of_power(self.statistics).astype(float)


def estimate_roughness(
    regions: Sequence[RegionStatistics],
    height_m: np.ndarray,
    length_m: np.ndarray,
    *,
    calibrated: bool,
) -> tuple[list[RoughnessEstimate], Interval]:
    """Estimate h and l of regions that were measured with one gain, and the gain in decibels.

    `height_m` and `length_m` are of the simulations; with `calibrated` the gain is 1.
    """
    heights_m = np.geomspace(height_m.min(), height_m.max(), N_HEIGHTS)
    lengths_m = np.unique(length_m)
    if len(lengths_m) > 1:
        lengths_m = np.geomspace(lengths_m[0], lengths_m[-1], N_LENGTHS)
    at = logarithms(heights_m[:, None], lengths_m)

    def likelihoods(shifts: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each region its likelihood and chi squared, for gains of these logarithms."""
        return [r.emulator.log_likelihood(r.measured, at, r.shift, shifts) for r in regions]

    def of_gains(found: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """The likelihood of each gain by each region."""
        return np.stack([special.logsumexp(likelihood, axis=(0, 1)) for likelihood, _ in found])

    shifts = np.zeros(1)
    if not calibrated:
        off = [(r.measured - r.emulator.at(at)[0])[..., r.shift > 0] for r in regions]
        least, most = min(o.min() for o in off), max(o.max() for o in off)
        coarse = np.arange(least, most + NATURAL_PER_DB, GAIN_SEARCH_DB * NATURAL_PER_DB)
        best = coarse[np.argmax(of_gains(likelihoods(coarse)).sum(axis=0))]
        span = np.arange(-GAIN_SPAN_DB, GAIN_SPAN_DB + GAIN_STEP_DB, GAIN_STEP_DB)
        shifts = best + NATURAL_PER_DB * span
    found = likelihoods(shifts)
    of_gain = of_gains(found)
    total = of_gain.sum(axis=0)
    slopes = math.sqrt(2.0) * heights_m[:, None] / lengths_m
    estimates = []
    for region, own, (likelihood, chi2) in zip(regions, of_gain, found, strict=True):
        joint = likelihood + total - own  # over heights, lengths and gains, by all regions
        i, j, k = (int(index) for index in np.unravel_index(np.argmax(joint), joint.shape))
        probability = np.exp(special.logsumexp(joint, axis=2) - special.logsumexp(joint))
        # With less power in the rest than at the lowest height, nothing below that is known.
        rest = np.array([name.startswith(REST) for name in region.statistics])
        coherent = np.array([name == COHERENT for name in region.statistics])
        weight = rest / np.count_nonzero(rest) - coherent
        mean, spread = region.emulator.at(at[0])
        lowest = mean @ weight - SMOOTHER_BY * np.sqrt(spread**2 @ weight**2)
        if region.measured @ weight < lowest.min():
            i, k = 0, int(np.argmax(joint[0, j]))
            probability = np.zeros_like(probability)
            probability[0] = 1 / len(lengths_m)
        mean, spread = region.emulator.at(at[i, j])
        of_heights, of_lengths = probability.sum(axis=1), probability.sum(axis=0)
        ends = at_ends(lengths_m, of_lengths) if len(lengths_m) > 1 else (False, False)
        free = len(mean) - 1 - (len(lengths_m) > 1) - (len(shifts) > 1)
        as_bad = fit_probability(float(chi2[i, j, k]), free, region.emulator.freedom)
        fitted = mean + shifts[k] * region.shift
        fit = Fit(region.statistics, region.measured, fitted, spread, as_bad, region.n_points)
        height = Interval.of(heights_m, of_heights, at_ends(heights_m, of_heights))
        length, slope = Interval.of(lengths_m, of_lengths, ends), Interval.of(slopes, probability)
        estimates.append(
            RoughnessEstimate(
                region.name, height, length, slope, heights_m, lengths_m, probability, fit
            )
        )
    return estimates, Interval.of(shifts / NATURAL_PER_DB, special.softmax(total))
