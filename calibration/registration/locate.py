"""Find where the picture of a mesh fits a measured one, and judge how well."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.alignment import MESH, UNKNOWN_STD_M, Alignment
from calibration.registration.alpha_cue import look_of
from calibration.registration.mesh_fit import (
    FLOOR,
    MeshFit,
    first_brightness,
    fit_mesh,
    misfit,
    shared_information,
)
from calibration.registration.mesh_rendering import Aperture, MeshImage, Picture
from calibration.registration.mesh_search import COARSE_SAMPLES_PER_MM2, COARSE_STEP_M, search
from calibration.registration.observability import (
    Lever,
    came_from,
    complement,
    named,
    without_free_motion,
)
from calibration.registration.rigid_motion import moved
from calibration.registration.surface import failure, measured_depth_map
from clradar.model import AntennaArray, DepthMap, Scene, Volume, checks
from clradar.opencl import Device, open_device
from clradar.tracing.visible_surface import VisibleSurface

DEEPEST_DB = 20.0
"""Depth points are taken down to here where the caller does not say."""

FINE_STEP_M = 2e-3
"""Pixels of the fit: half a resolution cell."""

FINE_SAMPLES_PER_MM2 = 1.0
MOST_SAMPLES = 200_000

COVARIANCE_RATIO = 1.8
"""Errors that were seen over the standard deviations that the information promises: the picture
knows neither interference nor the curvature of a glint (docs/calibration.md)."""

UNSEEN_STD_M = 5e-3
"""A direction whose standard deviation is larger, at the object's radius, counts as not seen: it
would be found to no better than the resolution cell."""

LARGE_RATIO, SMALL_RATIO = 8.0, 20.0
"""A mesh so many times larger or smaller than what is measured has the wrong unit. A specular hand
shows a quarter of its length; of a small object with sidelobes all over the image more is seen than
there is."""

INLIER_STD = 3.0

MIN_LIKENESS = 0.6
"""Pictures that correlate by less are of different objects (docs/calibration.md)."""

_FINE_STARTS = 3
_SAME_PLACE_M, _SAME_TURN_RAD = 2e-3, 0.04

Progress = Callable[[int, int], None]
"""Called with (done, total) steps of the search."""


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """An alignment, the fit that it rests on, the twists that were held, shape (6, k), and what
    `look_of` says of the measurement."""

    alignment: Alignment
    fit: MeshFit
    held: np.ndarray
    look: np.ndarray


def locate(
    depth: DepthMap,
    mesh: Scene,
    *,
    array: AntennaArray,
    centre_frequency_hz: float,
    search_deg: float,
    min_inlier_share: float,
    max_iterations: int,
    device: Device | str | None,
    progress: Progress | None,
) -> Located:
    """Return where the mesh fits, biased where it is specular; the arguments are `align_mesh`'s."""
    checks.instance("align_mesh: mesh", mesh, Scene)
    search_deg = checks.positive("align_mesh: search_deg", search_deg)
    if search_deg > 180:
        checks.fail("align_mesh: search_deg", "an angle in (0, 180]", repr(search_deg))
    min_inlier_share = checks.positive("align_mesh: min_inlier_share", min_inlier_share)
    if min_inlier_share > 1:
        checks.fail("align_mesh: min_inlier_share", "a share in (0, 1]", repr(min_inlier_share))
    max_iterations = checks.whole("align_mesh: max_iterations", max_iterations, 1)
    aperture = Aperture(array, centre_frequency_hz)
    check_size(mesh, depth)
    opened = open_device(device)
    picture = Picture.of(depth, COARSE_STEP_M, aperture.centre_m)
    density = density_of(mesh, COARSE_SAMPLES_PER_MM2)
    with VisibleSurface(mesh, density, _reach_m(mesh), opened) as surface:
        starts = _distinct(search(surface, picture, aperture, search_deg, progress))
    with fine_image(mesh, depth, aperture, opened) as image:
        fits = [
            fit_mesh(image, start.transform, first_brightness(), max_iterations) for start in starts
        ]
        if not fits:
            raise failure("no part of the mesh is in sight wherever it is put")
        best = min(fits, key=lambda fit: fit.loss)
        located = judged(image, best, max_iterations, min_inlier_share)
    return replace(located, alignment=replace(located.alignment, searched_deg=search_deg))


def depth_for_mesh(measured: Volume | DepthMap, dynamic_range_db: float | None) -> DepthMap:
    """Return the depth map that a mesh is fitted to, or raise because there is none."""
    if dynamic_range_db is None:
        dynamic_range_db = DEEPEST_DB
        if isinstance(measured, DepthMap):
            dynamic_range_db = min(dynamic_range_db, measured.dynamic_range_db)
    dynamic_range_db = checks.positive("align_mesh: dynamic_range_db", dynamic_range_db)
    depth = measured_depth_map(measured, dynamic_range_db, "measured image")
    for name, axis_m in (("x", depth.x_m), ("y", depth.y_m)):
        steps_m = np.diff(axis_m)
        if len(axis_m) < 3 or np.ptp(steps_m) > 1e-3 * steps_m.mean():
            raise failure(
                f"the measured image has {len(axis_m)} pixels along {name}, and at least three "
                "that are evenly spaced are needed"
            )
    return depth


def check_size(mesh: Scene, depth: DepthMap) -> None:
    """Raise unless mesh and measurement are of one order of magnitude."""
    corners_m = mesh.vertices_m[np.unique(mesh.faces)]
    mesh_m = float(np.ptp(corners_m, axis=0).max())
    measured_m = float(np.ptp(depth.points_m(), axis=0).max())
    if measured_m / SMALL_RATIO <= mesh_m <= measured_m * LARGE_RATIO:
        return
    size = "large" if mesh_m > measured_m else "small"
    raise failure(
        f"the mesh is too {size}: it measures {1e3 * mesh_m:.3g} mm, and what the radar saw "
        f"{1e3 * measured_m:.3g} mm; check the unit in which it was read (--unit, or unit= of "
        "Scene.from_mesh)"
    )


