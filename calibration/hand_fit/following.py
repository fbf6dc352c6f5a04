"""Fit of one frame of a moving hand: from the frame before, or from where a search found it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.certainty import Certainty, certainty, information_at, joints_at
from calibration.hand_fit.descent import FINE, Fitted, HandFitter, Level, fitted_parameters
from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY
from calibration.hand_fit.hand_shape_vector import shape_of
from calibration.hand_fit.hand_state import N_ANGLES, HandState, pose_with
from calibration.hand_fit.track import Track
from calibration.registration.mesh_fit import POWER_FLOOR, cell_pixels
from calibration.registration.mesh_rendering import Aperture
from clradar.model import DepthMap
from clradar.opencl import Device

FOLLOWING = (Level(2e-3, 2e-3, 2.0, 2, 3), Level(2e-3, 0.0, 1.0, 2, 3))
"""Levels of a frame whose predecessor is known: half the work of a start from a nominal pose."""

_FRESH = 1000  # after the seeds of the descent


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The hand in one frame: the fit, with its misfit on a freshly drawn surface, what it is
    certain of, joints (25, 3) in metres, the belief after it, and the number of resolution cells
    that hold the measured or the fitted hand."""

    fitted: Fitted
    certainty: Certainty
    joints_m: np.ndarray
    belief: Belief
    cells: float

    @property
    def misfit(self) -> float:
        return self.fitted.misfit

    @property
    def misfit_per_cell(self) -> float:
        return self.misfit / self.cells


@dataclass(frozen=True, slots=True, eq=False)
class Follower:
    """Fits frames of one hand."""

    model: HandModel
    aperture: Aperture
    device: Device
    fit_shape: bool
    seed: int  # of the surfaces that are drawn
    shape_is_known: bool = True  # of a shape that is not fitted

    def follow(self, depth: DepthMap, track: Track, time_s: float) -> Settled:
        """Fit a frame that is `time_s` after the last one with a hand."""
        belief = track.belief.after(time_s)
        mean = belief.mean[belief.known]
        start = HandState(
            pose_with(track.state.pose, mean[:N_ANGLES]),
            shape_of(mean[N_ANGLES:]) if self.fit_shape else track.state.shape,
            track.predicted(time_s),
        )
        return self.settle(depth, start, track.log_brightness, belief)

    def settle(
        self, depth: DepthMap, start: HandState, log_brightness: np.ndarray, belief: Belief
    ) -> Settled:
        """Fit a frame from a state, with what is believed of the hand before it."""
        fitted = fitted_parameters(self.fit_shape)
        levels = (*FOLLOWING, FINE)
        fitter = HandFitter(self.model, depth, self.aperture, self.device, fitted, levels)
        prior = belief.prior(start)
        found = fitter.descend(start, log_brightness, prior, FOLLOWING, self.seed)
        found = fitter.judged(found, prior, seed=self.seed + _FRESH)
        known = information_at(fitter, found, prior, self.seed + _FRESH)
        own = (known.fitted >= ANGLES.start) & (known.fitted < N_GEOMETRY)
        return Settled(
            found,
            certainty(fitter, found, prior, self.seed + _FRESH, known, self.shape_is_known),
            joints_at(fitter, found.state),
            belief.measured(found.state, known.covariance()[np.ix_(own, own)]),
            _cells(fitter, found),
        )


def _cells(fitter: HandFitter, found: Fitted) -> float:
    """Resolution cells with more than the floor's power, measured or rendered."""
    picture = fitter.picture(FINE)
    rendered, _ = picture.render(found.state, found.log_brightness)
    return float((np.maximum(picture.power, rendered) > POWER_FLOOR).sum() / cell_pixels(picture))
