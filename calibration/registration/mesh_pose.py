"""Coarse-to-fine pose estimation of a mesh in a measured image, with covariance and checks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.alignment import MESH, UNKNOWN_STD_M, Alignment
from calibration.registration.alpha_cue import pose_invariant_features
from calibration.registration.beyond_noise import ResidualImage
from calibration.registration.depth_surface import checked_depth_map, not_aligned
from calibration.registration.mesh_fit import (
    POWER_FLOOR,
    MeshFit,
    fit_mesh,
    initial_log_brightness,
    residuals,
    shared_information,
)
from calibration.registration.mesh_rendering import Aperture, MeasuredImage, MeshRendering
from calibration.registration.mesh_search import COARSE_SAMPLES_PER_MM2, COARSE_STEP_M, search
from calibration.registration.observability import (
    TwistScale,
    complement,
    direction_names,
    without_unobservable_motion,
)
from calibration.registration.rigid_motion import moved, moved_back
from calibration.registration.search_space import PoseSearch
from clradar.model import DepthMap, Scene, Volume, checks
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

DEEPEST_DB = 20.0  # default dynamic range of the depth points
FINE_STEP_M = 2e-3  # pixels of the fit: half a resolution cell
FINE_SAMPLES_PER_MM2 = 1.0
MOST_SAMPLES = 200_000

COVARIANCE_RATIO = 1.8
"""Errors in simulations relative to the standard deviations of the fit: the rendering has neither
interference nor the curvature of a glint (docs/registration-method.md)."""

UNOBSERVABLE_STD_M = 5e-3
"""A direction whose standard deviation at the object's radius exceeds this, about the resolution
cell, is unobservable."""

LARGE_RATIO, SMALL_RATIO = 8.0, 20.0
"""A mesh so many times larger or smaller than the measured extent has the wrong unit. Of a specular
hand a quarter of its length is visible; sidelobes make a small object appear larger."""

INLIER_STD = 3.0

MIN_LIKENESS = 0.6  # smallest correlation of images of the same object (docs/calibration.md)
_FINE_STARTS = 3
_SAME_PLACE_M, _SAME_ROTATION_RAD = 2e-3, 0.04


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """An alignment, its fit, and what the fit says of the measured image.

    `constrained`, shape (6, k), twists without motion; `unknown`, shape (6, 6), their part of the
    covariance; `features` and `residuals` of the measured image.
    """

    alignment: Alignment
    fit: MeshFit
    constrained: np.ndarray
    unknown: np.ndarray
    features: np.ndarray
    residuals: ResidualImage


def locate(
    depth: DepthMap,
    mesh: Scene,
    aperture: Aperture,
    options: PoseSearch,
    device: Device,
    progress: Progress | None = None,
) -> Located:
    """Estimate the pose, biased where the mesh is specular."""
    checks.instance("align_mesh: mesh", mesh, Scene)
    _check_size(mesh, depth)
    coarse = MeasuredImage.of(depth, COARSE_STEP_M, aperture.centre_m)
    density = density_of(mesh, COARSE_SAMPLES_PER_MM2)
    with VisibleSurface(mesh, density, _reach_m(mesh), device) as surface:
        searching = part_of(progress, 0.0, 0.6)
        starts = _distinct(search(surface, coarse, aperture, options.search_deg, searching))
    with fine_rendering(mesh, depth, aperture, device) as image:
        fits = [
            fit_mesh(image, start.transform, initial_log_brightness(), options.max_iterations)
            for start in starts
        ]
        if not fits:
            raise not_aligned("no part of the mesh is visible in any pose of the search")
        best = min(fits, key=lambda fit: fit.loss)
        located = _assessed(image, best, options)
    if progress is not None:
        progress(1, 1)
    alignment = replace(located.alignment, searched_deg=options.search_deg)
    return replace(located, alignment=alignment)


def depth_for_mesh(measured: Volume | DepthMap, dynamic_range_db: float | None) -> DepthMap:
    """The depth map that a mesh is fitted to; raise if it is unsuitable."""
    if dynamic_range_db is None:
        dynamic_range_db = DEEPEST_DB
        if isinstance(measured, DepthMap):
            dynamic_range_db = min(dynamic_range_db, measured.dynamic_range_db)
    dynamic_range_db = checks.positive("align_mesh: dynamic_range_db", dynamic_range_db)
    depth = checked_depth_map(measured, dynamic_range_db, "measured image")
    for name, axis_m in (("x", depth.x_m), ("y", depth.y_m)):
        steps_m = np.diff(axis_m)
        if len(axis_m) < 3 or np.ptp(steps_m) > 1e-3 * steps_m.mean():
            raise not_aligned(
                f"the measured image has {len(axis_m)} pixels along {name}, and at least three "
                "that are evenly spaced are needed"
            )
    return depth


def _check_size(mesh: Scene, depth: DepthMap) -> None:
    """Raise unless mesh and measurement are of the same order of magnitude."""
    corners_m = mesh.vertices_m[np.unique(mesh.faces)]
    mesh_m = float(np.ptp(corners_m, axis=0).max())
    measured_m = float(np.ptp(depth.points_m(), axis=0).max())
    if measured_m / SMALL_RATIO <= mesh_m <= measured_m * LARGE_RATIO:
        return
    size = "large" if mesh_m > measured_m else "small"
    raise not_aligned(
        f"the mesh is too {size}: it measures {1e3 * mesh_m:.3g} mm, and the measured object "
        f"{1e3 * measured_m:.3g} mm; check the unit in which it was read (--unit, or unit= of "
        "Scene.from_mesh)"
    )


def density_of(mesh: Scene, wanted_per_mm2: float, most_samples: int = MOST_SAMPLES) -> float:
    """The requested density of samples, 1/mm^2, reduced to at most `most_samples` on the mesh."""
    triangles = mesh.triangles_m
    sides = triangles[:, 1:] - triangles[:, :1]
    area_mm2 = 0.5e6 * float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())
    return min(wanted_per_mm2, most_samples / area_mm2) if area_mm2 > 0 else wanted_per_mm2


def _reach_m(mesh: Scene) -> float:
    """Largest distance of the radar from the mesh's origin: 2 m in front of it, and its size."""
    return 2.0 + 2.0 * float(np.linalg.norm(mesh.vertices_m, axis=1).max())


