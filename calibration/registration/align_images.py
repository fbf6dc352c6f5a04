"""The rigid motion that brings a simulated depth map onto a measured one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.alignment import UNKNOWN_STD_M, Alignment
from calibration.registration.observability import (
    OBSERVABLE,
    complement,
    named,
    unobservable,
    without_free_motion,
)
from calibration.registration.rigid_motion import (
    exp_twist,
    kabsch,
    moved,
    orthonormal,
    plane_jacobian,
    rotation_about,
)
from calibration.registration.starting_rotations import start_rotations
from calibration.registration.surface import (
    MIN_POINTS,
    Surface,
    failure,
    planes_under,
    weighted_quantile,
)
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks

TUKEY_CUTOFF = 4.685
"""Of Tukey's biweight in standard deviations: 95 % efficient on Gaussian residuals."""

TRIMMED_SHARE = 0.7
"""What the coarse start looks at: the nearest 70 %, so that a third may be missing."""

HELD_TOLERANCE = 0.1
"""Holding a single weak direction may leave the two this share farther apart, no more."""

STEP_TOLERANCE = 1e-6
"""Converged when a step turns less than this (radians) and shifts less than this (metres)."""

_COARSE_STEPS = 15  # point to point, for each start
_FINE_STARTS = 4  # that go on to point to plane
_THIN_STEPS = 30  # point to plane, for each start, on that many points
_SCALE_STEPS = 20  # during which Tukey's cutoff follows the residuals


