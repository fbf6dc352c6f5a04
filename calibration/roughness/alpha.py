"""Alpha of a region with its interval, from statistics of an image's brightness.

Of these statistics mean and covariance are smooth in alpha.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from calibration.roughness.emulator import Emulator, Fit, Interval, fit_probability
from clradar.model.record import plain

GRID = 1001  # alphas at which the likelihood is computed
SMOOTH = 0.07  # alphas far below it look like 0
MOST_POWER = 3
FLOOR = 0.05  # standard deviation of a logarithm that no simulation has: 5 %

NOT_SIMULATED = 1.7
"""Of the variance by this and by the mesh's place: so 95 % of the intervals hold the truth where it
is off by 1.6 mm, too."""

EDGE_LIKELIHOOD = 0.1
"""Of an end of the range, relative to the highest, above which the truth may lie beyond."""


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
