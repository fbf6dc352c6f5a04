"""Registration of two depth maps: robust point-to-plane ICP from a coarse global search.

Y. Chen, G. Medioni, "Object modelling by registration of multiple range images", Image and Vision
Computing 10(3), 1992, doi 10.1016/0262-8856(92)90066-C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.alignment import UNKNOWN_STD_M, Alignment, warned
from calibration.registration.depth_surface import (
    MIN_POINTS,
    DepthSurface,
    local_planes,
    not_aligned,
)
from calibration.registration.observability import (
    OBSERVABLE,
    complement,
    direction_names,
    unobservable,
    without_unobservable_motion,
)
from calibration.registration.rigid_motion import (
    exp_twist,
    kabsch,
    moved,
    orthonormal,
    plane_jacobian,
    rotation_about,
)
from calibration.registration.search_space import PoseSearch, start_rotations
from clradar.compare.images import weighted_quantile
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.model.progress import Progress, part_of

TUKEY_CUTOFF = 4.685
"""Of Tukey's biweight in standard deviations: 95 % efficient on Gaussian residuals."""

TRIMMED_SHARE = 0.7
"""Trimmed ICP uses the nearest 70 % of the points, so that a third may be missing."""

CONSTRAINT_TOLERANCE = 0.1
"""Largest relative increase of the distance when a single weak direction is constrained."""

STEP_TOLERANCE = 1e-6
"""Converged when the rotation (radians) and the shift (metres) of a step are below this."""

SEARCH_SHARE = 0.55  # share of the ranking of all starts in the time of all, for the progress bar
_COARSE_STEPS = 15  # point to point, for each start
_FINE_STARTS = 4  # refined point to plane
_SUBSAMPLED_STEPS = 30  # point to plane, for each start, on a subsample
_SCALE_STEPS = 20  # in which Tukey's cutoff follows the residuals


def align(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.3,
    max_rms_m: float = 3e-3,
    max_iterations: int = 100,
    progress: Progress | None = None,
) -> Alignment:
    """Find the rigid motion that brings the simulated depth map onto the measured one.

    Biased where highlights move over the surface: if there is a mesh, use `align_mesh`. Trimmed ICP
    (Besl and McKay, doi 10.1109/34.121791), then point to plane: docs/registration-method.md. Every
    remark of the result is a warning.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
        Each on its own pixels.
    dynamic_range_db : float
        Depth points are the pixels within this of their own image's maximum.
    search_deg : float, in (0, 180]
        Largest rotation about boresight in the search, with tilts up to 30 degrees. The result may
        turn further.
    min_inlier_share : float, in (0, 1]
        Smallest share of the simulated amplitude on the measured surface.
    max_rms_m : float
        Largest residual of the inliers.
    max_iterations : int
        Steps before it stops unconverged.

    Returns
    -------
    Alignment

    Raises
    ------
    CompareError
        "could not align, because …": docs/calibration.md has the reasons.

    Examples
    --------
    A bumpy surface, and the same one 2 mm farther along x and 5 mm along z:

    >>> x, y = np.meshgrid(axis_m := np.arange(-20, 21) * 2e-3, axis_m)
    >>> def image(x_m, z_m):
    ...     depth_m = z_m + 2 * x_m**2 + 3 * y**2 + 0.003 * np.sin(150 * x_m + 100 * y)
    ...     return clradar.DepthMap(depth_m, np.ones(x.shape), axis_m, axis_m)
    >>> found = calibration.align(image(x - 0.002, 0.305), image(x, 0.3), search_deg=10.0)
    >>> np.abs(1e3 * found.shift_m).round(1), round(found.rotation_deg)
    (array([2., 0., 5.]), 0)
    """
    PoseSearch("align", search_deg, min_inlier_share, max_iterations)
    dynamic_range_db = checks.dynamic_range("align: dynamic_range_db", dynamic_range_db)
    max_rms_m = checks.positive("align: max_rms_m", max_rms_m)

    surface = DepthSurface.of(measured, dynamic_range_db, "measured image")
    cloud = DepthSurface.of(simulated, dynamic_range_db, "simulated image")
    starts = _coarse(surface, cloud, search_deg, part_of(progress, 0.0, SEARCH_SHARE))
    fit = _best_fit(surface, cloud, starts, max_iterations, part_of(progress, SEARCH_SHARE, 1.0))
    fit, free = _without_unobservable(surface, cloud, fit, max_iterations)
    return warned("align", _alignment(surface, cloud, fit, free, min_inlier_share, max_rms_m))