def align(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.3,
    max_rms_m: float = 3e-3,
    max_iterations: int = 100,
) -> Alignment:
    """Find the rigid motion that brings the simulated depth map onto the measured one.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
        Each on its own pixels; nothing is resampled.
    dynamic_range_db : float, decibel
        Depth points are the pixels within this of their own image's maximum.
    search_deg : float, degrees, in (0, 180]
        The coarse start tries rotations about boresight up to this angle, together with tilts up
        to 30 degrees. The result may turn further.
    min_inlier_share : float, in (0, 1]
        Less of the simulated amplitude than this on the measured surface is a failure.
    max_rms_m : float, metres
        A larger residual of the inliers is a failure.
    max_iterations : int
        Point-to-plane steps before it stops unconverged.

    Returns
    -------
    Alignment

    Raises
    ------
    CompareError
        "could not align, because …": one of them is no image, is empty, or has too few depth
        points; the two have no part in common, or too small a part; or they differ in shape.
    ModelError
        An option is out of its range.

    Notes
    -----
    A coarse search over starts, refined by trimmed point-to-point steps, then iterative closest
    point from the simulated points to the planes of the measured surface with Tukey's weights.
    `docs/calibration.md` has the equations. The result depends on the arguments alone.

    References
    ----------
    Y. Chen, G. Medioni, "Object modelling by registration of multiple range images", Image and
    Vision Computing 10(3), 1992, doi 10.1016/0262-8856(92)90066-C.

    P. J. Besl, N. D. McKay, "A method for registration of 3-D shapes", IEEE Transactions on
    Pattern Analysis and Machine Intelligence 14(2), 1992, doi 10.1109/34.121791.

    N. Gelfand, L. Ikemoto, S. Rusinkiewicz, M. Levoy, "Geometrically stable sampling for the ICP
    algorithm", 3DIM 2003, doi 10.1109/IM.2003.1240258.
    """
    search_deg = checks.positive("align: search_deg", search_deg)
    if search_deg > 180:
        checks.fail("align: search_deg", "an angle in (0, 180]", repr(search_deg))
    dynamic_range_db = checks.positive("align: dynamic_range_db", dynamic_range_db)
    min_inlier_share = checks.positive("align: min_inlier_share", min_inlier_share)
    if min_inlier_share > 1:
        checks.fail("align: min_inlier_share", "a share in (0, 1]", repr(min_inlier_share))
    max_rms_m = checks.positive("align: max_rms_m", max_rms_m)
    max_iterations = checks.whole("align: max_iterations", max_iterations, 1)

    surface = Surface.of(measured, dynamic_range_db, "measured image")
    cloud = Surface.of(simulated, dynamic_range_db, "simulated image")
    fit = _best_fit(surface, cloud, _coarse(surface, cloud, search_deg), max_iterations)
    fit, free = _without_invention(surface, cloud, fit, max_iterations)
    return _judged(surface, cloud, fit, free, min_inlier_share, max_rms_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Where point to plane ended, and how."""

    transform: np.ndarray
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Each simulated point, where it is now, against the nearest measured plane."""

    points_m: np.ndarray
    normals: np.ndarray
    residual_m: np.ndarray
    weights: np.ndarray


def _coarse(surface: Surface, cloud: Surface, search_deg: float) -> list[np.ndarray]:
    """Return the best starts, refined point to point, best first."""
    # Clutter on one side pulls a centroid further than it pulls a median.
    middles = [(cloud.centroid_m, surface.centroid_m), (cloud.centre_m, surface.centre_m)]
    turns = start_rotations(search_deg)
    starts = [np.eye(4)] + [rotation_about(turn, *pair) for pair in middles for turn in turns]
    best = _rank(surface, cloud, starts)[: 2 * _FINE_STARTS]
    # As given stays in the race: where the two lie on each other already, centroids can mislead.
    few = [_point_to_point(surface, cloud, starts[i]) for i in dict.fromkeys([0, *best])]
    return [few[i] for i in _rank(surface, cloud, few)[:_FINE_STARTS]]


def _rank(surface: Surface, cloud: Surface, transforms: list[np.ndarray]) -> list[int]:
    score = [_distance(surface, cloud, transform) for transform in transforms]
    return sorted(range(len(score)), key=score.__getitem__)


def _distance(surface: Surface, cloud: Surface, transform: np.ndarray) -> float:
    """Return the trimmed mean distance to the nearest neighbour, both ways, metres."""
    mine, theirs = cloud.some(), surface.some()
    there = surface.tree.query(moved(transform, cloud.points_m[mine]))[0]
    back = cloud.tree.query(moved(np.linalg.inv(transform), surface.points_m[theirs]))[0]
    return 0.5 * (
        _trimmed_mean(there, cloud.weights[mine]) + _trimmed_mean(back, surface.weights[theirs])
    )


def _apart(surface: Surface, cloud: Surface, transform: np.ndarray) -> float:
    """Return the trimmed mean distance of either's points from the other's surface, metres.

    Unlike `_distance` blind to where the pixels lie: within a gap of the nearest point only the
    distance along the normal counts.
    """
    there = _off_surface(surface, moved(transform, cloud.points_m))
    back = _off_surface(cloud, moved(np.linalg.inv(transform), surface.points_m))
    return 0.5 * (_trimmed_mean(there, cloud.weights) + _trimmed_mean(back, surface.weights))


def _off_surface(surface: Surface, points_m: np.ndarray) -> np.ndarray:
    planes = planes_under(surface, points_m)
    return np.hypot(planes.residual_m, np.maximum(planes.aside_m - planes.gap_m, 0.0))


def _trimmed_mean(values: np.ndarray, weights: np.ndarray) -> float:
    kept = values <= weighted_quantile(values, weights, TRIMMED_SHARE)
    return float(weights[kept] @ values[kept] / weights[kept].sum())


def _point_to_point(surface: Surface, cloud: Surface, transform: np.ndarray) -> np.ndarray:
    """Refine a start by trimmed nearest neighbours, both ways, and Kabsch's fit."""
    mine, theirs = cloud.some(), surface.some()
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


def _fine(
    surface: Surface,
    cloud: Surface,
    transform: np.ndarray,
    max_iterations: int,
    held: np.ndarray | None = None,
) -> _Fit:
    """Iterate point to plane, without motion along `held`: scaled twists, shape (6, k).

    Without `held`, without motion along what the measured surface alone cannot tell.
    """
    converged, iteration, cutoff_m = False, 0, np.inf
    while not converged and iteration < max_iterations:
        # Wide at first, so that a part which does not fit yet still pulls; at last only points over
        # the surface count, and what is off it does not.
        wide = max(1.0, 10.0 * 0.8**iteration)
        matches = _matched(surface, cloud, transform, min(wide, 4.0))
        # Held at last: a median moves in jumps, however small, and the steps would never end.
        if iteration < _SCALE_STEPS:
            cutoff_m = _cutoff_m(matches, surface, wide)
        weights = matches.weights * _tukey(matches, cutoff_m)
        hessian, gradient = _normal_equations(surface, matches, weights)
        seen = complement(unobservable(hessian) if held is None else held)
        step = seen @ np.linalg.solve(seen.T @ hessian @ seen, -seen.T @ gradient)
        step = step / surface.unit
        transform = orthonormal(exp_twist(step, surface.centre_m) @ transform)
        iteration += 1
        small = max(np.linalg.norm(step[:3]), np.linalg.norm(step[3:])) < STEP_TOLERANCE
        converged = bool(small) and wide == 1.0
    return _Fit(transform, iteration, converged)


def _best_fit(
    surface: Surface, cloud: Surface, starts: list[np.ndarray], max_iterations: int
) -> _Fit:
    """Return the fit from the start that gets nearest; raise where every start ends in nothing."""
    thin = cloud.thinned()
    fits, failures = [], []
    for start in starts:
        try:
            fits.append(_fine(surface, thin, start, _THIN_STEPS))
        except CompareError as error:
            failures.append(error)
    if not fits:
        raise failures[0]
    best = min(fits, key=lambda fit: _apart(surface, cloud, fit.transform))
    return _fine(surface, cloud, best.transform, max_iterations)


def _matched(surface: Surface, cloud: Surface, transform: np.ndarray, reach: float) -> _Matches:
    """Match each simulated point with its nearest measured one.

    Points that lie beside the surface by more than `reach` gaps have no weight: their neighbour is
    at a rim, and its plane says nothing about them.
    """
    points_m = moved(transform, cloud.points_m)
    planes = planes_under(surface, points_m)
    over = np.maximum(1.0 - (planes.aside_m / (reach * planes.gap_m)) ** 2, 0.0) ** 2
    if np.count_nonzero(over) < MIN_POINTS:
        raise failure(
            f"the two hardly overlap: {np.count_nonzero(over)} simulated depth points lie over "
            f"the measured surface, and {MIN_POINTS} are the least"
        )
    weights = over * np.sqrt(cloud.weights * planes.weights)
    return _Matches(points_m, planes.normals, planes.residual_m, weights)


def _cutoff_m(matches: _Matches, surface: Surface, wide: float = 1.0) -> float:
    """Return the distance from which Tukey's weight is 0."""
    seen = matches.weights > 0
    spread = 1.4826 * weighted_quantile(
        np.abs(matches.residual_m[seen]), matches.weights[seen], 0.5
    )
    # Not below what the pixels resolve, or exact data would have no inliers but the exact ones.
    return TUKEY_CUTOFF * max(spread, 0.05 * wide * surface.pixel_m)


def _tukey(matches: _Matches, cutoff_m: float) -> np.ndarray:
    inside = 1.0 - (matches.residual_m / cutoff_m) ** 2
    return np.maximum(inside, 0.0) ** 2


def _normal_equations(
    surface: Surface, matches: _Matches, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return J'WJ and J'Wr over the sum of the weights, with J by a twist scaled to metres."""
    jacobian = _scaled_jacobian(surface, matches)
    weighted = jacobian * (weights / weights.sum())[:, None]
    return weighted.T @ jacobian, weighted.T @ matches.residual_m


def _scaled_jacobian(surface: Surface, matches: _Matches) -> np.ndarray:
    return plane_jacobian(matches.points_m, matches.normals, surface.centre_m) / surface.unit


def _shared_shape(surface: Surface, cloud: Surface, transform: np.ndarray) -> np.ndarray:
    """Return the normal matrix that both images agree on, shape (6, 6), scaled, symmetric.

    One factor has the measured normals, the other the simulated ones. What noise and speckle do to
    the two is independent and cancels on average, whereas it adds up in either one's square.
    """
    matches = _matched(surface, cloud, transform, 1.0)
    weights = matches.weights * _tukey(matches, _cutoff_m(matches, surface))
    normals = cloud.normals @ transform[:3, :3].T
    facing = np.sign((normals * matches.normals).sum(axis=1))
    theirs = plane_jacobian(matches.points_m, normals * facing[:, None], surface.centre_m)
    weighted = _scaled_jacobian(surface, matches) * (weights / weights.sum())[:, None]
    product = weighted.T @ (theirs / surface.unit)
    return 0.5 * (product + product.T)


def _without_invention(
    surface: Surface, cloud: Surface, fit: _Fit, max_iterations: int
) -> tuple[_Fit, np.ndarray]:
    """Take back what the images cannot tell; return the fit and those directions, (6, k)."""
    free = unobservable(_shared_shape(surface, cloud, fit.transform))
    if free.shape[1] == 0:
        return fit, free
    start = without_free_motion(fit.transform, free, surface)
    again = _fine(surface, cloud, start, max_iterations, free)
    held = _Fit(again.transform, fit.iterations + again.iterations, again.converged)
    # A plate, a sphere and a cylinder lose two directions or more. A single one may be weak here
    # only, and a large motion along it may leave the surface: then it is told after all.
    # The hundredth of a pixel is for exact depths, which are nothing apart.
    allowed_m = (1.0 + HELD_TOLERANCE) * _apart(surface, cloud, fit.transform)
    allowed_m = allowed_m + 0.01 * surface.pixel_m
    if free.shape[1] == 1 and _apart(surface, cloud, held.transform) > allowed_m:
        return fit, np.zeros((6, 0))
    return held, free


def _judged(
    surface: Surface,
    cloud: Surface,
    fit: _Fit,
    free: np.ndarray,
    min_inlier_share: float,
    max_rms_m: float,
) -> Alignment:
    """Measure how good a fit is, and raise where it is none."""
    matches = _matched(surface, cloud, fit.transform, 1.0)
    inlier = (matches.weights > 0) & (np.abs(matches.residual_m) < _cutoff_m(matches, surface))
    share = float(cloud.weights[inlier].sum() / cloud.weights.sum())
    weights = matches.weights * inlier
    square_m2 = float(weights @ matches.residual_m**2 / weights.sum())
    rms_m = float(np.sqrt(square_m2))
    if share < min_inlier_share:
        raise failure(
            f"only {share:.0%} of the simulated amplitude lies on the measured surface, and "
            f"{min_inlier_share:.0%} is the least"
        )
    if rms_m > max_rms_m:
        raise failure(
            f"the two differ in shape: they are {1e3 * rms_m:.1f} mm rms apart where they match "
            f"best, and {1e3 * max_rms_m:.1f} mm is the most"
        )
    return Alignment(
        transform=fit.transform,
        rms_m=rms_m,
        inlier_share=share,
        iterations=fit.iterations,
        converged=fit.converged,
        covariance=_covariance(
            surface, matches, _shared_shape(surface, cloud, fit.transform), square_m2, free
        ),
        degenerate_directions=named(free, surface),
        centre_m=surface.centre_m,
    )


def _covariance(
    surface: Surface,
    matches: _Matches,
    shared: np.ndarray,
    square_m2: float,
    free: np.ndarray,
) -> np.ndarray:
    """Return the covariance of the weighted least-squares fit, unknown along `free`.

    X^-1 (J' W W J) X^-1 s^2 with the shared shape X for the information: the square of the
    measured normals alone would count their noise as shape.
    """
    seen = complement(free)
    weights = matches.weights * _tukey(matches, _cutoff_m(matches, surface))
    weighted = (_scaled_jacobian(surface, matches) @ seen) * (weights / weights.sum())[:, None]
    values, vectors = np.linalg.eigh(seen.T @ shared @ seen)
    # Holding directions can make the rest a little flatter, never less than nothing.
    inverse = (vectors / np.maximum(values, OBSERVABLE)) @ vectors.T
    scaled = seen @ (inverse @ (weighted.T @ weighted) @ inverse * square_m2) @ seen.T
    scaled = scaled + UNKNOWN_STD_M**2 * free @ free.T
    return scaled / np.outer(surface.unit, surface.unit)
