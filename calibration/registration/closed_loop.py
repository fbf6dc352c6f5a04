"""Close the loop: simulate the mesh where it was found, and correct the place by what that shows.

Let F be where the mesh fits the measurement, and G where it fits its own simulation at T. What the
picture of the mesh does not know (interference, the curvature of glints) shifts both alike, so T is
corrected to (G T^-1)^-1 F. Corrections of several rounds, each with its own seed, are averaged:
their speckle is independent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.alignment import Alignment
from calibration.registration.alpha_cue import ALPHA_STARTS, ALPHA_TOLERANCE, look_of, next_alpha
from calibration.registration.locate import COVARIANCE_RATIO, Located, depth_for_mesh, fine_image
from calibration.registration.mesh_fit import MeshFit, first_brightness, fit_mesh
from calibration.registration.mesh_rendering import Aperture
from calibration.registration.rigid_motion import moved, orthonormal
from calibration.registration.surface import failure
from clradar.backproject import backproject
from clradar.compare import depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Volume, VoxelGrid, Waveform
from clradar.opencl import Device
from clradar.overlap import overlap
from clradar.simulation import simulate

TOLERANCE_M = 1e-4
"""Done when a round moves no visible point of the mesh by more than about this."""

MAX_ROUNDS = 12

SAME_ALPHA, SAME_PLACE_M = 0.05, 2e-3
"""A round counts for the correction as a Gaussian of these widths, from where the last one was."""

REGISTERED_RATIO = 0.6
"""As `locate.COVARIANCE_RATIO`, after the correction (docs/calibration.md)."""

MIN_OVERLAP = 0.5
"""Of the last simulation with the measurement: less is another object (docs/calibration.md)."""

LARGEST_CORRECTION_M = 10e-3
"""A simulation that is found this far from where it was put says that the fit is none."""

_FIT_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    transform : ndarray, shape (4, 4)
        Where the mesh was simulated.
    alpha : float or None
        With which alpha, where it was to be found.
    moved_m : float, metres
        How far the round moved the mesh: of its middle, or of points one radius off by the turn,
        whichever is more.
    """

    transform: np.ndarray
    alpha: float | None
    moved_m: float


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """How the loop simulates and when it ends; the fields are arguments of `register`."""

    array: AntennaArray
    waveform: Waveform
    grid: VoxelGrid
    fit_alpha: bool
    samples_per_mm2: float | None
    rays_per_sample: int | None
    seed: int
    dynamic_range_db: float | None
    tolerance_m: float
    max_rounds: int


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """The corrected alignment, and the last simulation, which was made at its transform."""

    alignment: Alignment
    scene: Scene
    capture: Capture
    volume: Volume
    rounds: tuple[Round, ...]


Callback = Callable[[Round], None]
"""Called with every `Round`."""


def close_loop(
    measured: DepthMap,
    mesh: Scene,
    located: Located,
    settings: LoopSettings,
    device: Device,
    callback: Callback | None = None,
) -> ClosedLoop:
    """Correct where `mesh` was `located` until a round moves it by less than the tolerance.

    `measured` is what it was located on, on the pixels of the grid.

    Raises
    ------
    CompareError
        No ray of a simulation reaches a receiver, a simulation does not look like the mesh, or the
        last one does not look like the measurement.
    """
    s = settings
    aperture = Aperture(s.array, float(np.mean(s.waveform.frequencies_hz)))
    fitted, start_m = located.fit, located.fit.centre_m
    radius_m = _radius_m(mesh, fitted)
    transform = fitted.transform
    corrections: list[np.ndarray] = []
    places_m: list[np.ndarray] = []
    alphas: list[float] = []
    looks: list[np.ndarray] = []
    rounds: list[Round] = []
    starts = list(ALPHA_STARTS) if s.fit_alpha else []
    converged = False
    for number in range(s.max_rounds):
        alpha, fixed = None, True
        if s.fit_alpha:
            fixed = not starts
            alpha = starts.pop(0) if starts else next_alpha(alphas, looks, located.look)
        scene = mesh.transformed(transform)
        if alpha is not None:
            scene = scene.with_alpha(alpha)
        try:
            capture, volume = _simulated(scene, s, s.seed + number, device)
            found, look = _found(
                volume, mesh, transform, located, s.dynamic_range_db, aperture, device
            )
            correction = _small(found.transform, transform, start_m)
            _check_correction(correction)
        except CompareError:
            if starts:  # another alpha may show more of the mesh
                continue
            raise
        corrections.append(correction)
        if alpha is not None:
            alphas.append(alpha)
            looks.append(look)
        places_m.append(_small(transform, fitted.transform, start_m)[3:])
        weights = _weights(alphas, places_m)
        following = _corrected(
            fitted.transform, weights @ np.array(corrections) / weights.sum(), start_m
        )
        step = _small(following, transform, start_m)
        moved_m = float(max(np.linalg.norm(step[3:]), radius_m * np.linalg.norm(step[:3])))
        rounds.append(Round(transform, alpha, moved_m))
        if callback is not None:
            callback(rounds[-1])
        last = transform
        transform = following
        if alpha is not None and fixed:
            fixed = abs(next_alpha(alphas, looks, located.look) - alpha) < ALPHA_TOLERANCE
        converged = moved_m < s.tolerance_m and fixed
        if converged:
            break
    share = _overlap(measured, volume)
    if share < MIN_OVERLAP:
        raise failure(
            f"the mesh, simulated in its place, overlaps with the measurement by {share:.2f}, and "
            f"{MIN_OVERLAP:.2f} is the least: it is another object, or stands elsewhere"
        )
    alignment = replace(
        located.alignment,
        transform=last,
        overlap=share,
        covariance=_narrowed(located),
        converged=converged,
        iterations=len(rounds),
    )
    return ClosedLoop(alignment, scene, capture, volume, tuple(rounds))


