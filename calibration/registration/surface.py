"""A depth map as a surface: points, normals, and the planes under other points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from clradar.compare import depth_map_of
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume

MIN_POINTS = 30
"""Fewer depth points than this on either side are not a surface: six unknowns, five-fold."""

NORMAL_RADIUS_M = 5e-3
"""Normals come from the depth points this near, about the lateral resolution of the imager."""

_COARSE_POINTS = 500  # of each image, drawn for the coarse start
_NEIGHBOURS = 128  # at most, for a normal
_PLANES = 4  # that a point is matched with


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The depth points that have enough neighbours for a normal.

    `points_m`, `normals`, shape (n, 3); `weights`, shape (n,), amplitudes relative to the largest;
    `gap_m`, shape (n,), how far apart neighbouring points are where the surface is as steep as
    here; `centre_m`, shape (3,), the weighted median of each coordinate, and `radius_m`, the
    weighted median distance from there: medians, for clutter far off must not change the object's
    size.
    """

    points_m: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gap_m: np.ndarray
    tree: cKDTree
    pixel_m: float
    centre_m: np.ndarray
    radius_m: float

    @classmethod
    def of(cls, image: Volume | DepthMap, dynamic_range_db: float, label: str) -> Surface:
        depth = measured_depth_map(image, dynamic_range_db, label)
        points_m = depth.points_m()
        weights = depth.amplitude[depth.mask].astype(np.float64)
        steps_m = [np.diff(axis_m) for axis_m in (depth.x_m, depth.y_m) if len(axis_m) > 1]
        pixel_m = max(float(np.median(step_m)) for step_m in steps_m)
        # Two pixels to every side at least, also where the pixels are coarse.
        reach_m = max(NORMAL_RADIUS_M, 2.5 * pixel_m)
        normals, usable = _normals(points_m, pixel_m, reach_m)
        if np.count_nonzero(usable) < MIN_POINTS:
            raise failure(
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
            centre_m=centre_m,
            radius_m=weighted_quantile(distance_m, weights, 0.5),
        )

    @property
    def centroid_m(self) -> np.ndarray:
        """Weighted mean, shape (3,), metres."""
        return self.weights @ self.points_m / self.weights.sum()

    def thinned(self) -> Surface:
        """Return the surface with the points of `some` alone."""
        kept = self.some()
        return replace(
            self,
            points_m=self.points_m[kept],
            weights=self.weights[kept],
            normals=self.normals[kept],
            gap_m=self.gap_m[kept],
            tree=cKDTree(self.points_m[kept]),
        )

    def some(self) -> np.ndarray:
        """Return the indices of up to `_COARSE_POINTS` points: all, or the same draw every time."""
        n = len(self.points_m)
        if n <= _COARSE_POINTS:
            return np.arange(n)
        rng = np.random.Generator(np.random.Philox(0))
        return np.sort(rng.choice(n, _COARSE_POINTS, replace=False))

    @property
    def unit(self) -> np.ndarray:
        """What to multiply a twist with for one whose six numbers are all metres, shape (6,)."""
        return np.repeat([self.radius_m, 1.0], 3)


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """For each of n points the plane through its neighbours, and where the point is from it.

    `residual_m` is along the normal, `aside_m` across it, from the neighbours' mean; `weights` and
    `gap_m` are the neighbours' means.
    """

    normals: np.ndarray
    residual_m: np.ndarray
    aside_m: np.ndarray
    weights: np.ndarray
    gap_m: np.ndarray


def planes_under(surface: Surface, points_m: np.ndarray) -> Planes:
    distance_m, near = surface.tree.query(points_m, _PLANES + 1)
    # Neighbours come and go with weight 0, so that the residual has no jumps to get stuck at.
    closeness = (1.0 - (distance_m[:, :-1] / distance_m[:, -1:]) ** 2) ** 2
    # Never all 0, not even where the neighbours are all equally far.
    closeness = closeness + 1e-9
    closeness = closeness / closeness.sum(axis=1, keepdims=True)
    near = near[:, :-1]
    normals = np.einsum("nk,nki->ni", closeness, surface.normals[near])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    offset_m = points_m - np.einsum("nk,nki->ni", closeness, surface.points_m[near])
    residual_m = (offset_m * normals).sum(axis=1)
    return Planes(
        normals=normals,
        residual_m=residual_m,
        aside_m=np.linalg.norm(offset_m - residual_m[:, None] * normals, axis=1),
        weights=(closeness * surface.weights[near]).sum(axis=1),
        gap_m=(closeness * surface.gap_m[near]).sum(axis=1),
    )


def weighted_quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, share * below[-1])]])


def failure(reason: str) -> CompareError:
    return CompareError(f"could not align, because {reason}")


def measured_depth_map(image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthMap:
    try:
        depth = depth_map_of(image, dynamic_range_db, label)
    except CompareError as error:
        raise failure(str(error)) from error
    n = np.count_nonzero(depth.mask)
    if n < MIN_POINTS:
        raise failure(f"the {label} has {n} depth points, and {MIN_POINTS} are the least")
    return depth


def _normals(points_m: np.ndarray, pixel_m: float, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal of the plane through each point's neighbours, and where there is one."""
    distance_m, near = cKDTree(points_m).query(points_m, _NEIGHBOURS, distance_upper_bound=reach_m)
    found = np.isfinite(distance_m)
    near = np.where(found, near, 0)
    n_found = found.sum(axis=1)
    mean_m = np.where(found[..., None], points_m[near], 0.0).sum(axis=1) / n_found[:, None]
    offset_m = np.where(found[..., None], points_m[near] - mean_m[:, None], 0.0)
    spread = np.einsum("nki,nkj->nij", offset_m, offset_m) / n_found[:, None, None]
    variance, axes = np.linalg.eigh(spread)
    normals = axes[:, :, 0]
    # A normal has no sign of its own: all turn towards the radar.
    normals = normals * np.where(normals[:, 2:] > 0, -1.0, 1.0)
    # A row of pixels, or fewer than five, has no plane through it.
    return normals, (n_found >= 5) & (variance[:, 1] > (0.25 * pixel_m) ** 2)
