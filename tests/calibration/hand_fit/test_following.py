"""A frame of a moving hand from the one before, on the hand's own rendering."""

import numpy as np
import pytest
from hand_renderings import APERTURE, rendered_depth, state_of

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.fit_hands import FRAME_S
from calibration.hand_fit.following import Follower
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_shape_vector import SHAPE_STD
from calibration.hand_fit.result import TIPS
from calibration.hand_fit.track import Track
from calibration.registration.mesh_fit import initial_log_brightness
from clradar.hand import interpolate_poses, pose_by_name
from clradar.opencl import open_device


def follower_of(*, fit_shape: bool) -> Follower:
    device = open_device("pocl")
    return Follower(ParametricHand("right", device), APERTURE, device, fit_shape, 0)


def test_a_frame_is_followed_from_the_one_before():
    """The index finger has bent, and all tips are found within a pixel."""
    follower = follower_of(fit_shape=False)
    model = follower.model
    flat, other = pose_by_name("flat"), pose_by_name("F")
    before, now = (state_of(interpolate_poses(flat, other, s), model) for s in (0.0, 0.15))
    joints_m, true_m = (
        model.joints_m(one.pose, one.shape) + one.transform[:3, 3] for one in (before, now)
    )
    belief = Belief.of_start(before, 12.0, False)
    track = Track(
        0, 0, 0.0, "right", before, joints_m, initial_log_brightness(), belief, np.eye(4), 0.125,
        (1.0,),
    )  # fmt: skip
    found = follower.follow(rendered_depth(model, now, 3e-3), track, FRAME_S)
    tips = list(TIPS)
    assert np.linalg.norm(found.joints_m - true_m, axis=1)[tips].max() < 2e-3
    # The tip of the index, which bends.
    assert np.linalg.norm(found.joints_m - joints_m, axis=1)[tips].max() > 8e-3
    assert found.belief.known.stop == 23
    # A measured belief is no wider than before, and a covariance.
    widest = np.diag(belief.after(FRAME_S).covariance)[:23] * (1 + 1e-9)
    assert (np.diag(found.belief.covariance)[:23] <= widest).all()
    assert np.linalg.eigvalsh(found.belief.covariance).min() > 0


@pytest.mark.slow
def test_a_frame_tells_of_the_shape():
    follower = follower_of(fit_shape=True)
    truth = state_of(pose_by_name("flat"), follower.model)
    depth = rendered_depth(follower.model, truth)
    belief = Belief.of_start(truth, 12.0, True)
    found = follower.settle(depth, truth, initial_log_brightness(), belief)
    assert found.belief.known.stop == 31
    assert (found.belief.shape_std[:2] < 0.5 * SHAPE_STD[:2]).all()  # length and breadth
