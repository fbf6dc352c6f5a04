"""Bias and alpha of a fitted hand from simulations of it.

As `calibration.registration.closed_loop`, for all that is fitted of a hand. Let F be the state that
fits the measurement, and G the one that fits a simulation of the state S. Effects that the
rendering does not model (interference, the curvature of glints) bias both alike, so the next S is F
less a share of the mean G - S. G is fitted with a prior about S: what an image does not tell stays
there, and is not corrected.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.hand_fit.certainty import joints_at
from calibration.hand_fit.descent import FINE, Fitted, HandFitter, Missed
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY, SHAPE, HandRendering, stepped
from calibration.hand_fit.hand_shape_vector import vector_of
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.meshed_anew import settled
from calibration.hand_fit.prior import Prior
from calibration.hand_fit.recognition import not_fitted
from calibration.registration.alpha_cue import ALPHA_TOLERANCE, brightness_features, next_alpha
from calibration.registration.mesh_rendering import KNOTS_RAD, decimated
from calibration.registration.radar import Radar
from calibration.registration.rigid_motion import moved
from clradar.backproject import backproject
from clradar.compare.images import depth_map_of
from clradar.compare.metrics import overlap
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClradarWarning
from clradar.model import Capture, DepthMap, Scene, Volume, VoxelGrid
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.simulation import simulate
from clradar.tracing.settings import SimulationSettings

MAX_ROUNDS = 4  # the first two try fixed alphas, the others come to rest
CORRECTED_SHARE = 0.5
"""Share of the bias that is corrected: that of one simulation scatters as much as the fit to the
measurement does, and all of it would be added."""

ALPHA_FIRST, ALPHA_LOW, ALPHA_HIGH = 0.3, 0.1, 0.6
"""Simulated first, and next, on the side where the measurement is."""

SIMILAR_ALPHA = 0.15
"""Width of the Gaussian weight of a round's bias, by the distance of its alpha from the next."""

TOLERANCE_M = 5e-4
"""At rest when a round moves the joints by less, root mean square: a third of their error."""

CONVERGED_M = 1e-3  # the same of the last round that there is time for
EDGE_M, VOXEL_M, MARGIN_M = 2.4e-3, 2e-3, 20e-3
"""Of simulations: edges of triangles, voxels, and what is imaged in front of and behind a hand."""