@dataclass(frozen=True, slots=True, eq=False)
class _IcpFit:
    """Result of point-to-plane ICP."""

    transform: np.ndarray
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Each simulated point, moved, and the measured plane that it is matched with."""

    points_m: np.ndarray
    normals: np.ndarray
    residual_m: np.ndarray
    weights: np.ndarray


def _coarse(
    surface: DepthSurface, cloud: DepthSurface, search_deg: float, progress: Progress | None
) -> list[np.ndarray]:
    """The best starts after point-to-point refinement, best first."""
    # Medians are less affected by clutter on one side than centroids.
    centres = [
        (cloud.centroid_m, surface.centroid_m),
        (cloud.scale.centre_m, surface.scale.centre_m),
    ]
    rotations = start_rotations(search_deg)
    starts = [np.eye(4)] + [rotation_about(r, *pair) for pair in centres for r in rotations]
    best = _rank(surface, cloud, starts, progress)[: 2 * _FINE_STARTS]
    # The identity is always refined: centroids can mislead where the two are aligned already.
    few = [_point_to_point(surface, cloud, starts[i]) for i in dict.fromkeys([0, *best])]
    return [few[i] for i in _rank(surface, cloud, few)[:_FINE_STARTS]]


def _rank(
    surface: DepthSurface,
    cloud: DepthSurface,
    transforms: list[np.ndarray],
    progress: Progress | None = None,
) -> list[int]:
    score = []
    for transform in transforms:
        score.append(_point_distance(surface, cloud, transform))
        if progress is not None:
            progress(len(score), len(transforms))
    return sorted(range(len(score)), key=score.__getitem__)


def _point_distance(surface: DepthSurface, cloud: DepthSurface, transform: np.ndarray) -> float:
    """Trimmed mean distance to the nearest neighbour, both ways, metres."""
    mine, theirs = cloud.subsample(), surface.subsample()
    there = surface.tree.query(moved(transform, cloud.points_m[mine]))[0]
    back = cloud.tree.query(moved(np.linalg.inv(transform), surface.points_m[theirs]))[0]
    return 0.5 * (
        _trimmed_mean(there, cloud.weights[mine]) + _trimmed_mean(back, surface.weights[theirs])
    )


def _surface_distance(surface: DepthSurface, cloud: DepthSurface, transform: np.ndarray) -> float:
    """Trimmed mean distance of either's points from the other's surface, metres.

    Unlike `_point_distance` independent of the pixel positions: within a gap of the nearest point
    only the distance along the normal counts.
    """
    there = _off_surface(surface, moved(transform, cloud.points_m))
    back = _off_surface(cloud, moved(np.linalg.inv(transform), surface.points_m))
    return 0.5 * (_trimmed_mean(there, cloud.weights) + _trimmed_mean(back, surface.weights))


def _off_surface(surface: DepthSurface, points_m: np.ndarray) -> np.ndarray:
    planes = local_planes(surface, points_m)
    return np.hypot(planes.residual_m, np.maximum(planes.aside_m - planes.gap_m, 0.0))


def _trimmed_mean(values: np.ndarray, weights: np.ndarray) -> float:
    kept = values <= weighted_quantile(values, weights, TRIMMED_SHARE)
    return float(weights[kept] @ values[kept] / weights[kept].sum())


def _point_to_point(
    surface: DepthSurface, cloud: DepthSurface, transform: np.ndarray
) -> np.ndarray:
    """Refine a start by trimmed point-to-point ICP, both ways."""
    mine, theirs = cloud.subsample(), surface.subsample()
    for _ in range(_COARSE_STEPS):
        there, i = surface.tree.query(moved(transform, cloud.points_m[mine]))
        back, j = cloud.tree.query(moved(np.linalg.inv(transform), surface.points_m[theirs]))
        from_m = np.concatenate([cloud.points_m[mine], cloud.points_m[j]])
        to_m = np.concatenate([surface.points_m[i], surface.points_m[theirs]])
        weights = np.concatenate([cloud.weights[mine], surface.weights[theirs]])
        distance_m = np.concatenate([there, back])
        kept = distance_m <= weighted_quantile(distance_m, weights, TRIMMED_SHARE)
        transform = kabsch(from_m[kept], to_m[kept], weights[kept])
    return transform


def _point_to_plane(
    surface: DepthSurface,
    cloud: DepthSurface,
    transform: np.ndarray,
    max_iterations: int,
    constrained: np.ndarray | None = None,
) -> _IcpFit:
    """Point-to-plane ICP without motion along `constrained`: scaled twists, shape (6, k).

    By default, without motion along what is unobservable on the measured surface alone.
    """
    converged, iteration, cutoff_m = False, 0, np.inf
    while not converged and iteration < max_iterations:
        # Wide at first, so that parts which do not fit yet attract; in the end only points over the
        # surface count.
        wide = max(1.0, 10.0 * 0.8**iteration)
        matches = _matched(surface, cloud, transform, min(wide, 4.0))
        # Fixed in the end: the steps would not converge with the jumps of a median.
        if iteration < _SCALE_STEPS:
            cutoff_m = _cutoff_m(matches, surface, wide)
        weights = matches.weights * _tukey(matches, cutoff_m)
        hessian, gradient = _normal_equations(surface, matches, weights)
        basis = complement(unobservable(hessian) if constrained is None else constrained)
        step = basis @ np.linalg.solve(basis.T @ hessian @ basis, -basis.T @ gradient)
        step = step / surface.scale.unit
        transform = orthonormal(exp_twist(step, surface.scale.centre_m) @ transform)
        iteration += 1
        small = max(np.linalg.norm(step[:3]), np.linalg.norm(step[3:])) < STEP_TOLERANCE
        converged = bool(small) and wide == 1.0
    return _IcpFit(transform, iteration, converged)


def _best_fit(
    surface: DepthSurface,
    cloud: DepthSurface,
    starts: list[np.ndarray],
    max_iterations: int,
    progress: Progress | None,
) -> _IcpFit:
    """The fit from the start that ends nearest; raise if every start fails."""
    few = cloud.subsampled()
    fits, failures = [], []
    for done, start in enumerate(starts, start=1):
        try:
            fits.append(_point_to_plane(surface, few, start, _SUBSAMPLED_STEPS))
        except CompareError as error:
            failures.append(error)
        if progress is not None:
            progress(done, len(starts))
    if not fits:
        raise failures[0]
    best = min(fits, key=lambda fit: _surface_distance(surface, cloud, fit.transform))
    return _point_to_plane(surface, cloud, best.transform, max_iterations)


def _matched(
    surface: DepthSurface, cloud: DepthSurface, transform: np.ndarray, reach: float
) -> _Matches:
    """Match each simulated point with the nearest measured plane.

    Points beside the surface by more than `reach` gaps have no weight: their neighbour is at a rim,
    whose plane does not extend to them.
    """
    points_m = moved(transform, cloud.points_m)
    planes = local_planes(surface, points_m)
    over = np.maximum(1.0 - (planes.aside_m / (reach * planes.gap_m)) ** 2, 0.0) ** 2
    if np.count_nonzero(over) < MIN_POINTS:
        raise not_aligned(
            f"the two hardly overlap: {np.count_nonzero(over)} simulated depth points lie over "
            f"the measured surface, and {MIN_POINTS} are the least"
        )
    weights = over * np.sqrt(cloud.weights * planes.weights)
    return _Matches(points_m, planes.normals, planes.residual_m, weights)


def _cutoff_m(matches: _Matches, surface: DepthSurface, wide: float = 1.0) -> float:
    """Distance from which Tukey's weight is 0."""
    used = matches.weights > 0
    spread = 1.4826 * weighted_quantile(
        np.abs(matches.residual_m[used]), matches.weights[used], 0.5
    )
    # At least a fraction of a pixel, or exact data would have no inliers but the exact ones.
    return TUKEY_CUTOFF * max(spread, 0.05 * wide * surface.pixel_m)


