"""Oriented point clouds from depth maps, and the local planes of such a surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calibration.registration.observability import TwistScale
from clradar.compare.images import depth_map_of, weighted_quantile
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume

MIN_POINTS = 30  # fewest depth points of a surface: five for each of six unknowns
NORMAL_RADIUS_M = 5e-3
"""Neighbourhood of the plane fits for normals, about the lateral resolution of the imager."""

NOT_ALIGNED = "could not align, because "

_COARSE_POINTS = 500  # of each image, drawn for the coarse start
_NEIGHBOURS = 128  # at most, for a normal
_PLANES = 4  # interpolated for each point


@dataclass(frozen=True, slots=True, eq=False)
class DepthSurface:
    """The depth points that have enough neighbours for a normal.

    `points_m`, `normals`, shape (n, 3); `weights`, shape (n,), amplitudes relative to the largest;
    `gap_m`, shape (n,), distance of neighbouring points on a surface of this inclination; `scale`,
    the weighted median of each coordinate and the weighted median distance from there: medians,
    which are robust against distant clutter.
    """

    points_m: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gap_m: np.ndarray
    tree: cKDTree
    pixel_m: float
    scale: TwistScale

    @classmethod
    def of(cls, image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthSurface:
        depth = checked_depth_map(image, dynamic_range_db, label)
        points_m = depth.points_m()
        weights = depth.amplitude[depth.mask].astype(np.float64)
        steps_m = [np.diff(axis_m) for axis_m in (depth.x_m, depth.y_m) if len(axis_m) > 1]
        pixel_m = max(float(np.median(step_m)) for step_m in steps_m)
        # At least two pixels to every side, also for coarse pixels.
        reach_m = max(NORMAL_RADIUS_M, 2.5 * pixel_m)
        normals, usable = _normals(points_m, pixel_m, reach_m)
        if np.count_nonzero(usable) < MIN_POINTS:
            raise not_aligned(
                f"the {label} has {np.count_nonzero(usable)} depth points with enough neighbours "
                f"within {1e3 * reach_m:.1f} mm for a normal, and {MIN_POINTS} are the least"
            )
        points_m, weights, normals = points_m[usable], weights[usable], normals[usable]
        centre_m = np.array([weighted_quantile(axis_m, weights, 0.5) for axis_m in points_m.T])
        distance_m = np.linalg.norm(points_m - centre_m, axis=1)
        return cls(
            points_m=points_m,
            weights=weights / weights.max(),
            normals=normals,
            gap_m=pixel_m / np.maximum(np.abs(normals[:, 2]), 0.1),
            tree=cKDTree(points_m),
            pixel_m=pixel_m,
            scale=TwistScale(centre_m, weighted_quantile(distance_m, weights, 0.5)),
        )

    @property
    def centroid_m(self) -> np.ndarray:
        """Weighted mean, shape (3,), metres."""
        return self.weights @ self.points_m / self.weights.sum()

    def subsampled(self) -> DepthSurface:
        """The surface with the points of `subsample` alone."""
        kept = self.subsample()
        return replace(
            self,
            points_m=self.points_m[kept],
            weights=self.weights[kept],
            normals=self.normals[kept],
            gap_m=self.gap_m[kept],
            tree=cKDTree(self.points_m[kept]),
        )

    def subsample(self) -> np.ndarray:
        """Indices of up to `_COARSE_POINTS` points: all, or the same random draw every time."""
        n = len(self.points_m)
        if n <= _COARSE_POINTS:
            return np.arange(n)
        rng = np.random.Generator(np.random.Philox(0))
        return np.sort(rng.choice(n, _COARSE_POINTS, replace=False))


@dataclass(frozen=True, slots=True, eq=False)
class LocalPlanes:
    """The interpolated plane of a surface near each of n points, and the points' offsets from it.

    `residual_m` is along the normal, `aside_m` across it, from the neighbours' mean; `weights` and
    `gap_m` are the neighbours' means.
    """

    normals: np.ndarray
    residual_m: np.ndarray
    aside_m: np.ndarray
    weights: np.ndarray
    gap_m: np.ndarray


def local_planes(surface: DepthSurface, points_m: np.ndarray) -> LocalPlanes:
    distance_m, near = surface.tree.query(points_m, _PLANES + 1)
    # The weight of a neighbour is 0 where it is replaced, so that the residual is continuous.
    closeness = (1.0 - (distance_m[:, :-1] / distance_m[:, -1:]) ** 2) ** 2
    # Never all 0, not even for neighbours at equal distances.
    closeness = closeness + 1e-9
    closeness = closeness / closeness.sum(axis=1, keepdims=True)
    near = near[:, :-1]
    normals = np.einsum("nk,nki->ni", closeness, surface.normals[near])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    offset_m = points_m - np.einsum("nk,nki->ni", closeness, surface.points_m[near])
    residual_m = (offset_m * normals).sum(axis=1)
    return LocalPlanes(
        normals=normals,
        residual_m=residual_m,
        aside_m=np.linalg.norm(offset_m - residual_m[:, None] * normals, axis=1),
        weights=(closeness * surface.weights[near]).sum(axis=1),
        gap_m=(closeness * surface.gap_m[near]).sum(axis=1),
    )


def not_aligned(reason: str) -> CompareError:
    return CompareError(f"{NOT_ALIGNED}{reason}")


def checked_depth_map(image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthMap:
    try:
        depth = depth_map_of(image, dynamic_range_db, label)
    except CompareError as error:
        raise not_aligned(str(error)) from error
    n = np.count_nonzero(depth.mask)
    if n < MIN_POINTS:
        raise not_aligned(f"the {label} has {n} depth points, and {MIN_POINTS} are the least")
    return depth


def _normals(points_m: np.ndarray, pixel_m: float, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals of planes fitted to each point's neighbours, and where there is a unique plane."""
    distance_m, near = cKDTree(points_m).query(points_m, _NEIGHBOURS, distance_upper_bound=reach_m)
    found = np.isfinite(distance_m)
    near = np.where(found, near, 0)
    n_found = found.sum(axis=1)
    mean_m = np.where(found[..., None], points_m[near], 0.0).sum(axis=1) / n_found[:, None]
    offset_m = np.where(found[..., None], points_m[near] - mean_m[:, None], 0.0)
    spread = np.einsum("nki,nkj->nij", offset_m, offset_m) / n_found[:, None, None]
    variance, axes = np.linalg.eigh(spread)
    normals = axes[:, :, 0]
    # The sign of a normal is arbitrary: all point towards the radar.
    normals = normals * np.where(normals[:, 2:] > 0, -1.0, 1.0)
    # A row of pixels, or fewer than five, has no unique plane.
    return normals, (n_found >= 5) & (variance[:, 1] > (0.25 * pixel_m) ** 2)
