"""Poses and places of a moving hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clradar.errors import MeasurementError, ModelError
from clradar.hand import (
    HandShape,
    hand_mesh,
    hand_movement,
    pose_by_name,
    write_pose,
)
from clradar.hand.movement import minimum_jerk


def test_a_movement_passes_through_its_poses(tmp_path: Path) -> None:
    write_pose(tmp_path / "mine.toml", pose_by_name("W"))
    movement = hand_movement(["A", tmp_path / "mine.toml", pose_by_name("flat")], 9, rate_hz=10.0)
    for frame, name in ((0, "A"), (4, "W"), (8, "flat")):
        assert movement.poses[frame].joints == pose_by_name(name).joints
    assert movement.timestamps_us[:3] == (0, 100_000, 200_000)


def test_minimum_jerk_starts_and_ends_at_rest() -> None:
    """Velocity and acceleration vanish at both ends: 30 t^2 (1 - t)^2 and its derivative."""
    time = np.linspace(0.0, 1.0, 101)
    share = np.array([minimum_jerk(t) for t in time])
    assert (np.diff(share) > 0).all()
    np.testing.assert_allclose(share + share[::-1], 1.0, rtol=0, atol=1e-14)
    h = 1e-3  # 10 h^3 is left of the share, whose first and second derivative are 0
    assert minimum_jerk(h) < 10.1 * h**3


@pytest.mark.device
@pytest.mark.parametrize("handedness", ["right", "left"])
def test_joints_of_the_movement_are_those_of_its_mesh(handedness: str) -> None:
    shape = HandShape(length_m=0.17, girth=0.95)
    movement = hand_movement(
        ["F", "flat"], 3, handedness=handedness, shape=shape,
        shift_m=(0.01, 0.0, 0.03), turn_rad=(0.0, 0.4, 0.1),
    )  # fmt: skip
    for frame in (0, 2):
        mesh = hand_mesh(movement.poses[frame], 4e-3, handedness, shape=shape)
        placed = movement.placed(frame, mesh)
        # Sums of a few terms below 1 m in double precision.
        np.testing.assert_allclose(
            placed.joints_m, movement.joints_m(frame, shape), rtol=0, atol=1e-14
        )
        rotation = movement.transforms[frame, :3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


def test_the_hand_is_centred_and_moves_as_told() -> None:
    still = hand_movement(["S", "flat"], 5, center_m=(0.0, 0.01, 0.4))
    joints_m = np.concatenate([still.joints_m(i) for i in range(5)])
    middle_m = 0.5 * (joints_m.min(axis=0) + joints_m.max(axis=0))
    np.testing.assert_allclose(middle_m, (0.0, 0.01, 0.4), rtol=0, atol=1e-14)
    wrists_m = [still.joints_m(i)[0] for i in range(5)]
    np.testing.assert_allclose(wrists_m, [wrists_m[0]] * 5, rtol=0, atol=1e-14)
    moved = hand_movement(["A"], 3, shift_m=(0.0, 0.0, 0.02), turn_rad=(0.0, 0.0, np.pi / 2))
    assert [pose.joints for pose in moved.poses] == [pose_by_name("A").joints] * 3
    first_m, last_m = moved.joints_m(0), moved.joints_m(2)
    x, y, z = first_m.T
    # A quarter turn about boresight through (0, 0, 0.3), and 20 mm away from the radar.
    np.testing.assert_allclose(last_m, np.stack([-y, x, z + 0.02], axis=1), rtol=0, atol=1e-14)


def test_what_is_no_movement_is_refused(tmp_path: Path) -> None:
    for arguments, part in (
        (([], 5), "at least one"),
        ((["A"], 1), "n_frames"),
        ((["A", 3], 5), "names, pose files or poses"),
        ((["elbow"], 5), "elbow"),
    ):
        with pytest.raises(ModelError, match=part):
            hand_movement(*arguments)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="rate_hz"):
        hand_movement(["A"], 5, rate_hz=0.0)
    with pytest.raises(MeasurementError, match=r"none\.toml"):
        hand_movement([tmp_path / "none.toml"], 5)
