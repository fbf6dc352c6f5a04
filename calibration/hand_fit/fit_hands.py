"""Fit of a moving hand to the frames of a recording, each from the one before."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.fit_hand import SIDES, fit_hand, imaged
from calibration.hand_fit.following import Follower, Settled
from calibration.hand_fit.frame_fit import FOLLOWED, SEARCHED, FrameFit
from calibration.hand_fit.hand_model import HandModel, ParametricHand, RiggedHand
from calibration.hand_fit.hand_shape_vector import N_SHAPE
from calibration.hand_fit.hand_state import N_ANGLES, HandState
from calibration.hand_fit.result import DIGITS, RIVAL_DEVIANCE, ends_apart_m
from calibration.hand_fit.starts import PoseLike, Start, starts_of
from calibration.hand_fit.track import FRAME_S, Track
from calibration.registration.mesh_pose import depth_for_mesh
from calibration.registration.radar import Radar
from clradar.errors import ClradarWarning, CompareError, MeasurementError
from clradar.hand import HandShape
from clradar.hand.shape import AVERAGE
from clradar.model import AntennaArray, Capture, DepthMap, Volume, Waveform, checks
from clradar.model.progress import Progress
from clradar.model.volume import capture_meta
from clradar.opencl import Device, open_device
from clradar.rigs import Rig

MEMORY = 8  # frames whose median misfit the next one is held against: a second
LOST_RATIO = 1.1
"""A misfit per cell above the median by this is searched. On a synthetic recording it is at most
9 % above while the hand is followed well, and 12 to 20 % where fingers are lost
(docs/hand-movement.md)."""

GONE_RATIO = 1.6
"""A misfit per cell above the median by this, after a search too, is no hand: in synthetic images
that of hands is 0.61 to 0.83, with lost fingers up to 0.85, of a box 1.85, of noise 2.0."""

FASTEST_M_S = 4.0
"""No tip of a gesture moves faster: signers' hands reach 2 m/s, fingers about as much more."""


def fit_hands(
    recording: Sequence[Capture | Volume | DepthMap],
    pose: PoseLike | Iterable[PoseLike] = "all",
    *,
    frames: Sequence[int] | None = None,
    rig: Rig | None = None,
    handedness: str = "right",
    shape: HandShape | None = None,
    fit_shape: bool = True,
    angle_std_deg: float = 12.0,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    search_deg: float = 45.0,
    seed: int = 0,
    device: Device | str | None = None,
    after: Track | None = None,
    progress: Progress | None = None,
) -> Iterator[tuple[FrameFit, Track | None]]:
    """Fit a moving hand to the frames of a recording, each from the one before.

    The first frame is searched for from the starting poses, the others start where angles, place
    and velocities predict them. A frame whose misfit is large, or whose tips moved too fast, is
    searched for again. No simulations are run. docs/hand-movement.md has limits and accuracy.

    Parameters
    ----------
    recording : sequence of Capture, Volume or DepthMap
        Read one by one. Depth maps have no time: the sequence may have `time_us(index)`.
    pose
        Where searches start, as for `fit_hand`. For lost tracks give the poses that occur.
    frames : sequence of int, optional
        Ascending numbers, the recording's own if it has them; all by default.
    fit_shape : bool
        Fit the shape to all frames; not of a rig.
    rig, handedness, shape, angle_std_deg, array, waveform, search_deg, seed
        As for `fit_hand`.
    after : Track, optional
        Continue after the frame of this track.

    Yields
    ------
    frame : FrameFit
        Without a state where no hand was found or the frame cannot be read.
    track : Track or None
        What is remembered after the frame; None before any hand is found.

    Raises
    ------
    CompareError
        No hand in any of the frames.

    Examples
    --------
    >>> grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.28, 0.32), 4e-3)
    >>> dark = clradar.Volume(np.zeros(grid.counts[::-1]), grid)
    >>> fit, track = next(calibration.fit_hands([dark, dark], "F"))
    >>> fit.frame, fit.how, track
    (0, 'nothing found', None)
    """
    seed = checks.whole("fit_hands: seed", seed, 0)
    opened = open_device(device)
    numbers = _numbers(recording, frames)
    fitting = _HandFitting(
        starts_of(pose), rig, checks.one_of("fit_hands: handedness", handedness, SIDES), shape,
        fit_shape and rig is None, checks.positive("fit_hands: angle_std_deg", angle_std_deg),
        array, waveform, search_deg, seed, opened,
    )  # fmt: skip
    return followed(fitting, recording, numbers, after, progress)


