"""Hands whose pose changes over time: poses, joints and places."""

import numpy as np
import pytest

from clradar import MovingHand, RigidMotion
from clradar.errors import MeasurementError, ModelError
from clradar.hand import HandShape, pose_by_name, write_pose

TURN = RigidMotion([0.0, 1.0], [(0, 0, 0), (0.01, 0, 0.03)], [(0, 0, 0), (0, 0.4, 0.1)])


def test_a_hand_passes_through_its_poses_about_its_centre(tmp_path):
    write_pose(tmp_path / "mine.toml", pose_by_name("W"))
    poses = ["A", tmp_path / "mine.toml", pose_by_name("flat")]
    hand = MovingHand([0.0, 1.0, 2.0], poses, center_m=(0.0, 0.01, 0.4))
    for time_s, name in ((-1.0, "A"), (1.0, "W"), (9.0, "flat")):
        assert hand.pose(time_s).joints == pose_by_name(name).joints
    joints_m = np.concatenate([hand.joints_m(time_s) for time_s in (0.0, 1.0, 2.0)])
    middle_m = 0.5 * (joints_m.min(axis=0) + joints_m.max(axis=0))
    np.testing.assert_allclose(middle_m, (0.0, 0.01, 0.4), rtol=0, atol=1e-15)
    # The wrist stays while the pose changes.
    np.testing.assert_allclose(hand.joints_m(0.3)[0], hand.joints_m(1.7)[0], rtol=0, atol=1e-15)


@pytest.mark.device
def test_joints_are_those_of_the_mesh():
    shape = HandShape(length_m=0.17, girth=0.95)
    hand = MovingHand(
        [0.0, 1.0], ["F", "flat"], motion=TURN, shape=shape, handedness="left", edge_length_m=4e-3
    )
    for time_s in (0.0, 0.7):
        # Sums of a few terms below 1 m in double precision.
        found_m = hand.mesh(time_s).joints_m
        np.testing.assert_allclose(found_m, hand.joints_m(time_s), rtol=0, atol=1e-14)
        rotation = hand.transform(time_s)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("poses", "more", "error", "said"),
    [
        (["A"], {}, ModelError, "one for each of 2 times"),
        (["A", "nonesuch"], {}, ModelError, "pose: expected one of"),
        (["A", 7], {}, ModelError, "names, pose files or poses, got 7"),
        (["A", "none.toml"], {}, MeasurementError, "none.toml"),
        (["A", "B"], {"profile": "fast"}, ModelError, "profile"),
        (["A", "B"], {"edge_length_m": 0.1}, ModelError, "edge_length_m"),
        (["A", "B"], {"motion": 1}, ModelError, "MovingHand.motion"),
    ],
)
def test_what_is_no_moving_hand_is_refused(poses, more, error, said):
    with pytest.raises(error, match=said):
        MovingHand([0.0, 1.0], poses, **more)
