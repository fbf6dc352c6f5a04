"""Alpha, or roughness and correlation length, of a region, from statistics of its images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from calibration.roughness.emulator import Emulator, Fit, Interval, at_ends, logarithms, terms
from calibration.roughness.meters import COHERENT, REST

GRID = 1001  # alphas at which the likelihood is computed
SMOOTH = 0.07  # alphas far below it look like 0
MOST_POWER = 3
FLOOR = 0.05  # standard deviation of a logarithm that no simulation has: 5 %

NOT_SIMULATED = 1.7
"""Of the variance by this and by the mesh's place: so 95 % of the intervals hold the truth where it
is off by 1.6 mm, too."""

N_HEIGHTS, N_LENGTHS = 72, 24
KNOWN_SHARE = 0.3  # of a height or slope, that half its 68 % interval is at most
KNOWN_RATIO = 2.0  # of the ends of the 68 % interval of a length that is known
SMOOTHER_BY = 3.0  # standard deviations below the lowest simulated height


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
        said = f"h between {1e3 * height.low95:.2g} and {1e3 * height.high95:.2g} mm (95 %)"
        if self.tells_roughness:
            said = f"h = {height.text(1e3, 'mm')}"
        if len(self.lengths_m) == 1:
            said += f", l = {1e3 * length.median:.2g} mm as given"
        elif self.tells_correlation:
            said += f", l = {length.text(1e3, 'mm')}"
        else:
            said += ", l is not observable"
        slope = self.slope.text(1, "") if self.tells_slope else "is not observable"
        return f"{said}, slope {slope}"

    def remarks(self) -> list[str]:
        """Reasons to doubt the estimate, one clause each."""
        if self.is_smooth:
            return []
        end = f"{1e3 * self.heights_m[-1]:.3g} mm, the end of its range: take a wider one"
        above = [f"the roughness may be above {end}"] if self.roughness_m.bounded_above else []
        return above + self.fit.remarks("another pose, shape or material")


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
    of_level = [displaced[number == i].mean(axis=0) for i in range(len(levels))]
    by_place = np.stack([np.interp(tried, levels, one) for one in np.transpose(of_level)], axis=-1)
    variance = NOT_SIMULATED * (FLOOR**2 + by_place)
    at = _coordinate(tried)
    likelihood, _ = emulator.log_likelihood(measured, at, variance)
    probability = special.softmax(likelihood)
    below, above = at_ends(probability)
    interval = Interval.of(tried, probability, (below and first > 0, above and last < 1))
    best = int(np.argmax(likelihood))
    fit = emulator.fit(statistics, measured, at[best], 1, n_points, variance[best])
    return AlphaEstimate(name, interval, tried, probability, fit)


def _coordinate(alphas: np.ndarray) -> np.ndarray:
    """In which the statistics are polynomials."""
    return 0.5 * np.log(np.square(alphas) + SMOOTH**2)[:, None]


def estimate_roughness(
    name: str,
    statistics: tuple[str, ...],
    measured: np.ndarray,
    height_m: np.ndarray,
    length_m: np.ndarray,
    simulated: np.ndarray,
    n_points: int,
) -> RoughnessEstimate:
    """Return h and l of a region whose statistics were measured.

    `simulated` are those of simulations with these heights and lengths, shape (n, n_statistics).
    """
    powers = terms(len(np.unique(height_m)), len(lengths_m := np.unique(length_m)))
    emulator = Emulator.fitted(logarithms(height_m, length_m), powers, simulated)
    heights_m = np.geomspace(height_m.min(), height_m.max(), N_HEIGHTS)
    if several := len(lengths_m) > 1:
        lengths_m = np.geomspace(lengths_m[0], lengths_m[-1], N_LENGTHS)
    at = logarithms(heights_m[:, None], lengths_m)
    likelihood, _ = emulator.log_likelihood(measured, at)
    probability = special.softmax(likelihood)
    # With less power in the rest than at the lowest height, nothing below that is known.
    rest = np.array([one.startswith(REST) for one in statistics])
    coherent = np.array([one == COHERENT for one in statistics])
    weight = rest / np.count_nonzero(rest) - coherent
    mean, spread = emulator.at(at[0])
    if measured @ weight < (mean @ weight - SMOOTHER_BY * np.sqrt(spread**2 @ weight**2)).min():
        probability = np.zeros_like(probability)
        probability[0] = 1 / len(lengths_m)
    likely = np.where(probability > 0, likelihood, -np.inf)
    best = at[np.unravel_index(np.argmax(likely), likely.shape)]
    of_heights, of_lengths = probability.sum(axis=1), probability.sum(axis=0)
    slopes = math.sqrt(2.0) * heights_m[:, None] / lengths_m
    fit = emulator.fit(statistics, measured, best, 1 + several, n_points)
    return RoughnessEstimate(
        name,
        Interval.of(heights_m, of_heights, at_ends(of_heights)),
        Interval.of(lengths_m, of_lengths, at_ends(of_lengths) if several else (False, False)),
        Interval.of(slopes, probability),
        heights_m,
        lengths_m,
        probability,
        fit,
    )