SIMULATION = SimulationSettings(estimator="expected", samples_per_mm2=0.5)
"""Images of hands in their true pose overlap with the measured ones by 0.98 to 0.996, as with
twelve times as many samples of the stochastic estimator, and twice its time."""


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Instrument, alpha of the simulations (None: it is found), first seed, and device."""

    radar: Radar
    alpha: float | None
    seed: int
    device: Device


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """A simulation of a hand, its overlap with the measurement, and the fit to it.

    `features`, of its brightness; `bias`, shape (37,), parameters of the fit less those of the
    state.
    """

    state: HandState
    alpha: float
    scene: Scene
    capture: Capture
    overlap: float
    features: np.ndarray
    bias: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """The `best` round, by its overlap, of all `rounds`; whether the last hardly moved."""

    best: Round
    rounds: tuple[Round, ...]
    converged: bool


def close_loop(
    fitter: HandFitter,
    found: Fitted,
    prior: Prior,
    missed: Missed,
    settings: LoopSettings,
    progress: Progress | None = None,
) -> ClosedLoop:
    """Correct a fit by simulations of it until they rest.

    `missed` are the slopes with which the fit was settled, and with which simulations are fitted.
    `progress` is called with the number of rounds and that of all, which it reaches in any case. No
    ray of a simulation at a receiver is a `CompareError`.
    """
    measured = decimated(fitter.depth, VOXEL_M)
    picture = fitter.picture(FINE)
    picture.draw_surface(found.state, settings.seed)
    centre_m = picture.samples.posed(picture.bones_at(found.state))[0].mean(axis=0)
    wanted = _features(picture, found.state, found.log_brightness)
    alpha = ALPHA_FIRST if settings.alpha is None else settings.alpha
    state, moved_m, rounds = found.state, np.inf, list[Round]()
    for number in range(MAX_ROUNDS):
        seeded = replace(settings, seed=settings.seed + number)
        rounds.append(
            _round(fitter, measured, state, alpha, found, prior, missed, seeded, centre_m)
        )
        if progress is not None:
            progress(number + 1, MAX_ROUNDS)
        if settings.alpha is None:
            alpha = _next_alpha(rounds, wanted)
        following = _corrected(found.state, rounds, alpha, centre_m)
        step_m = joints_at(fitter, following) - joints_at(fitter, state)
        moved_m = float(np.sqrt(np.nanmean((step_m**2).sum(axis=1))))
        state = following
        alpha_rests = abs(alpha - rounds[-1].alpha) < ALPHA_TOLERANCE
        if number > 0 and moved_m < TOLERANCE_M and alpha_rests:
            break
    if progress is not None:
        progress(MAX_ROUNDS, MAX_ROUNDS)
    best = max(rounds, key=lambda one: one.overlap)
    return ClosedLoop(best, tuple(rounds), moved_m < CONVERGED_M)


def likest(fitted: Sequence[tuple[HandFitter, HandState]], settings: LoopSettings) -> int:
    """Index of the hand whose simulation overlaps most with the measurement, the first of several.

    For poses that renderings cannot tell apart: simulations have the phases, too.
    """
    alpha = ALPHA_FIRST if settings.alpha is None else settings.alpha
    overlaps = []
    for fitter, state in fitted:
        measured = decimated(fitter.depth, VOXEL_M)
        *_, depth = _pictured(fitter, measured, state, alpha, settings)
        overlaps.append(shared(measured, depth))
    return int(np.argmax(overlaps))


def _pictured(
    fitter: HandFitter, measured: DepthMap, state: HandState, alpha: float, settings: LoopSettings
) -> tuple[Scene, Capture, DepthMap]:
    """A hand, its simulation, and the depth map of that on the pixels of the measurement."""
    mesh = fitter.model.mesh(state.pose, state.shape, EDGE_M)
    scene = Scene.from_mesh(mesh).transformed(state.transform).with_alpha(alpha)
    capture = _simulated(scene, settings)
    image = image_of(capture, measured, scene, settings.device)
    return scene, capture, depth_map_of(image, measured.dynamic_range_db, "simulation")


def _round(
    fitter: HandFitter,
    measured: DepthMap,
    state: HandState,
    alpha: float,
    found: Fitted,
    prior: Prior,
    missed: Missed,
    settings: LoopSettings,
    centre_m: np.ndarray,
) -> Round:
    scene, capture, depth = _pictured(fitter, measured, state, alpha, settings)
    here = replace(prior, mean_rad=state.angles_rad, mean_shape=vector_of(state.shape))
    own = HandFitter(fitter.model, depth, fitter.aperture, settings.device, fitter.fitted, (FINE,))
    picture = own.picture(FINE)
    picture.draw_surface(state, settings.seed)
    start = replace(
        found, state=state, log_brightness=own.scaled(state, found.log_brightness, FINE)
    )
    refound = settled(own, start, here, missed, settings.seed)
    return Round(
        state=state,
        alpha=alpha,
        scene=scene,
        capture=capture,
        overlap=shared(measured, depth),
        features=_features(picture, refound.state, refound.log_brightness),
        bias=_difference(refound.state, state, centre_m),
    )


def image_of(capture: Capture, measured: Volume | DepthMap, scene: Scene, device: Device) -> Volume:
    """The image of a simulation of `scene` on the grid of a measured volume, or on the pixels of a
    depth map."""
    grid = measured.grid if isinstance(measured, Volume) else _grid(measured, scene)
    return backproject(capture, grid, check_grid=False, device=device)


def shared(measured: DepthMap, simulated: DepthMap) -> float:
    """Overlap of two depth maps on the same pixels, in the dynamic range that both have."""
    range_db = min(DYNAMIC_RANGE_DB, measured.dynamic_range_db, simulated.dynamic_range_db)
    one, other = (depth_map_of(image, range_db, "image") for image in (measured, simulated))
    return overlap(one, other)


def _simulated(scene: Scene, settings: LoopSettings) -> Capture:
    # Of a hand that returns little: it overlaps little, too.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClradarWarning)
        capture = simulate(
            scene,
            settings.radar.array,
            settings.radar.waveform,
            settings=replace(SIMULATION, seed=settings.seed),
            device=settings.device,
        )
    if capture.meta["rays"]["paths"] == 0:
        raise not_fitted("no ray from it, simulated where it was found, reaches a receiver")
    return capture


def _grid(measured: DepthMap, scene: Scene) -> VoxelGrid:
    """The pixels of the measurement, and the depths of the hand."""
    z_m = scene.vertices_m[np.unique(scene.faces), 2]
    first_m, last_m = z_m.min() - MARGIN_M, z_m.max() + MARGIN_M
    axes_m = (measured.x_m, measured.y_m)
    spacing_m = [float(np.ptp(axis_m)) / (len(axis_m) - 1) for axis_m in axes_m]
    counts = [len(axis_m) for axis_m in axes_m]
    return VoxelGrid(
        np.array([measured.x_m[0], measured.y_m[0], first_m]),
        np.array([*spacing_m, VOXEL_M]),
        (counts[0], counts[1], int(np.ceil((last_m - first_m) / VOXEL_M)) + 1),
    )


def _features(picture: HandRendering, state: HandState, log_brightness: np.ndarray) -> np.ndarray:
    silhouette, _ = picture.render(state, np.zeros(len(KNOTS_RAD)))
    return brightness_features(picture, silhouette, log_brightness)


def _next_alpha(rounds: list[Round], wanted: np.ndarray) -> float:
    features = [one.features for one in rounds]
    if len(rounds) == 1:
        # All features rise with alpha.
        return ALPHA_HIGH if wanted.sum() > features[0].sum() else ALPHA_LOW
    return next_alpha([one.alpha for one in rounds], features, wanted)


def _corrected(
    found: HandState, rounds: list[Round], alpha: float, centre_m: np.ndarray
) -> HandState:
    """The fit less a share of the mean bias, of simulations with a similar alpha most."""
    away = np.array([one.alpha - alpha for one in rounds]) / SIMILAR_ALPHA
    weights = np.exp(-0.5 * (away**2 - (away**2).min()))
    bias = weights @ np.array([one.bias for one in rounds]) / weights.sum()
    return stepped(found, -CORRECTED_SHARE * bias, centre_m)


def _difference(there: HandState, here: HandState, centre_m: np.ndarray) -> np.ndarray:
    """Motion about `centre_m`, angles and shape from `here` to `there`, shape (37,)."""
    apart = np.zeros(N_GEOMETRY)
    motion = there.transform @ np.linalg.inv(here.transform)
    apart[:3] = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    apart[3:6] = moved(motion, centre_m[None])[0] - centre_m
    apart[ANGLES] = there.angles_rad - here.angles_rad
    apart[SHAPE] = vector_of(there.shape) - vector_of(here.shape)
    return apart