def _simulated(
    scene: Scene, settings: LoopSettings, seed: int, device: Device
) -> tuple[Capture, Volume]:
    capture = simulate(
        scene,
        settings.array,
        settings.waveform,
        samples_per_mm2=settings.samples_per_mm2,
        rays_per_sample=settings.rays_per_sample,
        seed=seed,
        device=device,
    )
    if capture.meta["rays"]["paths"] == 0:
        raise failure("no ray from the mesh at the place found reaches a receiver")
    return capture, backproject(capture, settings.grid, device=device)


def _check_correction(correction: np.ndarray) -> None:
    shift_m = float(np.linalg.norm(correction[3:]))
    if shift_m > LARGEST_CORRECTION_M:
        raise failure(
            "the simulation at the place found does not look like the mesh: it fits "
            f"{1e3 * shift_m:.1f} mm off"
        )


def _overlap(measured: DepthMap, simulated: Volume) -> float:
    """Return the headline metric of the two, at what both depth maps reach down to."""
    range_db = min(DYNAMIC_RANGE_DB, measured.dynamic_range_db)
    one, other = (depth_map_of(image, range_db, "image") for image in (measured, simulated))
    return overlap(one, other)


def _radius_m(mesh: Scene, fit: MeshFit) -> float:
    vertices_m = moved(fit.transform, mesh.vertices_m[np.unique(mesh.faces)])
    return float(np.median(np.linalg.norm(vertices_m - fit.centre_m, axis=1)))


def _found(
    volume: Volume,
    mesh: Scene,
    transform: np.ndarray,
    located: Located,
    dynamic_range_db: float | None,
    aperture: Aperture,
    device: Device,
) -> tuple[MeshFit, np.ndarray]:
    """Return where the mesh fits its own simulation, from where it was put, and its look."""
    depth = depth_for_mesh(volume, dynamic_range_db)
    held = located.held if located.held.shape[1] else None
    with fine_image(mesh, depth, aperture, device) as image:
        fit = fit_mesh(image, transform, first_brightness(), _FIT_STEPS, held)
        return fit, look_of(image, fit)


def _small(there: np.ndarray, here: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Return the motion from `here` to `there` as rotation vector and shift of `at_m`, (6,)."""
    motion = there @ np.linalg.inv(here)
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([turn, moved(motion, at_m[None])[0] - at_m])


def _corrected(fitted: np.ndarray, correction: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Return `fitted` moved against a motion as `_small` gives it."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(correction[:3]).as_matrix()
    motion[:3, 3] = at_m + correction[3:] - motion[:3, :3] @ at_m
    return orthonormal(np.linalg.inv(motion) @ fitted)


def _weights(alphas: list[float], places_m: list[np.ndarray]) -> np.ndarray:
    """Return how much each round says about the bias of the last one."""
    away = np.linalg.norm(np.array(places_m) - places_m[-1], axis=1) / SAME_PLACE_M
    if alphas:
        away = np.hypot(away, (np.array(alphas) - alphas[-1]) / SAME_ALPHA)
    return np.exp(-0.5 * away**2)


def _narrowed(located: Located) -> np.ndarray:
    """Return the covariance after the correction; what is held stays unknown."""
    covariance = located.alignment.covariance
    if located.held.shape[1]:
        return covariance
    return covariance * (REGISTERED_RATIO / COVARIANCE_RATIO) ** 2