class Fitting(Protocol):
    """How single frames are fitted."""

    def image(self, measured: Any) -> Any:
        """The image of a frame, in the form that the other two take; raises `CompareError`."""

    def follow(self, image: Any, track: Track, passed_s: float) -> Settled:
        """Fit a frame from the one before."""

    def search(self, image: Any, track: Track | None) -> Found:
        """Fit a frame from the starting poses; raises `CompareError`."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a search found: the fit, the name of its start, remarks, and which hand it is."""

    settled: Settled
    start: str
    remarks: tuple[str, ...]
    handedness: str


def _numbers(recording: Sequence[Any], frames: Sequence[int] | None) -> list[tuple[int, int]]:
    """Number and index of the frames that are fitted."""
    known = getattr(recording, "frame_numbers", range(len(recording)))
    index = {number: i for i, number in enumerate(known)}
    wanted = list(index) if frames is None else list(frames)
    for frame in wanted:
        if frame not in index:
            checks.fail("fit_hands: frames", f"frames of the recording ({len(index)})", f"{frame}")
    if not wanted or wanted != sorted(set(wanted)):
        checks.fail("fit_hands: frames", "numbers in ascending order, at least one", f"{wanted}")
    return [(frame, index[frame]) for frame in wanted]


def followed(
    fitting: Fitting,
    recording: Sequence[Any],
    numbers: Sequence[tuple[int, int]],
    track: Track | None,
    progress: Progress | None,
) -> Iterator[tuple[FrameFit, Track | None]]:
    """Fit frames, given by number and index, each from the one before; see `fit_hands`."""
    failure: str | None = None
    for done, (number, index) in enumerate(numbers, start=1):
        if track is not None and number <= track.frame:
            continue
        time_s = number * FRAME_S
        try:
            measured = recording[index]
            stamp = _stamp(measured)
            if stamp is None and hasattr(recording, "time_us"):
                stamp = recording.time_us(index)
            time_s = _time_s(number, stamp)
            fit, track = _one_frame(fitting, fitting.image(measured), number, time_s, track)
            del measured  # before the next one is read
        except (CompareError, MeasurementError) as error:
            failure = failure or str(error)
            handedness = "right" if track is None else track.handedness
            fit = FrameFit.nothing(number, time_s, (str(error),), handedness)
            track = None if track is None else replace(track, frame=number)
        yield fit, track
        if progress is not None:
            progress(done, len(numbers))
    if track is None:
        raise CompareError(f"{failure}; and no hand in any other frame")


def _stamp(measured: Any) -> Any:
    """The time stamp of a frame."""
    stamps: Any = capture_meta(getattr(measured, "meta", {})).get("timestamp_us")
    return stamps[0] if isinstance(stamps, list | tuple) and stamps else stamps


def _time_s(number: int, stamp: Any) -> float:
    """When a frame was recorded; without time stamps frames are `FRAME_S` apart."""
    known = isinstance(stamp, int | float) and not isinstance(stamp, bool) and stamp > 0
    return 1e-6 * stamp if known else number * FRAME_S


def _one_frame(
    fitting: Fitting, image: Any, number: int, time_s: float, track: Track | None
) -> tuple[FrameFit, Track]:
    """The fit of a frame, and what is remembered after it."""
    if track is not None:
        return _continued(fitting, image, number, time_s, track)
    found = fitting.search(image, None)
    return _begun(found, number, time_s, found.remarks)


def _begun(
    found: Found, number: int, time_s: float, notes: tuple[str, ...]
) -> tuple[FrameFit, Track]:
    """A frame that was searched for, and a new track."""
    settled = found.settled
    fit = _frame_fit(settled, number, time_s, SEARCHED, found.start, notes, found.handedness)
    return fit, _track(settled, fit, (np.eye(4), FRAME_S), (settled.misfit_per_cell,))


def _continued(
    fitting: Fitting, image: Any, number: int, time_s: float, track: Track
) -> tuple[FrameFit, Track]:
    """A frame from the one before, or searched for where that fails."""
    passed_s = time_s - track.seen_s
    if not passed_s > 0.0:
        passed_s = (number - track.seen) * FRAME_S
    settled = fitting.follow(image, track, passed_s)
    doubt = doubt_of(settled, track, passed_s)
    misfits = (*track.misfits, settled.misfit_per_cell)[-MEMORY:]
    notes: tuple[str, ...] = ()
    if doubt is not None:
        try:
            found = fitting.search(image, track)
        except CompareError as error:
            notes = (doubt, f"a search found nothing: {error}")
        else:
            if found.settled.misfit < settled.misfit - RIVAL_DEVIANCE:
                _check_seen(found.settled, track)
                return _begun(found, number, time_s, (doubt, *found.remarks))
            notes = (doubt, "a search found no better pose")
        _check_seen(settled, track)
        misfits = (settled.misfit_per_cell,)  # what is usual now
    start = f"frame {track.seen}"
    fit = _frame_fit(settled, number, time_s, FOLLOWED, start, notes, track.handedness)
    moved = settled.fitted.state.transform @ np.linalg.inv(track.state.transform)
    return fit, _track(settled, fit, (moved, passed_s), misfits)