@contextmanager
def fine_rendering(
    mesh: Scene, depth: DepthMap, aperture: Aperture, device: Device
) -> Iterator[MeshRendering]:
    """Yield the renderer on the pixels of the fit, with its samples on the device."""
    measured = MeasuredImage.of(depth, FINE_STEP_M, aperture.centre_m)
    density = density_of(mesh, FINE_SAMPLES_PER_MM2)
    with VisibleSurface(mesh, density, _reach_m(mesh), device) as surface:
        yield MeshRendering(surface, measured, aperture)


def _distinct(fits: list[MeshFit]) -> list[MeshFit]:
    """The best fits in different poses, best first."""
    kept: list[MeshFit] = []
    for fit in fits:
        if all(_differ(fit, other) for other in kept):
            kept.append(fit)
    return kept[:_FINE_STARTS]


def _differ(fit: MeshFit, other: MeshFit) -> bool:
    rotation = Rotation.from_matrix(fit.transform[:3, :3] @ other.transform[:3, :3].T)
    there_m = moved(other.transform, moved_back(fit.transform, fit.centre_m)[None])[0]
    shift_m = np.linalg.norm(fit.centre_m - there_m)
    return bool(rotation.magnitude() > _SAME_ROTATION_RAD or shift_m > _SAME_PLACE_M)


def _assessed(image: MeshRendering, fit: MeshFit, options: PoseSearch) -> Located:
    """Undo unobservable motion and assess the fit; raise if it is insufficient."""
    distance_m = np.linalg.norm(image.visible_points_m(fit.transform) - fit.centre_m, axis=1)
    scale = TwistScale(fit.centre_m, float(np.median(distance_m)))
    information = shared_information(image, fit) / np.outer(scale.unit, scale.unit)
    values, vectors = np.linalg.eigh(information)
    least = (COVARIANCE_RATIO / UNOBSERVABLE_STD_M) ** 2
    free = vectors[:, values < least]
    iterations = fit.iterations
    constrained = free / scale.unit[:, None]
    constrained = constrained / np.maximum(np.linalg.norm(constrained, axis=0), 1e-12)
    if free.shape[1]:
        start = without_unobservable_motion(fit.transform, free, scale)
        fit = fit_mesh(image, start, fit.log_brightness, options.max_iterations, constrained)
        iterations += fit.iterations
    rms_m, share, likeness = _image_quality(image, fit)
    if share < options.min_inlier_share:
        raise not_aligned(
            f"only {share:.0%} of the measured amplitude lies on the mesh, and "
            f"{options.min_inlier_share:.0%} is the least"
        )
    if likeness < MIN_LIKENESS:
        raise not_aligned(
            f"the measurement disagrees with the mesh: its image and the rendering correlate "
            f"by {likeness:.2f}, and {MIN_LIKENESS:.2f} is the least"
        )
    basis = complement(free)
    values, vectors = np.linalg.eigh(basis.T @ information @ basis)
    inverse = (vectors / np.maximum(values, least)) @ vectors.T
    scales = np.outer(scale.unit, scale.unit)
    unknown = UNKNOWN_STD_M**2 * free @ free.T / scales
    alignment = Alignment(
        transform=fit.transform,
        rms_m=rms_m,
        inlier_share=share,
        iterations=iterations,
        converged=fit.converged,
        covariance=COVARIANCE_RATIO**2 * basis @ inverse @ basis.T / scales + unknown,
        degenerate_directions=direction_names(free, scale),
        centre_m=scale.centre_m,
        moved=MESH,
        likeness=likeness,
    )
    features = pose_invariant_features(image, fit)
    return Located(alignment, fit, constrained, unknown, features, ResidualImage.of(image, fit))


def _image_quality(image: MeshRendering, fit: MeshFit) -> tuple[float, float, float]:
    """Range rms of inliers, metres, their fraction by amplitude, correlation in decibels."""
    image.update_visibility(fit.transform)
    power, range_m = image.render(fit.transform, fit.log_brightness)
    found = residuals(image, power, range_m)
    near = found.measured & (np.abs(found.range_m) < INLIER_STD * found.range_std_m)
    amplitude = np.sqrt(image.power)
    on_mesh = amplitude * found.covered * near
    rms_m = np.sqrt((on_mesh * found.range_m**2).sum() / max(on_mesh.sum(), 1e-12))
    share = on_mesh.sum() / (amplitude * found.measured).sum()
    return float(rms_m), float(share), likeness(image.power, power)


def likeness(power: np.ndarray, other_power: np.ndarray) -> float:
    """Correlation of two images in decibels; 0 where one is constant."""
    one, other = (np.log1p(p / POWER_FLOOR).ravel() for p in (power, other_power))
    return 0.0 if min(np.ptp(one), np.ptp(other)) == 0.0 else float(np.corrcoef(one, other)[0, 1])
