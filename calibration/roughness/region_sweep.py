"""Estimation of an alpha per region, from the linear superposition of region images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.roughness.estimate import AlphaEstimate, Images, estimate_alpha, mean_score, plain
from calibration.roughness.region_pixels import EVERYTHING_DB, within
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, VoxelGrid

MAX_PASSES = 6
"""Passes of the coordinate descent over more than two regions."""

VolumeOf = Callable[[int, int, int], np.ndarray]
"""Complex image of one region: (seed, alpha, region), all by number -> complex data."""


@dataclass(frozen=True, slots=True, eq=False)
class RegionSweep:
    """The combination of region alphas whose images match the measurement best.

    Each region is compared in its own pixels, relative to their maximum, so that a dim region has
    the same weight as a bright one.

    Attributes
    ----------
    names : tuple of str
    pixels : ndarray, shape (n_y, n_x), int
        Number of the region that a pixel shows, -1 for none.
    best : tuple of int
        The combination of alphas of the grid with the highest score, as indices.
    score : float
        Mean over regions and seeds of `AlphaEstimate.score` there.
    uniform_score : float
        The same with one alpha for all: the highest of the grid for two regions, that at the best
        alpha of the whole mesh for more.
    estimates : tuple of AlphaEstimate
        One per region, in its own pixels, with the others fixed at `best`; `uncertainty` includes
        the propagated uncertainty of the others.
    coupling : ndarray, shape (n, n)
        Derivative of the alpha of the row's region by that of the column's.
    grid : ndarray, shape (A, A), or None
        The score of all combinations (first region, second region), of two regions.
    converged : bool
        Whether the descent converged; always for two regions.
    image : DepthMap
        Of the first seed at `best`, the whole mesh.

    Examples
    --------
    The left and the right half of a sphere:

    >>> import clradar, numpy as np, trimesh
    >>> import calibration
    >>> mesh = trimesh.creation.icosphere(3, 0.04)
    >>> side = np.where(mesh.triangles_center[:, 0] < 0, "left", "right")
    >>> regions = calibration.Regions.of_labels(side)
    >>> scene = clradar.Scene(
    ...     mesh.vertices + [0, 0, 0.3], mesh.faces, 0.5, regions.face, regions.names)
    >>> q = clradar.arrays.qar50()
    >>> radar = {"array": clradar.AntennaArray(q.tx_m[::12], q.rx_m[::12]),
    ...          "waveform": clradar.Waveform.sfcw(72e9, 82e9, 16), "device": "pocl"}
    >>> rays = {"samples_per_mm2": 0.5, "reception_radius_m": 0.02}
    >>> capture = clradar.simulate(scene.with_alpha({"left": 0.1, "right": 0.5}), **radar, **rays)
    >>> grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.25, 0.3), 5e-3)
    >>> image = clradar.backproject(capture, grid, device="pocl")
    >>> found = calibration.sweep(
    ...     image, scene, [0.0, 0.1, 0.5, 0.9], seeds=1, regions=regions, **radar, **rays)
    >>> dict(zip(found.regions.names, found.alphas[list(found.regions.best)].tolist()))
    {'left': 0.1, 'right': 0.5}
    """

    names: tuple[str, ...]
    pixels: np.ndarray
    best: tuple[int, ...]
    score: float
    uniform_score: float
    estimates: tuple[AlphaEstimate, ...]
    coupling: np.ndarray
    grid: np.ndarray | None
    converged: bool
    image: DepthMap

    def to_dict(self, alphas: np.ndarray) -> dict[str, Any]:
        """All numbers in types that strict JSON has; None stands for NaN."""
        return {
            "names": list(self.names),
            "pixels": [int((self.pixels == r).sum()) for r in range(len(self.names))],
            "best": {n: float(alphas[i]) for n, i in zip(self.names, self.best, strict=True)},
            "score": plain(self.score),
            "uniform_score": plain(self.uniform_score),
            "converged": self.converged,
            "coupling": plain(self.coupling),
            "grid": None if self.grid is None else plain(self.grid),
            "estimates": {
                n: e.to_dict(alphas) for n, e in zip(self.names, self.estimates, strict=True)
            },
        }


@dataclass(frozen=True, slots=True, eq=False)
class RegionImages:
    """Images of combinations of alphas, and the measured image, region by region.

    `measured` has a depth wherever its amplitude is not zero; `pixels` are those of `RegionSweep`.
    """

    measured: DepthMap
    grid: VoxelGrid
    names: tuple[str, ...]
    pixels: np.ndarray
    volume_of: VolumeOf
    n_seeds: int
    n_alphas: int
    metric: str
    dynamic_range_db: float

    def along(self, combination: Sequence[int], region: int) -> list[list[DepthMap | None]]:
        """Whole images [seed][alpha] over the alpha of one region, the others fixed."""
        rows = []
        for k in range(self.n_seeds):
            others = self._sum(k, combination, region)
            row = [others + self.volume_of(k, i, region) for i in range(self.n_alphas)]
            rows.append([_everywhere(data, self.grid) for data in row])
        return rows

    def at(self, combination: Sequence[int]) -> DepthMap:
        """Image of the first seed."""
        data = self._sum(0, combination, None)
        return Volume(data, self.grid).depth_map(self.dynamic_range_db)

    def _sum(self, k: int, combination: Sequence[int], but: int | None) -> np.ndarray:
        total: np.ndarray = np.zeros(self.grid.shape, np.complex64)
        for r, i in enumerate(combination):
            if r != but:
                total += self.volume_of(k, i, r)
        return total

    def of_region(self, images: Images, region: int) -> tuple[DepthMap, Images]:
        """The measured and the simulated images in the pixels of a region."""
        mine = self.pixels == region
        measured = within(self.measured, mine, self.dynamic_range_db)
        if measured is None:
            raise CompareError(
                f"sweep: the measured image is 0 in all pixels of region '{self.names[region]}'"
            )
        return measured, [
            [None if i is None else within(i, mine, self.dynamic_range_db) for i in row]
            for row in images
        ]

    def scores(self, images: Images) -> np.ndarray:
        """Mean score over regions and seeds, shape (A,)."""
        of_each = [
            mean_score(*self.of_region(images, r), self.metric, self.dynamic_range_db)
            for r in range(len(self.names))
        ]
        return np.mean(of_each, axis=0)

    def estimate(
        self, combination: Sequence[int], region: int, alphas: np.ndarray
    ) -> AlphaEstimate:
        """Estimate the alpha of one region, the others fixed."""
        measured, images = self.of_region(self.along(combination, region), region)
        return estimate_alpha(measured, images, alphas, self.metric, self.dynamic_range_db)


def _everywhere(data: np.ndarray, grid: VoxelGrid) -> DepthMap | None:
    return Volume(data, grid).depth_map(EVERYTHING_DB) if data.any() else None


def sweep_regions(images: RegionImages, alphas: np.ndarray, start: int) -> RegionSweep:
    """Estimate the alpha of each region.

    With single reflections a capture is the sum over the regions, and so is its image: a
    combination of alphas costs a sum of volumes and a metric. Exhaustive search for two regions,
    coordinate descent from alpha number `start` for more.
    """
    n = len(images.names)
    grid, converged = None, True
    if n == 2:
        grid = np.stack([images.scores(images.along((i, 0), 1)) for i in range(len(alphas))])
        if not np.isfinite(grid).any():
            raise _undefined(images.metric)
        best = [int(i) for i in np.unravel_index(np.nanargmax(grid), grid.shape)]
        score = float(np.nanmax(grid))
        same = np.diagonal(grid)
        uniform = float(np.nanmax(same)) if np.isfinite(same).any() else -np.inf
    else:
        best = [start] * n
        uniform = score = -np.inf
        for number in range(MAX_PASSES):
            before = list(best)
            for region in range(n):
                row = images.scores(images.along(best, region))
                if not np.isfinite(row).any():
                    raise _undefined(images.metric)
                if number == 0 and region == 0:
                    uniform = float(row[start])
                best[region], score = int(np.nanargmax(row)), float(np.nanmax(row))
            converged = best == before
            if converged:
                break
    estimates = [images.estimate(best, region, alphas) for region in range(n)]
    coupling = _coupling(images, best, alphas)
    return RegionSweep(
        names=images.names,
        pixels=images.pixels,
        best=tuple(best),
        score=score,
        uniform_score=uniform,
        estimates=_with_the_others(estimates, coupling),
        coupling=coupling,
        grid=grid,
        converged=converged,
        image=images.at(best),
    )


def _coupling(images: RegionImages, best: Sequence[int], alphas: np.ndarray) -> np.ndarray:
    """d alpha_r / d alpha_q from the best combination and its neighbours on the grid."""
    n = len(best)
    slope = np.zeros((n, n))
    for q, i in enumerate(best):
        ends = (max(i - 1, 0), min(i + 1, len(alphas) - 1))
        for r in range(n):
            if r != q:
                low, high = (
                    images.estimate([*best[:q], end, *best[q + 1 :]], r, alphas).alpha
                    for end in ends
                )
                slope[r, q] = (high - low) / (alphas[ends[1]] - alphas[ends[0]])
    return slope


def _with_the_others(
    estimates: Sequence[AlphaEstimate], coupling: np.ndarray
) -> tuple[AlphaEstimate, ...]:
    own = np.array([estimate.uncertainty for estimate in estimates])
    total = np.sqrt(own**2 + coupling**2 @ own**2)
    return tuple(replace(e, uncertainty=float(u)) for e, u in zip(estimates, total, strict=True))


def _undefined(metric: str) -> CompareError:
    return CompareError(
        f"sweep: {metric} is undefined in the pixels of some region at every combination of alphas"
    )
