"""Bias correction by closed-loop simulation in the estimated pose.

Let F be the pose that fits the measurement, and G the pose that fits the mesh's own simulation at
T. Effects that the rendering does not model (interference, the curvature of glints) bias both
alike, so T is corrected to (G T^-1)^-1 F. The corrections of several rounds with different seeds
are averaged: their speckle is independent.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.alignment import Alignment
from calibration.registration.alpha_cue import (
    ALPHA_STARTS,
    ALPHA_TOLERANCE,
    next_alpha,
    pose_invariant_features,
)
from calibration.registration.beyond_noise import ResidualImage, beyond_noise
from calibration.registration.depth_surface import not_aligned
from calibration.registration.mesh_fit import fit_mesh, initial_log_brightness
from calibration.registration.mesh_pose import (
    COVARIANCE_RATIO,
    Located,
    depth_for_mesh,
    fine_rendering,
)
from calibration.registration.radar import Radar
from calibration.registration.rigid_motion import moved, orthonormal
from clradar.backproject import backproject
from clradar.compare.images import depth_map_of
from clradar.compare.metrics import overlap
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClradarWarning, CompareError
from clradar.model import Capture, DepthMap, Scene, Volume, VoxelGrid
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.simulation import simulate
from clradar.tracing.settings import SimulationSettings

TOLERANCE_M = 1e-4
"""Converged when a round moves no visible point of the mesh by more than about this."""

MAX_ROUNDS = 12

SEARCH_SHARE = 0.2
"""Share of the search for the first pose in the time of all, for the progress bar."""

SAME_ALPHA, SAME_PLACE_M = 0.05, 2e-3
"""Widths of the Gaussian weight of a round's correction, by its distance from the last round."""

REGISTERED_RATIO = 0.6
"""As `locate.COVARIANCE_RATIO`, after the correction (docs/registration-method.md)."""

MIN_OVERLAP = 0.5
"""Smallest overlap of the last simulation with the measurement (docs/registration-method.md)."""

LARGEST_CORRECTION_M = 10e-3  # largest bias: a larger one shows that the fit is invalid
_FIT_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round of simulation and correction.

    Attributes
    ----------
    transform : ndarray, shape (4, 4)
        Pose of the simulation.
    alpha : float or None
        Of the simulation, if it is estimated.
    moved_m : float
        Motion of the mesh: shift of its centre, or rotation times its radius if that is larger.
    """

    transform: np.ndarray
    alpha: float | None
    moved_m: float


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Simulation and termination of the loop; as the arguments of `register`."""

    radar: Radar
    grid: VoxelGrid
    fit_alpha: bool
    simulation: SimulationSettings
    dynamic_range_db: float | None
    tolerance_m: float
    max_rounds: int


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A registered mesh and its simulation.

    Attributes
    ----------
    alignment : Alignment
    scene : Scene
        The mesh in that pose, with the alpha of the last simulation.
    capture, volume : Capture and Volume
        The last simulation, on the grid of the measured volume.
    rounds : tuple of Round
    converged : bool
        Whether the last round moved the mesh by less than the tolerance.
    """

    alignment: Alignment
    scene: Scene
    capture: Capture
    volume: Volume
    rounds: tuple[Round, ...]
    converged: bool


Callback = Callable[[Round], None]
"""Called with every `Round`."""


@dataclass(slots=True)
class _History:
    """Corrections, alphas, features, relative poses and residuals of the rounds that count."""

    corrections: list[np.ndarray] = field(default_factory=list)
    residuals: list[ResidualImage] = field(default_factory=list)
    alphas: list[float] = field(default_factory=list)
    features: list[np.ndarray] = field(default_factory=list)
    places_m: list[np.ndarray] = field(default_factory=list)

    def add(
        self,
        correction: np.ndarray,
        place_m: np.ndarray,
        alpha: float | None,
        features: np.ndarray,
        residuals: ResidualImage,
    ) -> None:
        self.corrections.append(correction)
        self.places_m.append(place_m)
        self.residuals.append(residuals)
        if alpha is not None:
            self.alphas.append(alpha)
            self.features.append(features)

    def next_alpha(self, wanted: np.ndarray) -> float:
        return next_alpha(self.alphas, self.features, wanted)

    def weights(self) -> np.ndarray:
        """Similarity of alpha and place to the last round's, shape (n,), at most 1."""
        away = np.linalg.norm(np.array(self.places_m) - self.places_m[-1], axis=1) / SAME_PLACE_M
        if self.alphas:
            away = np.hypot(away, (np.array(self.alphas) - self.alphas[-1]) / SAME_ALPHA)
        return np.exp(-0.5 * away**2)

    def correction(self) -> np.ndarray:
        """Mean correction by these weights."""
        weights = self.weights()
        return weights @ np.array(self.corrections) / weights.sum()