def density_of(mesh: Scene, wanted_per_mm2: float, most_samples: int = MOST_SAMPLES) -> float:
    """Return the density wanted, 1/mm^2, or less where that were more samples than the most."""
    triangles = mesh.triangles_m
    sides = triangles[:, 1:] - triangles[:, :1]
    area_mm2 = 0.5e6 * float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())
    return min(wanted_per_mm2, most_samples / area_mm2) if area_mm2 > 0 else wanted_per_mm2


def _reach_m(mesh: Scene) -> float:
    """Return how far from the mesh's origin the radar may be: 2 m in front of it, and its size."""
    return 2.0 + 2.0 * float(np.linalg.norm(mesh.vertices_m, axis=1).max())


@contextmanager
def fine_image(
    mesh: Scene, depth: DepthMap, aperture: Aperture, device: Device
) -> Iterator[MeshImage]:
    """Yield the mesh's picture on the pixels of the fit, ready on the device."""
    picture = Picture.of(depth, FINE_STEP_M, aperture.centre_m)
    density = density_of(mesh, FINE_SAMPLES_PER_MM2)
    with VisibleSurface(mesh, density, _reach_m(mesh), device) as surface:
        yield MeshImage(surface, picture, aperture)


def _distinct(fits: list[MeshFit]) -> list[MeshFit]:
    """Return the best fits that are at different places, best first."""
    kept: list[MeshFit] = []
    for fit in fits:
        if all(_apart(fit, other) for other in kept):
            kept.append(fit)
    return kept[:_FINE_STARTS]


def _apart(fit: MeshFit, other: MeshFit) -> bool:
    turn = Rotation.from_matrix(fit.transform[:3, :3] @ other.transform[:3, :3].T)
    shift_m = fit.centre_m - moved(
        other.transform, came_from(fit.transform, fit.centre_m)[None]
    ).reshape(3)
    return bool(turn.magnitude() > _SAME_TURN_RAD or np.linalg.norm(shift_m) > _SAME_PLACE_M)


def judged(image: MeshImage, fit: MeshFit, max_iterations: int, min_inlier_share: float) -> Located:
    """Take back what cannot be told, measure how good the rest is, and raise where it is none."""
    lever = _lever(image, fit)
    information = shared_information(image, fit) / np.outer(lever.unit, lever.unit)
    values, vectors = np.linalg.eigh(information)
    free = vectors[:, values < (COVARIANCE_RATIO / UNSEEN_STD_M) ** 2]
    iterations = fit.iterations
    held = free / lever.unit[:, None]
    held = held / np.maximum(np.linalg.norm(held, axis=0), 1e-12)
    if free.shape[1]:
        start = without_free_motion(fit.transform, free, lever)
        fit = fit_mesh(image, start, fit.log_brightness, max_iterations, held)
        iterations += fit.iterations
    rms_m, share, likeness = _quality(image, fit)
    if share < min_inlier_share:
        raise failure(
            f"only {share:.0%} of the measured amplitude lies on the mesh, and "
            f"{min_inlier_share:.0%} is the least"
        )
    if likeness < MIN_LIKENESS:
        raise failure(
            f"the measurement does not look like the mesh: their pictures correlate by "
            f"{likeness:.2f}, and {MIN_LIKENESS:.2f} is the least"
        )
    seen = complement(free)
    values, vectors = np.linalg.eigh(seen.T @ information @ seen)
    inverse = (vectors / np.maximum(values, (COVARIANCE_RATIO / UNSEEN_STD_M) ** 2)) @ vectors.T
    scaled = COVARIANCE_RATIO**2 * seen @ inverse @ seen.T + UNKNOWN_STD_M**2 * free @ free.T
    alignment = Alignment(
        transform=fit.transform,
        rms_m=rms_m,
        inlier_share=share,
        iterations=iterations,
        converged=fit.converged,
        covariance=scaled / np.outer(lever.unit, lever.unit),
        degenerate_directions=named(free, lever),
        centre_m=lever.centre_m,
        moved=MESH,
        likeness=likeness,
    )
    return Located(alignment, fit, held, look_of(image, fit))


def _lever(image: MeshImage, fit: MeshFit) -> Lever:
    distance_m = np.linalg.norm(image.seen_points_m(fit.transform) - fit.centre_m, axis=1)
    return Lever(fit.centre_m, float(np.median(distance_m)))


def _quality(image: MeshImage, fit: MeshFit) -> tuple[float, float, float]:
    """Return how good a fit is.

    The rms of the inliers' ranges, metres, their share of the measured amplitude, and how the two
    pictures correlate in decibels.
    """
    image.look(fit.transform)
    power, range_m = image.of(fit.transform, fit.log_brightness)
    found = misfit(image, power, range_m)
    near = found.measured & (np.abs(found.range_m) < INLIER_STD * found.range_std_m)
    amplitude = np.sqrt(image.power)
    on_mesh = amplitude * found.covered * near
    rms_m = np.sqrt((on_mesh * found.range_m**2).sum() / max(on_mesh.sum(), 1e-12))
    share = on_mesh.sum() / (amplitude * found.measured).sum()
    one, other = (np.log1p(p / FLOOR).ravel() for p in (image.power, power))
    alike = 0.0 if min(np.ptp(one), np.ptp(other)) == 0.0 else np.corrcoef(one, other)[0, 1]
    return float(rms_m), float(share), float(alike)
