"""A frame of a moving hand from the one before, on the hand's own rendering."""

import numpy as np
import pytest
from hand_renderings import rendered_depth, state_of

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.fit_hands import FRAME_S
from calibration.hand_fit.following import Follower, Settled
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_shape_vector import SHAPE_STD
from calibration.hand_fit.result import TIPS
from calibration.hand_fit.track import Track
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.mesh_rendering import Aperture
from clradar import arrays
from clradar.hand import interpolate_poses, pose_by_name
from clradar.opencl import open_device


def followed(fit_shape: bool, n_frames: int) -> list[Settled]:
    """Renderings of an index finger that bends, each fitted to within a pixel at the tips."""
    device = open_device("pocl")
    aperture, model = Aperture(arrays.qar50(), 77e9), ParametricHand("right", device)
    follower = Follower(model, aperture, device, fit_shape, 0)
    found: list[Settled] = []
    for frame, share in zip(range(n_frames), (0.0, 0.15), strict=False):
        pose = interpolate_poses(pose_by_name("flat"), pose_by_name("F"), share)
        truth = state_of(pose, model)
        depth = rendered_depth(model, truth, aperture)
        if not found:
            belief = Belief.of_start(truth, 12.0, fit_shape)
            found = [follower.settle(depth, truth, initial_log_brightness(), belief)]
        else:
            before = found[-1]
            track = Track(
                frame - 1, frame - 1, 0.0, "right", before.fitted.state, before.joints_m,
                before.fitted.log_brightness, before.belief, np.eye(4), 0.125, (1.0,),
            )  # fmt: skip
            found.append(follower.follow(depth, track, FRAME_S))
        joints_m = model.joints_m(truth.pose, truth.shape) + truth.transform[:3, 3]
        away_m = np.linalg.norm(found[-1].joints_m - joints_m, axis=1)[list(TIPS)]
        assert away_m.max() < 2e-3, away_m
    return found


def test_a_frame_is_followed_from_the_one_before():
    first, second = followed(False, 2)
    moved_m = np.linalg.norm(second.joints_m - first.joints_m, axis=1)[list(TIPS)]
    assert moved_m.max() > 8e-3  # the tip of the index, which bends
    assert first.belief.known.stop == 23
    # A measured belief is no wider than before, and a covariance.
    before = first.belief.after(FRAME_S).covariance
    assert (np.diag(second.belief.covariance)[:23] <= np.diag(before)[:23] * (1 + 1e-9)).all()
    assert np.linalg.eigvalsh(second.belief.covariance).min() > 0


@pytest.mark.slow
def test_a_frame_tells_of_the_shape():
    (found,) = followed(True, 1)
    assert found.belief.known.stop == 31
    assert (found.belief.shape_std[:2] < 0.5 * SHAPE_STD[:2]).all()  # length and breadth
