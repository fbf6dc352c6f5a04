"""Estimation of alpha with its uncertainty, corrected for the simulations' own speckle.

Similarities are divided by the root of their reliability: C. Spearman, "The proof and measurement
of association between two things", American Journal of Psychology 15(1), 1904, doi 10.2307/1412159.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import combinations, permutations
from typing import Any

import numpy as np
from scipy import stats

from clradar.compare import HIGHER_IS_BETTER, METRICS, compare_by
from clradar.errors import CompareError
from clradar.model import DepthMap, checks

Images = Sequence[Sequence[DepthMap | None]]
"""Simulated depth maps [seed][alpha]; None where no ray reached a receiver."""

PAIRED_CONFIDENCE = 0.95
"""Confidence of the one-sided paired t-test by which an alpha is worse than the best."""

MIN_SELF_AGREEMENT = 0.1
"""Smallest reliability, the similarity of simulations among themselves: below it they are noise,
and division by its root would make that the best score."""

GRID_STD = 12**-0.5
"""Standard deviation of rounding to a grid, in steps: the error allowed for the parabola."""

FLAT_SHARE = 0.5
"""A curve is flat if the test does not distinguish this fraction of the alphas from the best."""


@dataclass(frozen=True, slots=True, eq=False)
class AlphaEstimate:
    """The best alpha by one metric, from simulations with several seeds.

    `docs/sweep-method.md` has the equations. K is the number of seeds, A that of alphas.

    Attributes
    ----------
    alpha : float
        Mean of `per_seed`.
    uncertainty : float
        One standard deviation: the larger of the scatter over the seeds and `self_check_error`, and
        the rounding to the grid, which is a whole step on an edge. NaN if unknown: with a single
        seed, or if all simulations are noise.
    standard_error : float
        Standard deviation of `per_seed` over the square root of K: the scatter due to the seeds of
        the simulation, without that of the measurement's own speckle. NaN with a single seed.
    per_seed : ndarray, shape (K,)
        Vertex of the parabola through the best score of a seed and its two neighbours.
    on_edge : bool
        Whether the score of some seed is best at an end of the range: the truth may lie outside.
    self_check_error : float
        Root mean square error of the same estimate for simulations at the nearest alpha of the grid
        in place of the measurement. NaN with a single seed.
    metric : str
        The field of `Metrics` that was used.
    values : ndarray, shape (K, A)
        The metric of each simulation against the measurement.
    self_agreement : ndarray, shape (A,)
        The metric of simulations against those with another seed; NaN with a single seed.
    score : ndarray, shape (K, A)
        The metric corrected for the simulations' own speckle; the higher the better. NaN where the
        metric is undefined, or simulations hardly agree among themselves.
    metric_peak : float
        Maximum of the mean of the metric itself: biased by speckle.
    deficit, deficit_error : ndarray, shape (A,)
        Score below that of `grid_best`, seed by seed: mean and standard error.
    alike : ndarray, shape (A,), bool
        The interval of the grid, around `grid_best`, from the lowest to the highest alpha that the
        paired test does not find worse.
    grid_best : int
        Index of the alpha with the highest mean score.

    Examples
    --------
    >>> import numpy as np
    >>> import calibration
    >>> score = np.array([[0.6, 0.9, 0.7], [0.5, 0.8, 0.7]])
    >>> found = calibration.AlphaEstimate(
    ...     alpha=0.55, uncertainty=0.06, standard_error=0.02, per_seed=np.array([0.53, 0.57]),
    ...     on_edge=False, self_check_error=0.03, metric="ssim", values=0.9 * score,
    ...     self_agreement=np.full(3, 0.81), score=score, metric_peak=0.54,
    ...     deficit=np.array([0.3, 0.0, 0.15]), deficit_error=np.array([0.0, 0.0, 0.05]),
    ...     alike=np.array([False, True, False]), grid_best=1)
    >>> found.text(), found.flat, found.remarks(np.array([0.1, 0.5, 0.9]))
    ('0.550 ± 0.060', False, [])
    """

    alpha: float
    uncertainty: float
    standard_error: float
    per_seed: np.ndarray
    on_edge: bool
    self_check_error: float
    metric: str
    values: np.ndarray
    self_agreement: np.ndarray
    score: np.ndarray
    metric_peak: float
    deficit: np.ndarray
    deficit_error: np.ndarray
    alike: np.ndarray
    grid_best: int

    @property
    def flat(self) -> bool:
        """Whether the paired test distinguishes few alphas from the best."""
        if len(self.values) == 1:
            return False
        good = _insignificant(self.deficit, self.deficit_error, len(self.values))
        return bool(np.count_nonzero(good) >= max(3, FLAT_SHARE * good.size))

    @property
    def corrected(self) -> bool:
        """Whether the score is corrected for speckle: not with one seed, nor if all is noise."""
        return _is_corrected(self.self_agreement, self.metric)

    def text(self) -> str:
        """The alpha and its uncertainty."""
        if math.isnan(self.uncertainty):
            return f"{self.alpha:.3f} (uncertainty unknown)"
        return f"{self.alpha:.3f} \N{PLUS-MINUS SIGN} {self.uncertainty:.3f}"

    def remarks(self, alphas: np.ndarray) -> list[str]:
        """Reasons to doubt the estimate, one clause each: `sweep` warns of them."""
        found = []
        # Beyond 0 and 1 there is nothing.
        ends = [end for end in alphas[[0, -1]] if 0.0 < end < 1.0 and (self.per_seed == end).any()]
        if ends:
            found.append(
                f"the best score is at {ends[0]:g}, an end of the range of alphas, for some seed; "
                "the truth may lie beyond: take a wider range"
            )
        if self.flat:
            found.append(
                f"the curve is flat: {int(self.alike.sum())} of {self.alike.size} alphas score as "
                "well as the best within the spread of the seeds; more seeds, samples or rays help"
            )
        noise = alphas[self.self_agreement < MIN_SELF_AGREEMENT]
        if self.metric in HIGHER_IS_BETTER and noise.size:
            where = ", ".join(f"{alpha:g}" for alpha in noise)
            if noise.size == alphas.size:
                where = "every alpha, so the metric is not corrected and this alpha is unreliable"
            found.append(
                f"two seeds agree by less than {MIN_SELF_AGREEMENT:g} at {where}; more samples or "
                "rays help"
            )
        return found

    def notes(self, alphas: np.ndarray) -> list[str]:
        """What the choice of seeds, metric and grid means for the estimate, one clause each."""
        found = []
        if len(self.values) == 1:
            found.append("one seed: no uncertainty, and rough surfaces come out too smooth")
        if self.metric not in HIGHER_IS_BETTER:
            found.append(f"{self.metric} favours small alphas where surfaces are rough")
        if self.alike.sum() > 1:
            low, high = alphas[self.alike][[0, -1]]
            found.append(
                f"as good as the best within the spread of {len(self.values)} seeds: {low:g} to "
                f"{high:g}"
            )
        return found

    def to_dict(self, alphas: np.ndarray) -> dict[str, Any]:
        """All numbers in types that strict JSON has; None stands for NaN."""
        record = {field.name: getattr(self, field.name) for field in fields(self)}
        record["grid_best"] = float(alphas[self.grid_best])
        record["flat"] = self.flat
        return {name: plain(value) for name, value in record.items()}


def plain(value: Any) -> Any:
    """Convert numbers and arrays to JSON types; None stands for NaN."""
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def estimate_alpha(
    measured: DepthMap,
    images: Images,
    alphas: np.ndarray,
    metric: str,
    dynamic_range_db: float,
) -> AlphaEstimate:
    """Estimate alpha by one metric, a field of `Metrics`.

    `images` are [seed][alpha], `alphas` ascending, shape (A,).

    Raises
    ------
    CompareError
        No alpha at which every seed has an image and a defined metric.
    """
    n_seeds = len(images)
    score, values, own = _scores(measured, images, metric, dynamic_range_db)
    if not np.isfinite(score).all(axis=0).any():
        raise CompareError(
            f"sweep: {metric} is undefined at every alpha; look at the images and at where the "
            "mesh is placed"
        )
    peaks = [peak(alphas, row) for row in score]
    per_seed = np.array([at for at, _ in peaks])
    on_edge = any(edge for _, edge in peaks)
    alpha = float(per_seed.mean())
    nearest = int(np.argmin(np.abs(alphas - alpha)))
    errors = _self_check(images, alphas, nearest, own, metric, dynamic_range_db)
    mean = score.mean(axis=0)
    best = int(np.nanargmax(mean))
    deficit, deficit_error, alike = _paired(score, best)
    scatter = float(per_seed.std(ddof=1)) if n_seeds > 1 else math.nan
    self_check = float(np.sqrt(np.mean(np.square(errors)))) if errors.size else math.nan
    step = float(np.diff(alphas).max())
    uncertainty = _uncertainty(scatter, n_seeds, self_check, step if on_edge else GRID_STD * step)
    if not _is_corrected(own, metric):
        uncertainty = math.nan
    return AlphaEstimate(
        alpha=alpha,
        uncertainty=uncertainty,
        standard_error=scatter / math.sqrt(n_seeds),
        per_seed=per_seed,
        on_edge=on_edge,
        self_check_error=self_check,
        metric=metric,
        values=values,
        self_agreement=own,
        score=score,
        metric_peak=peak(alphas, _signed(values, metric).mean(axis=0))[0],
        deficit=deficit,
        deficit_error=deficit_error,
        alike=alike,
        grid_best=best,
    )


def mean_score(
    measured: DepthMap, images: Images, metric: str, dynamic_range_db: float
) -> np.ndarray:
    """Mean over the seeds of `AlphaEstimate.score`, shape (A,); NaN if undefined."""
    return _scores(measured, images, metric, dynamic_range_db)[0].mean(axis=0)


def _scores(
    measured: DepthMap, images: Images, metric: str, dynamic_range_db: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Score and values, shape (K, A), and self-agreement, shape (A,)."""
    checks.one_of("metric", metric, METRICS)
    values = np.array(
        [[_value(metric, measured, image, dynamic_range_db) for image in row] for row in images]
    )
    own = np.full(values.shape[1], math.nan)
    if len(images) > 1:
        symmetric = metric in HIGHER_IS_BETTER
        between = [
            [_value(metric, *both, dynamic_range_db) for both in zip(one, other, strict=True)]
            for one, other in (combinations if symmetric else permutations)(images, 2)
        ]
        own = np.mean(between, axis=0)
    return scored(values, own, metric), values, own


