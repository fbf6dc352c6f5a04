"""Fit of a posed hand to a measured image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.certainty import certainty, joints_at
from calibration.hand_fit.descent import FINE, Fitted, HandFitter, fitted_parameters
from calibration.hand_fit.hand_model import HandModel, ParametricHand, RiggedHand
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.placing import placed
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.result import Basin, HandFit
from calibration.hand_fit.starts import PoseLike, Start, starts_of
from calibration.registration.mesh_fit import POWER_FLOOR, initial_log_brightness
from calibration.registration.mesh_pose import depth_for_mesh
from calibration.registration.radar import Radar
from clradar.backproject import backproject
from clradar.errors import CompareError
from clradar.hand import HandShape
from clradar.hand.mesh import DEFAULT_EDGE_LENGTH_M
from clradar.hand.shape import AVERAGE
from clradar.imaging.placement import place_grid
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Volume, Waveform, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device
from clradar.rigs import Rig


def fit_hand(
    measured: Capture | Volume | DepthMap,
    pose: PoseLike | Iterable[PoseLike] = "all",
    *,
    rig: Rig | None = None,
    handedness: str = "right",
    shape: HandShape = AVERAGE,
    fit_shape: bool = False,
    alpha: float | None = None,
    closed_loop: bool = True,
    angle_std_deg: float = 12.0,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    search_deg: float = 45.0,
    seed: int = 0,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> HandFit:
    """Fit joint angles, shape, place, brightness and alpha of a hand to its measurement."""
    seed = checks.whole("fit_hand: seed", seed, 0)
    angle_std_deg = checks.positive("fit_hand: angle_std_deg", angle_std_deg)
    opened = open_device(device)
    if isinstance(measured, Capture):
        array, waveform = array or measured.array, waveform or measured.waveform
        measured = backproject(measured, place_grid(measured, device=opened), device=opened)
    radar = Radar.of("fit_hand", array, waveform)
    depth = depth_for_mesh(measured, None)
    model: HandModel = ParametricHand(handedness, opened) if rig is None else RiggedHand(rig)
    fitter = HandFitter(
        model, depth, radar.aperture, opened, fitted_parameters(fit_shape and model.has_shape)
    )
    tried = []
    for start in starts_of(pose):
        prior_shape = start.shape or shape
        state = _placed(start, prior_shape, fitter, search_deg, opened)
        prior = Prior.about(state, angle_covariance(angle_std_deg))
        found = fitter.descend(state, initial_log_brightness(), prior, seed=seed)
        tried.append(_Tried(start, state, prior, fitter.judged(found, prior, seed=seed + 1000)))
    tried.sort(key=lambda one: one.found.deviance)
    return _result(tried, fitter, alpha, seed)


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A start, the hand placed there, its prior, and the fit that it led to."""

    start: Start
    placed: HandState
    prior: Prior
    found: Fitted


def _placed(
    start: Start, shape: HandShape, fitter: HandFitter, search_deg: float, device: Device
) -> HandState:
    """The start, where it is known to be or else where the rigid search puts it."""
    if start.transform is not None:
        return HandState(start.pose, shape, start.transform)
    found = placed(
        fitter.model, start.pose, shape, fitter.depth, fitter.aperture, search_deg, device
    )
    if not found:
        raise CompareError(
            f"could not fit the hand, because no part of '{start.pose.name}' is visible in any "
            "pose of the search"
        )
    return found[0][0]


def _result(tried: list[_Tried], fitter: HandFitter, alpha: float | None, seed: int) -> HandFit:
    best = tried[0]
    state = best.found.state
    known = certainty(fitter, best.found, best.prior, seed + 1000)
    basins = tuple(
        Basin(
            one.start.pose.name,
            one.found.state.pose,
            one.found.state.transform,
            joints_at(fitter, one.found.state),
            one.found.deviance,
        )
        for one in tried
    )
    return HandFit(
        pose=state.pose,
        shape=state.shape,
        handedness=fitter.model.handedness,
        transform=state.transform,
        scene=_scene(fitter, state, alpha),
        started=_scene(fitter, best.placed, alpha),
        joints_m=joints_at(fitter, state),
        joint_std_m=known.joint_std_m,
        angle_std_rad=known.angle_std_rad,
        untold=known.untold,
        alpha=alpha,
        log_brightness=best.found.log_brightness,
        deviance=best.found.deviance,
        basins=basins,
        start=best.start.pose.name,
        likeness=_likeness(fitter, best.found),
        overlap=None,
        converged=True,
        covariance=known.covariance,
        parameter_names=known.names,
    )


def _scene(fitter: HandFitter, state: HandState, alpha: float | None) -> Scene:
    mesh = fitter.model.mesh(state.pose, state.shape, DEFAULT_EDGE_LENGTH_M)
    scene = Scene.from_mesh(mesh).transformed(state.transform)
    return scene if alpha is None else scene.with_alpha(alpha)


def _likeness(fitter: HandFitter, found: Fitted) -> float:
    """Correlation of rendering and measurement, in decibels."""
    picture = fitter.picture(FINE)
    power, _ = picture.render(found.state, found.log_brightness)
    one, other = (np.log1p(p / POWER_FLOOR).ravel() for p in (picture.power, power))
    return float(np.corrcoef(one, other)[0, 1])
