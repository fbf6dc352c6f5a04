"""An alpha for each region of a mesh, from images that add up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.alpha_estimate import AlphaEstimate, Images, estimate_alpha, mean_score, plain
from calibration.regions import Regions
from clradar.model import DepthMap

MAX_PASSES = 6
"""Of the descent where there are more than two regions."""

VolumeOf = Callable[[int, int, int], np.ndarray]
"""What a region adds to an image: (seed, alpha, region) -> complex data; numbers, not values."""


@dataclass(frozen=True, slots=True, eq=False)
class RegionSweep:
    """The alphas of the regions that together are most like the measurement.

    Attributes
    ----------
    names : tuple of str
    best : tuple of int
        The combination of alphas of the grid with the highest mean score, as indices.
    score : float
        Its mean score; see `AlphaEstimate.score`.
    uniform_score : float
        The highest mean score with one alpha for all.
    estimates : tuple of AlphaEstimate
        One per region, each with the others held at `best`.
    grid : ndarray, shape (A, A), or None
        The mean score of all combinations (first region, second region), of two regions.
    converged : bool
        Whether the descent came to rest; always where all combinations were tried.
    image : DepthMap or None
        Of the first seed at `best`.
    """

    names: tuple[str, ...]
    best: tuple[int, ...]
    score: float
    uniform_score: float
    estimates: tuple[AlphaEstimate, ...]
    grid: np.ndarray | None
    converged: bool
    image: DepthMap | None

    def to_dict(self, alphas: np.ndarray) -> dict[str, Any]:
        """Return all numbers in types that strict JSON knows."""
        return {
            "names": list(self.names),
            "best": {n: float(alphas[i]) for n, i in zip(self.names, self.best, strict=True)},
            "score": plain(self.score),
            "uniform_score": plain(self.uniform_score),
            "converged": self.converged,
            "grid": None if self.grid is None else plain(self.grid),
            "estimates": {
                n: e.to_dict(alphas) for n, e in zip(self.names, self.estimates, strict=True)
            },
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Mixer:
    """Images of combinations of alphas."""

    volume_of: VolumeOf
    depth_map: Callable[[np.ndarray], DepthMap | None]
    n_seeds: int
    n_alphas: int

    def along(self, combination: Sequence[int], region: int) -> Images:
        """Return the images [seed][alpha] over the alpha of one region, the others held."""
        return [
            [self.depth_map(others + self.volume_of(k, i, region)) for i in range(self.n_alphas)]
            for k, others in (
                (k, self._without(k, combination, region)) for k in range(self.n_seeds)
            )
        ]

    def at(self, combination: Sequence[int]) -> DepthMap | None:
        """Return the image of the first seed."""
        return self.depth_map(self._without(0, combination, None))

    def _without(self, k: int, combination: Sequence[int], region: int | None) -> np.ndarray:
        parts = [self.volume_of(k, i, r) for r, i in enumerate(combination) if r != region]
        total = np.zeros_like(parts[0])
        for part in parts:
            total += part
        return total


def sweep_regions(
    measured: DepthMap,
    volume_of: VolumeOf,
    depth_map: Callable[[np.ndarray], DepthMap | None],
    n_seeds: int,
    regions: Regions,
    alphas: np.ndarray,
    start: Sequence[int],
    metric: str,
    dynamic_range_db: float,
) -> RegionSweep:
    """Return the best alpha of each region.

    With single reflections a capture is the sum of what each region reflects, and so is its image:
    every combination of alphas costs a sum of volumes and a metric. For two regions all of them are
    tried, for more one region after the other from `start`, until none changes.
    """
    mixer = _Mixer(volume_of, depth_map, n_seeds, len(alphas))

    def scores(images: Images) -> np.ndarray:
        return mean_score(measured, images, metric, dynamic_range_db)

    n = len(regions.names)
    grid, converged = None, True
    if n == 2:
        grid = np.stack([scores(mixer.along((i, 0), 1)) for i in range(len(alphas))])
        best = [int(i) for i in np.unravel_index(np.nanargmax(grid), grid.shape)]
        score, uniform = float(np.nanmax(grid)), float(np.nanmax(np.diagonal(grid)))
    else:
        best = list(start)
        uniform, score = -np.inf, -np.inf
        for _ in range(MAX_PASSES):
            before = list(best)
            for region in range(n):
                row = scores(mixer.along(best, region))
                if np.isneginf(uniform):
                    uniform = float(row[best[region]])
                best[region], score = int(np.nanargmax(row)), float(np.nanmax(row))
            converged = best == before
            if converged:
                break
    estimates = tuple(
        estimate_alpha(measured, mixer.along(best, region), alphas, metric, dynamic_range_db)
        for region in range(n)
    )
    return RegionSweep(
        names=regions.names,
        best=tuple(best),
        score=score,
        uniform_score=uniform,
        estimates=estimates,
        grid=grid,
        converged=converged,
        image=mixer.at(best),
    )