def _tukey(matches: _Matches, cutoff_m: float) -> np.ndarray:
    inside = 1.0 - (matches.residual_m / cutoff_m) ** 2
    return np.maximum(inside, 0.0) ** 2


def _normal_equations(
    surface: DepthSurface, matches: _Matches, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """J'WJ and J'Wr over the sum of the weights, with J by a twist scaled to metres."""
    jacobian = _scaled_jacobian(surface, matches.points_m, matches.normals)
    weighted = jacobian * (weights / weights.sum())[:, None]
    return weighted.T @ jacobian, weighted.T @ matches.residual_m


def _scaled_jacobian(
    surface: DepthSurface, points_m: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    return plane_jacobian(points_m, normals, surface.scale.centre_m) / surface.scale.unit


def _shared_information(
    surface: DepthSurface, cloud: DepthSurface, matches: _Matches, transform: np.ndarray
) -> np.ndarray:
    """Normal matrix of the shape that both images share, shape (6, 6), scaled, symmetric.

    One factor has the measured normals, the other the simulated ones. Their noise and speckle are
    independent and cancel on average, whereas they would add up in the square of either.
    """
    weights = matches.weights * _tukey(matches, _cutoff_m(matches, surface))
    normals = cloud.normals @ transform[:3, :3].T
    facing = np.sign((normals * matches.normals).sum(axis=1))
    theirs = _scaled_jacobian(surface, matches.points_m, normals * facing[:, None])
    mine = _scaled_jacobian(surface, matches.points_m, matches.normals)
    product = (mine * (weights / weights.sum())[:, None]).T @ theirs
    return 0.5 * (product + product.T)


def _without_unobservable(
    surface: DepthSurface, cloud: DepthSurface, fit: _IcpFit, max_iterations: int
) -> tuple[_IcpFit, np.ndarray]:
    """Undo unobservable motion; return the fit and the unobservable directions, (6, k)."""
    matches = _matched(surface, cloud, fit.transform, 1.0)
    free = unobservable(_shared_information(surface, cloud, matches, fit.transform))
    if free.shape[1] == 0:
        return fit, free
    start = without_unobservable_motion(fit.transform, free, surface.scale)
    again = _point_to_plane(surface, cloud, start, max_iterations, free)
    constrained = _IcpFit(again.transform, fit.iterations + again.iterations, again.converged)
    # A plate, a sphere and a cylinder have two or more unobservable directions. A single one may be
    # weak only locally: if constraining it increases the distance, it is observable after all.
    # The hundredth of a pixel is for exact depths, whose distance is 0.
    if free.shape[1] == 1:
        allowed_m = (1.0 + CONSTRAINT_TOLERANCE) * _surface_distance(surface, cloud, fit.transform)
        allowed_m = allowed_m + 0.01 * surface.pixel_m
        if _surface_distance(surface, cloud, constrained.transform) > allowed_m:
            return fit, np.zeros((6, 0))
    return constrained, free


def _alignment(
    surface: DepthSurface,
    cloud: DepthSurface,
    fit: _IcpFit,
    free: np.ndarray,
    min_inlier_share: float,
    max_rms_m: float,
) -> Alignment:
    """Assess the quality of a fit; raise if it is insufficient."""
    matches = _matched(surface, cloud, fit.transform, 1.0)
    inlier = (matches.weights > 0) & (np.abs(matches.residual_m) < _cutoff_m(matches, surface))
    share = float(cloud.weights[inlier].sum() / cloud.weights.sum())
    weights = matches.weights * inlier
    square_m2 = float(weights @ matches.residual_m**2 / weights.sum())
    rms_m = float(np.sqrt(square_m2))
    if share < min_inlier_share:
        raise not_aligned(
            f"only {share:.0%} of the simulated amplitude lies on the measured surface, and "
            f"{min_inlier_share:.0%} is the least"
        )
    if rms_m > max_rms_m:
        raise not_aligned(
            f"the two differ in shape: they are {1e3 * rms_m:.1f} mm rms apart where they match "
            f"best, and {1e3 * max_rms_m:.1f} mm is the most"
        )
    information = _shared_information(surface, cloud, matches, fit.transform)
    return Alignment(
        transform=fit.transform,
        rms_m=rms_m,
        inlier_share=share,
        iterations=fit.iterations,
        converged=fit.converged,
        covariance=_covariance(surface, matches, information, square_m2, free),
        degenerate_directions=direction_names(free, surface.scale),
        centre_m=surface.scale.centre_m,
    )


def _covariance(
    surface: DepthSurface,
    matches: _Matches,
    information: np.ndarray,
    square_m2: float,
    free: np.ndarray,
) -> np.ndarray:
    """Sandwich covariance of the weighted least-squares fit, unknown along `free`.

    X^-1 (J' W W J) X^-1 s^2 with the shared information X: the square of the measured normals alone
    would count their noise as shape.
    """
    basis = complement(free)
    weights = matches.weights * _tukey(matches, _cutoff_m(matches, surface))
    jacobian = _scaled_jacobian(surface, matches.points_m, matches.normals)
    weighted = (jacobian @ basis) * (weights / weights.sum())[:, None]
    values, vectors = np.linalg.eigh(basis.T @ information @ basis)
    # The constraint can make the rest a little less observable, but not indefinite.
    inverse = (vectors / np.maximum(values, OBSERVABLE)) @ vectors.T
    scaled = basis @ (inverse @ (weighted.T @ weighted) @ inverse * square_m2) @ basis.T
    scaled = scaled + UNKNOWN_STD_M**2 * free @ free.T
    return scaled / np.outer(surface.scale.unit, surface.scale.unit)
