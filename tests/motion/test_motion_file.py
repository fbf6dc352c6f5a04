"""Motion files, the motions that they describe, and hands whose pose changes over time."""

from pathlib import Path

import numpy as np
import pytest

import clradar
from clradar import MovingHand, RigidMotion
from clradar.errors import MeasurementError, ModelError
from clradar.hand import HandShape, pose_by_name, write_pose


def written(folder: Path, text: str) -> Path:
    path = folder / "motion.toml"
    path.write_text(text)
    return path


def test_places_and_turns_are_interpolated():
    motion = RigidMotion(
        [1.0, 2.0, 4.0],
        [(0, 0, 0), (0, 0, 0.1), (0, 0.2, 0.1)],
        [(0, 0, 0), (0, 0, 4 * np.pi), (0, 0, 4 * np.pi)],
        about_m=(0.1, 0, 0),
    )
    assert (motion.at(0.0) == np.eye(4)).all()
    quarter = motion.at(1.125)  # a quarter of a turn of two about z at x = 0.1
    assert quarter[:3, :3] @ (1, 0, 0) == pytest.approx((0, 1, 0), abs=1e-12)
    assert quarter @ (0.1, 0, 0, 1) == pytest.approx((0.1, 0, 0.0125, 1))
    assert motion.at(9.0)[:3, 3] == pytest.approx((0, 0.2, 0.1), abs=1e-12)
    # From rest to rest with the least jerk: 10 t^3 - 15 t^4 + 6 t^5.
    smooth = RigidMotion([0, 1], [(0, 0, 0), (0, 0, 1)], profile="smooth")
    assert [smooth.at(t)[2, 3] for t in (0.25, 0.5)] == pytest.approx([53 / 512, 0.5], abs=1e-15)
    both = RigidMotion([0, 1], np.zeros((2, 3)), [(np.pi / 2, 0, 0), (0, np.pi / 2, 0)]).at(0.5)
    # Half of the shortest way: the rotation R with R R = (last) (first)^-1 after the first one.
    first = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    last = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    way = first.T @ both[:3, :3]
    assert first @ way @ way == pytest.approx(last, abs=1e-12)


def test_a_file_has_bodies_hands_and_the_order_of_switching(tmp_path):
    (tmp_path / "bent.toml").write_text(
        'name = "bent"\n[joints.index-finger-phalanx-intermediate]\nflexion_deg = 80'
    )
    motion = clradar.read_motion(
        written(
            tmp_path,
            """
            sweep.step_us = 1
            [[body]]
            mesh = "ball.ply"
            profile = "smooth"
            place = [{ time_s = 0 }, { time_s = 2, shift_mm = [0, 0, 20], turn_deg = [0, 90, 0] }]
            [[hand]]
            handedness = "left"
            velocity_mm_per_s = [0, 0, 50]
            pose = [{ time_s = 0, pose = "A" }, { time_s = 1, pose = "bent.toml" }]
            """,
        )
    )
    assert motion.bodies["ball.ply"].at(1.0)[2, 3] == pytest.approx(0.01)
    assert motion.hands[0].poses[1].name == "bent"
    assert [path.name for path in motion.files] == ["motion.toml", "bent.toml"]
    radar = clradar.AntennaArray([(0, 0, 0), (0.01, 0, 0)], [(0, 0.01, 0)])
    (timing,) = motion.timings([radar], clradar.Waveform([72e9, 73e9]))
    assert timing.times_s[:, 0].tolist() == [[0, 1e-6], [2e-6, 3e-6]]
    with pytest.raises(ModelError, match=r"motion.toml: body.mesh: .* got 'ball.ply'"):
        motion.scene({})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"motion.toml: body: expected \[\[body\]\] or \[\[hand\]\]"),
        ("[[body]]\nvelocty_mm_per_s = [0, 0, 1]", r"did you mean 'velocity_mm_per_s'"),
        ("[[body]]\nabout_mm = [0, 0, 1]", r"body\[0\].place: expected either"),
        ("[[body]]\nvelocity_mm_per_s = [0, 1]", r"velocity_mm_per_s: expected a list of 3"),
        ("[[body]]\nplace = [{ shift_mm = [0, 0, 1] }]", r"place\[0\].time_s: expected a time"),
        ("[[body]]\nplace = [{ time_s = 1 }, { time_s = 1 }]", r"body\[0\].*times that increase"),
        ("[[body]]\nturn_deg_per_s = [0, 0, 1]\nbeyond = 'hold'", r"beyond: expected \[\[place"),
        ("[[hand]]\npose = [{ time_s = 0, pose = 'nonesuch' }]", r"hand\[0\].*nonesuch"),
        ("[[hand]]\npose = [{ time_s = 0, pose = 'no.toml' }]", r"no.toml: expected a pose"),
        ("sweep.order = 'rx'\n[[hand]]\npose = [{ time_s = 0, pose = 'A' }]", "sweep.order"),
        ("[[hand]]\nedge_mm = 0\npose = [{ time_s = 0, pose = 'A' }]", r"hand\[0\].*edge_length_m"),
        ("[[hand]]\nrig = 'x.glb'\ngirth = 1\npose = [{ time_s = 0, pose = 'A' }]", "girth.*rig"),
        ("sweep.cluster_us = -1\n[[hand]]\npose = [{ time_s = 0, pose = 'A' }]", "cluster_us"),
    ],
)  # fmt: skip
def test_mistakes_name_the_file_and_the_key(tmp_path, text, said):
    with pytest.raises(MeasurementError, match=said):
        clradar.read_motion(written(tmp_path, text))


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