def close_loop(
    measured: DepthMap,
    mesh: Scene,
    located: Located,
    settings: LoopSettings,
    device: Device,
    callback: Callback | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Correct the `located` pose of `mesh` until a round moves it by less than the tolerance.

    `measured` is the depth map of `located`, on the pixels of the grid. `progress` is called with
    the number of rounds and that of all, which it reaches when the loop has converged earlier, too.
    A `CompareError`: no ray of a simulation reaches a receiver, a simulation does not look like the
    mesh, or the last one does not look like the measurement.
    """
    fitted, centre_m = located.fit.transform, located.fit.centre_m
    radius_m = _radius_m(mesh, located)
    history, rounds = _History(), list[Round]()
    starts = list(ALPHA_STARTS) if settings.fit_alpha else []
    transform, converged = fitted, False
    for number in range(settings.max_rounds):
        alpha, scene = None, mesh.transformed(transform)
        alpha_settled = not starts
        if settings.fit_alpha:
            alpha = starts.pop(0) if starts else history.next_alpha(located.features)
            scene = scene.with_alpha(alpha)
        try:
            capture, volume = _simulated(scene, settings, number, device)
            found, features, residuals = _fitted_to_simulation(
                volume, mesh, transform, located, settings, device
            )
            correction = _relative_motion(found, transform, centre_m)
            _check_correction(correction)
        except CompareError:
            # More of the mesh may be visible at another alpha.
            if starts and number + 1 < settings.max_rounds:
                continue
            raise
        place_m = _relative_motion(transform, fitted, centre_m)[3:]
        history.add(correction, place_m, alpha, features, residuals)
        following = _corrected(fitted, history.correction(), centre_m)
        step = _relative_motion(following, transform, centre_m)
        moved_m = float(max(np.linalg.norm(step[3:]), radius_m * np.linalg.norm(step[:3])))
        rounds.append(Round(transform, alpha, moved_m))
        if callback is not None:
            callback(rounds[-1])
        if progress is not None:
            progress(number + 1, settings.max_rounds)
        transform = following
        if alpha is not None and alpha_settled:
            alpha_settled = abs(history.next_alpha(located.features) - alpha) < ALPHA_TOLERANCE
        # A single simulation says nothing of its scatter.
        converged = number > 0 and moved_m < settings.tolerance_m and alpha_settled
        if converged:
            break
    if progress is not None:
        progress(settings.max_rounds, settings.max_rounds)
    share = _checked_overlap(measured, volume)
    left = beyond_noise(
        located.residuals,
        history.residuals,
        history.weights(),
        history.alphas,
        settings.radar.aperture.centre_m,
    )
    poses = [step.transform for step in rounds[:-1]] + [following]
    alignment = replace(
        located.alignment,
        transform=rounds[-1].transform,
        overlap=share,
        covariance=_stated_covariance(
            located, rounds[-1].transform, poses, left.widening, converged
        ),
        residual_ratio=left.ratio,
        places=left.places,
        converged=converged,
        iterations=len(rounds),
    )
    return Registration(alignment, scene, capture, volume, tuple(rounds), converged)


def _radius_m(mesh: Scene, located: Located) -> float:
    vertices_m = moved(located.fit.transform, mesh.vertices_m[np.unique(mesh.faces)])
    return float(np.median(np.linalg.norm(vertices_m - located.fit.centre_m, axis=1)))


def _simulated(
    scene: Scene, settings: LoopSettings, number: int, device: Device
) -> tuple[Capture, Volume]:
    simulation, radar = settings.simulation, settings.radar
    # A simulation that sees nothing is an error here, or another alpha is tried.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClradarWarning)
        capture = simulate(
            scene,
            radar.array,
            radar.waveform,
            settings=replace(simulation, seed=simulation.seed + number),
            device=device,
        )
    if capture.meta["rays"]["paths"] == 0:
        raise not_aligned("no ray from the mesh in the pose found reaches a receiver")
    return capture, backproject(capture, settings.grid, check_grid=False, device=device)


def _fitted_to_simulation(
    volume: Volume,
    mesh: Scene,
    transform: np.ndarray,
    located: Located,
    settings: LoopSettings,
    device: Device,
) -> tuple[np.ndarray, np.ndarray, ResidualImage]:
    """Pose of the mesh fitted to its own simulation, (4, 4); features and residuals of that."""
    depth = depth_for_mesh(volume, settings.dynamic_range_db)
    constrained = located.constrained if located.constrained.shape[1] else None
    with fine_rendering(mesh, depth, settings.radar.aperture, device) as image:
        fit = fit_mesh(image, transform, initial_log_brightness(), _FIT_STEPS, constrained)
        return fit.transform, pose_invariant_features(image, fit), ResidualImage.of(image, fit)


def _relative_motion(there: np.ndarray, here: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Motion from `here` to `there` as rotation vector and shift of `at_m`, shape (6,)."""
    motion = there @ np.linalg.inv(here)
    rotation = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([rotation, moved(motion, at_m[None])[0] - at_m])


def _check_correction(correction: np.ndarray) -> None:
    shift_m = float(np.linalg.norm(correction[3:]))
    if shift_m > LARGEST_CORRECTION_M:
        raise not_aligned(
            "the simulation in the pose found disagrees with the mesh: it fits "
            f"{1e3 * shift_m:.1f} mm off"
        )


def _corrected(fitted: np.ndarray, correction: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """`fitted` moved by the inverse of a motion in the form of `_relative_motion`."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(correction[:3]).as_matrix()
    motion[:3, 3] = at_m + correction[3:] - motion[:3, :3] @ at_m
    return orthonormal(np.linalg.inv(motion) @ fitted)


def _checked_overlap(measured: DepthMap, simulated: Volume) -> float:
    """Overlap of measurement and simulation, in the dynamic range that both have."""
    range_db = min(DYNAMIC_RANGE_DB, measured.dynamic_range_db)
    one, other = (depth_map_of(image, range_db, "image") for image in (measured, simulated))
    share = overlap(one, other)
    if share < MIN_OVERLAP:
        raise not_aligned(
            f"the mesh, simulated in the pose found, overlaps with the measurement by {share:.2f}, "
            f"and {MIN_OVERLAP:.2f} is the least: it is another object, or stands elsewhere"
        )
    return share


def _stated_covariance(
    located: Located,
    transform: np.ndarray,
    others: list[np.ndarray],
    widening: float,
    converged: bool,
) -> np.ndarray:
    """Covariance after the correction; unobservable directions stay unknown.

    Widened by the residuals relative to the noise (Birge's ratio, docs/registration-method.md).
    Without convergence it is that of the uncorrected fit and the scatter of the `others`, the poses
    before and the next.
    """
    corrected = converged and not located.constrained.shape[1]
    factor = widening * (REGISTERED_RATIO / COVARIANCE_RATIO if corrected else 1.0)
    covariance = located.unknown + factor**2 * (located.alignment.covariance - located.unknown)
    if not converged:
        centre_m = located.alignment.centre_m
        away = np.array([_relative_motion(pose, transform, centre_m) for pose in others])
        covariance = covariance + away.T @ away / len(away)
    return covariance
