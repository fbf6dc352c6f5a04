"""Fit of a posed hand to a measured image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from calibration.hand_fit.basins import JUDGED_SEED, PLACES, basins_from, roughly
from calibration.hand_fit.certainty import (
    Information,
    certainty,
    information_at,
    joints_at,
    leaving_untold,
    with_spread,
)
from calibration.hand_fit.closed_loop import ClosedLoop, LoopSettings, close_loop, image_of, likest
from calibration.hand_fit.descent import FINE, Fitted, HandFitter, Missed, fitted_parameters
from calibration.hand_fit.hand_model import HandModel, ParametricHand, RiggedHand
from calibration.hand_fit.hand_state import HandState, angles_of
from calibration.hand_fit.layers import HandSkin
from calibration.hand_fit.meshed_anew import missed_slopes, settled
from calibration.hand_fit.placing import placed
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.recognition import check_likeness, check_overlap, doubts, said_of_the_hand
from calibration.hand_fit.result import RIVAL_DEVIANCE, Basin, HandFit
from calibration.hand_fit.starts import PoseLike, Start, starts_of
from calibration.registration.mesh_pose import depth_for_mesh, likeness
from calibration.registration.mesh_search import TRIED
from calibration.registration.radar import Radar
from clradar.backproject import backproject
from clradar.errors import CompareError, warn
from clradar.hand import HandShape
from clradar.hand.mesh import DEFAULT_EDGE_LENGTH_M
from clradar.hand.shape import AVERAGE
from clradar.imaging.placement import place_grid
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Volume, Waveform, checks
from clradar.model.progress import Progress, part_of, say_stage
from clradar.opencl import Device, open_device
from clradar.rigs import Rig

ROUGH_COST, SEARCH_COST, LOOP_COST = 0.3, 0.7, 1.0
"""Times of the coarse fit of a start, the search of its digits, and the loop, for the progress."""

SEARCHED = 3  # of several starts so many, after a coarse fit of all, have their digits searched
TRIED_OF_SEVERAL = 2
"""Rotations that are refined of each of several starts, only the best of which is gone on from."""


SIDES = ("right", "left", "either")


def fit_hand(
    measured: Capture | Volume | DepthMap,
    pose: PoseLike | Iterable[PoseLike] = "all",
    *,
    rig: Rig | None = None,
    handedness: str = "right",
    shape: HandShape | None = None,
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
    """Fit joint angles, shape, place, brightness and alpha of a hand to its measurement.

    docs/hand-fit-method.md has the equations and their sources. Every remark of the result is a
    warning.

    Parameters
    ----------
    measured : Capture, Volume or DepthMap
        In the antenna frame, on evenly spaced pixels. A capture is imaged on the grid of
        `clradar.place_grid`.
    pose : str, Path, HandPose, HandFit, or several of them
        Start, and mean of the prior: a name in `clradar.hand.POSES`, "all" letters, a pose file, a
        pose, or an earlier fit (also its folder) with its shape, place and side. Several are fitted
        coarsely, the best three to the end; the others are among the `basins` of the best.
    rig : Rig, optional
        Fit this hand, with its side and shape, instead of that of `clradar.hand`.
    handedness : "right", "left" or "either"
    shape : HandShape, optional
        Where it is known. None: an average adult's, with the spread among adults in the standard
        deviations.
    fit_shape : bool
        Fit the shape, too.
    alpha : float, optional
        Of the simulations. None: estimated in the closed loop.
    closed_loop : bool
        Correct the fit by the errors of fits to simulations of it.
    angle_std_deg : float
        Standard deviation of the prior, of flexion and of the thumb's angles; that of abduction is
        7/12, that of the palm's arch 5/12 of it.
    array, waveform, search_deg
        As for `align_mesh`; array and waveform of a capture are its own.
    seed : int
        Of all that is drawn.

    Returns
    -------
    HandFit

    Raises
    ------
    CompareError
        No hand, the other hand or another pose: docs/hand-fit.md has the limits.

    Examples
    --------
    `examples/tutorials/9_hand_from_capture.py` fits a simulated hand. Where nothing is seen:

    >>> grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.28, 0.32), 4e-3)
    >>> dark = clradar.Volume(np.zeros(grid.counts[::-1]), grid)
    >>> calibration.fit_hand(dark, "F")
    Traceback (most recent call last):
    clradar.errors.CompareError: could not fit the hand, because ...
    """
    seed = checks.whole("fit_hand: seed", seed, 0)
    checks.one_of("fit_hand: handedness", handedness, SIDES)
    angle_std_deg = checks.positive("fit_hand: angle_std_deg", angle_std_deg)
    opened = open_device(device)
    measured, radar = imaged("fit_hand", measured, array, waveform, opened)
    with said_of_the_hand():
        depth = depth_for_mesh(measured, None)

    @cache
    def fitter_of(side: str) -> HandFitter:
        model: HandModel = ParametricHand(side, opened) if rig is None else RiggedHand(rig)
        parameters = fitted_parameters(fit_shape and model.has_shape)
        return HandFitter(model, depth, radar.aperture, opened, parameters)

    tried = []
    starts = [(start, side) for start in starts_of(pose) for side in _sides(start, handedness, rig)]
    costs = (
        ROUGH_COST * len(starts), SEARCH_COST * min(len(starts), SEARCHED), LOOP_COST * closed_loop
    )  # fmt: skip
    rough_share, search_share, _ = np.divide(costs, sum(costs))
    for number, (start, side) in enumerate(starts):
        fitter = fitter_of(side)
        say_stage(progress, _counted(start, number, len(starts)))
        begin, end = (rough_share * (number + k) / len(starts) for k in (0, 1))
        placing = part_of(progress, begin, end)
        tries = (TRIED, PLACES) if len(starts) == 1 else (TRIED_OF_SEVERAL, 1)
        own_shape = start.shape or shape or AVERAGE
        with said_of_the_hand():
            places = _places(start, own_shape, fitter, search_deg, opened, tries[0], placing)
        prior = Prior.about(places[0], angle_covariance(angle_std_deg))
        found = roughly(places, fitter, prior, seed, tries[1])
        tried.append(_Tried(fitter, start, places[0], prior, found))
    tried = _searched(tried, seed, opened, progress, (rough_share, rough_share + search_share))
    settings = LoopSettings(radar, alpha, seed, opened) if closed_loop else None
    tried, missed = _settled(tried, seed, settings)
    best, loop = tried[0], None
    information = information_at(best.fitter, best.found, best.prior, seed + JUDGED_SEED)
    found = leaving_untold(best.fitter, best.found, best.prior, information, seed + JUDGED_SEED)
    check_likeness(_likeness(best.fitter, found))
    if settings is not None:
        say_stage(progress, "simulating")
        looping = part_of(progress, rough_share + search_share, 1.0)
        loop = close_loop(best.fitter, found, best.prior, missed, settings, looping)
        check_overlap(loop.best.overlap, best.start.name)
        found = replace(found, state=loop.best.state)
    best = replace(best, found=found)
    known = best.start.shape is not None or shape is not None
    fit = _result(best, tried[1:], information, loop, alpha, seed, known)
    if loop is not None:
        capture, scene = loop.best.capture, loop.best.scene
        fit = replace(fit, capture=capture, volume=image_of(capture, measured, scene, opened))
    fit = replace(fit, notes=(*fit.notes, *doubts(fit, measured, information.widening)))
    for remark in fit.remarks():
        warn(f"fit_hand: {remark}")
    return fit


def imaged(
    function: str,
    measured: Capture | Volume | DepthMap,
    array: AntennaArray | None,
    waveform: Waveform | None,
    device: Device,
) -> tuple[Volume | DepthMap, Radar]:
    """An image, that of a capture on a grid of its own, and the radar that recorded it."""
    if isinstance(measured, Capture):
        array, waveform = array or measured.array, waveform or measured.waveform
        measured = backproject(measured, place_grid(measured, device=device), device=device)
    return measured, Radar.of(function, array, waveform)


def _sides(start: Start, handedness: str, rig: Rig | None) -> tuple[str, ...]:
    """The hands that a start is fitted as."""
    if rig is not None:
        return (rig.handedness,)
    if start.handedness is not None:
        return (start.handedness,)
    return ("right", "left") if handedness == "either" else (handedness,)


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """The fitter of one hand, a start, the hand placed there, its prior, and what it led to."""

    fitter: HandFitter
    start: Start
    placed: HandState
    prior: Prior
    found: Fitted


def _places(
    start: Start,
    shape: HandShape,
    fitter: HandFitter,
    search_deg: float,
    device: Device,
    tried: int,
    progress: Progress | None,
) -> list[HandState]:
    """The start, where it is known to be or else where the rigid search puts it."""
    if start.transform is not None:
        return [HandState(start.pose, shape, start.transform)]
    found = placed(
        fitter.model, start.pose, shape, fitter.depth, fitter.aperture, search_deg, device,
        progress, tried,
    )  # fmt: skip
    if not found:
        raise CompareError(
            f"could not fit the hand, because no part of '{start.name}' is visible in any "
            "pose of the search"
        )
    return [place for place, _ in found]


def _counted(start: Start, number: int, total: int) -> str:
    return f"'{start.name}'" + (f", {number + 1} of {total}" if total > 1 else "")


def _searched(
    tried: list[_Tried],
    seed: int,
    device: Device,
    progress: Progress | None,
    shares: tuple[float, float],
) -> list[_Tried]:
    """The basins of the best of coarse fits; the progress runs between the shares."""
    searching = part_of(progress, *shares)
    skins: dict[tuple[str, HandShape], HandSkin] = {}
    ended = []
    best = sorted(tried, key=lambda one: one.found.deviance)[:SEARCHED]
    for done, one in enumerate(best):
        say_stage(progress, f"digits of {_counted(one.start, done, len(best))}")
        model, shape = one.fitter.model, one.placed.shape
        key = (model.handedness, shape)
        if key not in skins:
            skins[key] = HandSkin(model, one.start.pose, shape, device)
        basins = basins_from(one.found, one.fitter, one.prior, skins[key], seed)
        ended += [replace(one, found=found) for found in basins]
        if searching is not None:
            searching(done + 1, len(best))
    return ended


def _settled(
    tried: list[_Tried], seed: int, settings: LoopSettings | None
) -> tuple[list[_Tried], Missed]:
    """The basins after the last steps, the one to go on with first, and the slopes near it.

    Rivals are settled with the slopes of the best: they differ in a digit or two, and only steps
    that lower the deviance are taken. Of those that then are, with `settings`, the one whose
    simulation overlaps most comes first. What is no rival keeps its distance.
    """
    best = min(tried, key=lambda one: one.found.deviance)
    missed = missed_slopes(best.fitter, best.found, seed)
    at_rest = settled(best.fitter, best.found, best.prior, missed, seed + JUDGED_SEED)
    gain = best.found.deviance - at_rest.deviance
    ended = []
    for one in tried:
        found = replace(one.found, deviance=one.found.deviance - gain)
        if one is best:
            found = at_rest
        elif found.deviance < at_rest.deviance + RIVAL_DEVIANCE and one.fitter is best.fitter:
            found = settled(one.fitter, one.found, one.prior, missed, seed + JUDGED_SEED)
        ended.append(replace(one, found=found))
    ended.sort(key=lambda one: one.found.deviance)
    most = ended[0].found.deviance + RIVAL_DEVIANCE
    rivals = [one for one in ended if one.found.deviance < most]
    if settings is not None and len(rivals) > 1:
        first = likest([(one.fitter, one.found.state) for one in rivals], settings)
        ended.insert(0, ended.pop(first))
    if ended[0].found is not at_rest:
        missed = missed_slopes(ended[0].fitter, ended[0].found, seed)
    return ended, missed


def _result(
    best: _Tried,
    others: list[_Tried],
    information: Information,
    loop: ClosedLoop | None,
    alpha: float | None,
    seed: int,
    shape_is_known: bool,
) -> HandFit:
    fitter, found = best.fitter, best.found
    state = found.state
    known = certainty(fitter, found, best.prior, seed + JUDGED_SEED, information, shape_is_known)
    alpha = alpha if loop is None else loop.best.alpha
    basins = tuple(
        Basin(
            one.start.name,
            one.found.state.pose,
            one.found.state.transform,
            joints_at(one.fitter, one.found.state),
            one.found.deviance,
            one.fitter.model.handedness,
        )
        for one in (best, *others)
    )
    rivals = [(basin, basin.deviance - found.deviance) for basin in basins[1:]]
    of_joints = with_spread(
        known.joint_covariance_m2, basins[0].joints_m, [(b.joints_m, more) for b, more in rivals]
    )
    of_angles = with_spread(
        known.angle_std_rad[:, None, None] ** 2,
        angles_of(state.pose)[:, None],
        [(angles_of(b.pose)[:, None], more) for b, more in rivals],
    )
    return HandFit(
        pose=state.pose,
        shape=state.shape if fitter.model.has_shape else None,
        handedness=fitter.model.handedness,
        transform=state.transform,
        scene=_scene(fitter, state, alpha),
        started=_scene(fitter, best.placed, alpha),
        joints_m=basins[0].joints_m,
        joint_covariance_m2=of_joints,
        angle_std_rad=np.sqrt(of_angles[:, 0, 0]),
        untold=known.untold,
        alpha=alpha,
        log_brightness=found.log_brightness,
        deviance=found.deviance,
        basins=basins,
        start=best.start.name,
        likeness=_likeness(fitter, found),
        overlap=None if loop is None else loop.best.overlap,
        converged=loop is None or loop.converged,
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
    return likeness(picture.power, power)