def _value(
    metric: str, one: DepthMap | None, other: DepthMap | None, dynamic_range_db: float
) -> float:
    if one is None or other is None:
        return math.nan
    return compare_by(metric, one, other, dynamic_range_db=dynamic_range_db)


def _self_check(
    images: Images,
    alphas: np.ndarray,
    at: int,
    own: np.ndarray,
    metric: str,
    dynamic_range_db: float,
) -> np.ndarray:
    """Errors of the estimate for one seed's image at an alpha in place of the measurement."""
    errors = []
    for stand_in, other in permutations(images, 2):
        values = np.array([_value(metric, stand_in[at], b, dynamic_range_db) for b in other])
        score = scored(values, own, metric)
        if np.isfinite(score).any():
            errors.append(peak(alphas, score)[0] - alphas[at])
    return np.array(errors)


def scored(values: np.ndarray, own: np.ndarray, metric: str) -> np.ndarray:
    """Correct a metric for the speckle of the simulations; the higher the better.

    Parameters
    ----------
    values : ndarray, shape (..., A)
    own : ndarray, shape (A,)
        Of simulations against those with another seed; NaN throughout with a single seed. Then, and
        if it is too small at every alpha, the values are not corrected.
    metric : str
    """
    if not _is_corrected(own, metric):
        return _signed(values, metric)
    if metric in HIGHER_IS_BETTER:
        # Spearman's correction for attenuation: noise reduces a similarity of 1 to sqrt(own).
        return values / np.sqrt(np.where(own >= MIN_SELF_AGREEMENT, own, math.nan))
    return -(values - 0.5 * own)


