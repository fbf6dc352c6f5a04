"""Fits of frames that know the truth, for tests of what is done with them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.certainty import Certainty
from calibration.hand_fit.descent import Fitted
from calibration.hand_fit.fit_hands import Found, followed
from calibration.hand_fit.following import Settled
from calibration.hand_fit.frame_fit import FrameFit
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.result import ANGLE_NAMES
from calibration.hand_fit.track import FRAME_S, Track
from clradar.errors import CompareError
from clradar.hand.shape import AVERAGE
from clradar.model import Volume
from clradar.motion.hands import MovingHand
from clradar.motion.rigid import RigidMotion

TIMES_S = np.arange(8) / 8.0
_ENDS_S = TIMES_S[[0, -1]]
_AWAY = RigidMotion(_ENDS_S, [(0, 0, 0), (0, 0, 0.01)], profile="smooth")
MOVEMENT = MovingHand(_ENDS_S, ["F", "flat"], motion=_AWAY)


def settled(frame: int, misfit: float, belief: Belief) -> Settled:
    """A made-up fit at the truth of a frame."""
    state = HandState(MOVEMENT.pose(TIMES_S[frame]), AVERAGE, MOVEMENT.transform(TIMES_S[frame]))
    known = np.linalg.inv(np.linalg.inv(belief.covariance[belief.known, belief.known]) + np.eye(31))
    joints_m = MOVEMENT.joints_m(TIMES_S[frame])
    std, joints_m2 = np.sqrt(np.diag(known)[:23]), np.tile(1e-6 * np.eye(3), (25, 1, 1))
    certainty = Certainty(known, (), std, joints_m2, (ANGLE_NAMES[3],))
    fitted = Fitted(state, np.linspace(0.0, -3.0, 7), misfit, misfit)
    return Settled(fitted, certainty, joints_m, belief.measured(state, known), 300.0)


@dataclass
class MadeUp:
    """Fits that know the truth; frames are their numbers."""

    misfits: dict[int, float] = field(default_factory=dict)
    """Of frames that are followed, where it is not 270."""
    searched: dict[int, float] = field(default_factory=dict)
    """Of frames that are searched for, where it is not 270; NaN: nothing is found."""
    calls: list[tuple[str, int]] = field(default_factory=list)

    def image(self, measured: Any) -> int:
        if isinstance(measured, Volume):
            return int(measured.meta["capture"]["frame"])
        if measured is None:
            raise CompareError("could not fit the hand, because nothing is there")
        return int(measured)

    def follow(self, image: int, track: Track, passed_s: float) -> Settled:
        self.calls.append(("follow", image))
        assert passed_s == pytest.approx((image - track.seen) * FRAME_S)
        return settled(image, self.misfits.get(image, 270.0), track.belief.after(passed_s))

    def search(self, image: int, track: Track | None) -> Found:
        self.calls.append(("search", image))
        misfit = self.searched.get(image, 270.0)
        if np.isnan(misfit):
            raise CompareError("could not fit the hand, because it is none")
        state = HandState(MOVEMENT.poses[0], AVERAGE, np.eye(4))
        belief = Belief.of_start(state, 12.0, True)
        if track is not None:
            belief = track.belief.restarted(state, 12.0)
        return Found(settled(image, misfit, belief), "F", (), "right")


def made_up_fit_hands(
    images: Any, *, frames: list[int], after: Track | None, progress: Any = None, **settings: Any
) -> Iterator[tuple[FrameFit, Track | None]]:
    """Stands for `calibration.fit_hands`; frame 2 is searched for."""
    assert {"pose", "fit_shape", "array", "waveform", "seed"} <= set(settings)
    numbers = [(number, images.frame_numbers.index(number)) for number in frames]
    return followed(MadeUp(misfits={2: 390.0}), images, numbers, after, progress)