def doubt_of(settled: Settled, track: Track, passed_s: float) -> str | None:
    """Why the hand may be lost in a frame; None if nothing says so."""
    usual, now = float(np.median(track.misfits)), settled.misfit_per_cell
    if now > LOST_RATIO * usual:
        return f"the misfit per cell is {now:.2f}, and was {usual:.2f} in the frames before"
    way_m = ends_apart_m(settled.joints_m, track.joints_m)
    fastest = int(way_m.argmax())
    if way_m[fastest] > FASTEST_M_S * passed_s:
        return f"the tip of the {DIGITS[fastest]} moved by {1e3 * way_m[fastest]:.0f} mm"
    return None


def _check_seen(settled: Settled, track: Track) -> None:
    """Raise `CompareError` unless the image of a frame is like a hand in some pose."""
    usual, now = float(np.median(track.misfits)), settled.misfit_per_cell
    if now > GONE_RATIO * usual:
        raise CompareError(
            f"could not fit the hand, because none is seen: the misfit per cell is {now:.2f}, also "
            f"where the hand is searched for, and was {usual:.2f} in the frames before"
        )


def _frame_fit(
    settled: Settled, number: int, time_s: float, how: str, start: str, notes: tuple[str, ...],
    handedness: str,
) -> FrameFit:  # fmt: skip
    known = settled.certainty
    shape_std = np.zeros(N_SHAPE)
    shape_std[: settled.belief.known.stop - N_ANGLES] = settled.belief.shape_std
    return FrameFit(
        number, time_s, how, start, notes, handedness, settled.fitted.state, settled.joints_m,
        known.joint_std_m, known.angle_std_rad, shape_std, known.untold, settled.misfit,
        settled.misfit_per_cell,
    )  # fmt: skip


def _track(
    settled: Settled,
    fit: FrameFit,
    moved: tuple[np.ndarray, float],
    misfits: tuple[float, ...],
) -> Track:
    return Track(
        frame=fit.frame,
        seen=fit.frame,
        seen_s=fit.time_s,
        handedness=fit.handedness,
        state=settled.fitted.state,
        joints_m=settled.joints_m,
        log_brightness=settled.fitted.log_brightness,
        belief=settled.belief,
        moved=moved[0],
        moved_s=moved[1],
        misfits=misfits,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """The image of a frame, and the radar that recorded it."""

    depth: DepthMap
    radar: Radar


@dataclass(frozen=True, slots=True, eq=False)
class _HandFitting:
    """Fits frames by `fit_hand` and by a `Follower`; the attributes are those of `fit_hands`."""

    starts: tuple[Start, ...]
    rig: Rig | None
    handedness: str
    shape: HandShape | None
    fit_shape: bool
    angle_std_deg: float
    array: AntennaArray | None
    waveform: Waveform | None
    search_deg: float
    seed: int
    device: Device

    def image(self, measured: Any) -> Image:
        seen, radar = imaged("fit_hands", measured, self.array, self.waveform, self.device)
        return Image(depth_for_mesh(seen, None), radar)

    def follow(self, image: Image, track: Track, passed_s: float) -> Settled:
        return self._follower(image, track.handedness).follow(image.depth, track, passed_s)

    def search(self, image: Image, track: Track | None) -> Found:
        shape = self.shape if track is None else track.state.shape
        handedness = self.handedness if track is None else track.handedness
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClradarWarning)  # they are among the notes
            fit = fit_hand(
                image.depth, self.starts, rig=self.rig, handedness=handedness, shape=shape,
                fit_shape=self.fit_shape and track is None, closed_loop=False,
                angle_std_deg=self.angle_std_deg, array=image.radar.array,
                waveform=image.radar.waveform, search_deg=self.search_deg, seed=self.seed,
                device=self.device,
            )  # fmt: skip
        begun = next(start.pose for start in self.starts if start.name == fit.start)
        nominal = HandState(begun, shape or AVERAGE, fit.transform)
        belief = Belief.of_start(nominal, self.angle_std_deg, self.fit_shape)
        if track is not None:
            belief = track.belief.restarted(nominal, self.angle_std_deg)
        state = HandState(fit.pose, fit.shape or AVERAGE, fit.transform)
        follower = self._follower(image, fit.handedness)
        settled = follower.settle(image.depth, state, fit.log_brightness, belief)
        return Found(settled, fit.start, fit.remarks(), fit.handedness)

    def _follower(self, image: Image, handedness: str) -> Follower:
        model: HandModel = (
            ParametricHand(handedness, self.device) if self.rig is None else RiggedHand(self.rig)
        )
        aperture = image.radar.aperture
        shape_is_known = self.shape is not None
        return Follower(model, aperture, self.device, self.fit_shape, self.seed, shape_is_known)