def _is_corrected(own: np.ndarray, metric: str) -> bool:
    least = MIN_SELF_AGREEMENT if metric in HIGHER_IS_BETTER else -math.inf
    return bool((own >= least).any())  # no NaN is


def _signed(values: np.ndarray, metric: str) -> np.ndarray:
    return values if metric in HIGHER_IS_BETTER else -values


def peak(alphas: np.ndarray, score: np.ndarray) -> tuple[float, bool]:
    """Maximum of a curve, and whether that is at an end of its domain.

    The vertex of the parabola through the highest point and its two neighbours, which may be
    unevenly spaced; it lies between them.
    """
    i = int(np.nanargmax(score))
    if i in (0, len(score) - 1) or not np.isfinite(score[i - 1 : i + 2]).all():
        return float(alphas[i]), True
    before, after = alphas[i] - alphas[i - 1], alphas[i + 1] - alphas[i]
    fall, drop = score[i] - score[i - 1], score[i] - score[i + 1]
    bend = after * fall + before * drop
    if bend <= 0:  # three equal values
        return float(alphas[i]), False
    vertex = alphas[i] + 0.5 * (after**2 * fall - before**2 * drop) / bend
    return float(np.clip(vertex, alphas[i - 1], alphas[i + 1])), False


def _paired(score: np.ndarray, best: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and standard error of each alpha's deficit, and the interval of those like `best`."""
    lacking = score[:, best : best + 1] - score
    n = len(score)
    deficit = lacking.mean(axis=0)
    if n == 1:
        nothing = np.full(deficit.shape, math.nan)
        return deficit, nothing, np.arange(deficit.size) == best
    error = lacking.std(axis=0, ddof=1) / math.sqrt(n)
    # The score has one maximum: what is between two that could be the best could be it, too.
    first, last = np.flatnonzero(_insignificant(deficit, error, n))[[0, -1]]
    index = np.arange(deficit.size)
    return deficit, error, (index >= first) & (index <= last) & np.isfinite(deficit)


def _insignificant(deficit: np.ndarray, error: np.ndarray, n_seeds: int) -> np.ndarray:
    """Where a deficit passes the one-sided paired test: always at the best."""
    return deficit <= stats.t.ppf(PAIRED_CONFIDENCE, n_seeds - 1) * error


def _uncertainty(scatter: float, n_seeds: int, self_check: float, grid: float) -> float:
    # The measurement is a single realisation of speckle, which moves the peak as much as one seed
    # of the simulation: hence 1 + 1/K and not 1/K.
    of_seeds = scatter * math.sqrt(1 + 1 / n_seeds)
    return math.hypot(np.fmax(of_seeds, self_check), grid)
