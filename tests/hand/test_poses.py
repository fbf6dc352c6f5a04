"""Poses: records, limits, files, the letters and digits, interpolation, and random ones."""

import json
import pickle
from itertools import product

import numpy as np
import pytest
from nightly import nightly

from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.hand import (
    DIGITS,
    JOINT_NAMES,
    LETTERS,
    LIMITS_DEG,
    POSES,
    HandPose,
    JointAngles,
    hand_mesh,
    interpolate_poses,
    pose_around,
    posed_skeleton,
    random_pose,
    read_pose,
    write_pose,
)
from clradar.hand.mesh import crossing_faces
from clradar.hand.sampler import MOST_OVERLAP_M, MOST_PALM_OVERLAP_M, overlaps

FINGERS = ("index", "middle", "ring", "pinky")
SIGNS = (*LETTERS, *DIGITS)
COARSE_M = 3.5e-3

# The search for the letters' angles lets digits touch; skin gives way by about as much.
MOST_LETTER_OVERLAP_M = 1e-3
# A thumb's ball and a palm's pads give way more: what is pressed there is hidden from the radar.
MOST_LETTER_PALM_OVERLAP_M = 3.5e-3

MCP = "{}-finger-phalanx-proximal"
PIP = "{}-finger-phalanx-intermediate"


# --- records


def test_a_pose_is_hashable_comparable_and_picklable():
    angles = {"wrist": JointAngles.from_degrees(10.0, -5.0, 20.0), "thumb-tip": JointAngles()}
    pose = HandPose("mine", angles, "what it is")
    same = HandPose("mine", dict(reversed(angles.items())))
    angles.clear()  # the caller's mapping is not the record's
    assert pose == same == pickle.loads(pickle.dumps(pose))
    assert hash(pose) == hash(same)
    assert pose != HandPose("mine")
    # Joints without angles are none.
    assert set(pose.joints) == {"wrist"}
    assert pose.angles("thumb-tip") == JointAngles()


BEYOND = r"joint thumb-phalanx-distal: flexion: .* \[-30, 90\] degrees, got 114.592 degrees"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HandPose("x", 7), "HandPose.joints: expected a mapping"),
        (lambda: HandPose("x", {"elbow": JointAngles()}), "joint: expected .* 'elbow'"),
        (lambda: HandPose("x", {"wrist": 1.0}), "joint wrist: expected a JointAngles"),
        (lambda: JointAngles(twist_rad=float("nan")), "JointAngles.twist_rad: .* finite"),
        (lambda: HandPose("x", {"thumb-phalanx-distal": JointAngles(2.0)}), BEYOND),
        (lambda: HandPose("x", {"ring-finger-tip": JointAngles(0.1)}), "tip: flexion: expected 0"),
    ],
)
def test_invalid_poses_are_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_every_angle_is_accepted_at_its_limits_and_refused_beyond():
    for name, limits in LIMITS_DEG.items():
        for i, angle_limits in enumerate(limits.values()):
            for limit_deg, beyond_deg in zip(angle_limits, (-0.1, 0.1), strict=True):
                angles_deg = [0.0, 0.0, 0.0]
                angles_deg[i] = limit_deg
                HandPose("limit", {name: JointAngles.from_degrees(*angles_deg)})
                angles_deg[i] += beyond_deg
                with pytest.raises(ModelError, match=f"joint {name}"):
                    HandPose("beyond", {name: JointAngles.from_degrees(*angles_deg)})


# --- kinematics


def test_angles_have_the_documented_signs():
    def moved(name: str, angles_deg: tuple[float, float, float], watched: str) -> np.ndarray:
        bent = posed_skeleton(HandPose("x", {name: JointAngles.from_degrees(*angles_deg)}))
        at = JOINT_NAMES.index(watched)
        return bent.joints_m[at] - posed_skeleton(HandPose("rest")).joints_m[at]

    for finger, away in (("index", -1), ("middle", -1), ("ring", 1), ("pinky", 1)):
        knuckle, end = MCP.format(finger), f"{finger}-finger-tip"
        assert moved(knuckle, (20.0, 0.0, 0.0), end)[2] < -5e-3  # to the palm's side
        assert away * moved(knuckle, (0.0, 15.0, 0.0), end)[0] > 5e-3
        # A twisted finger's bending plane leans towards the thumb (-x).
        twisted = {knuckle: JointAngles.from_degrees(0.0, 0.0, 20.0)}
        hook = {PIP.format(finger): JointAngles.from_degrees(90.0)}
        at = JOINT_NAMES.index(end)
        straight, leaning = (posed_skeleton(HandPose("x", j)) for j in (hook, hook | twisted))
        assert leaning.joints_m[at, 0] < straight.joints_m[at, 0] - 5e-3
    thumb = "thumb-metacarpal"
    assert moved(thumb, (20.0, 0.0, 0.0), "thumb-tip")[0] > 5e-3  # across the palm
    assert moved(thumb, (0.0, 20.0, 0.0), "thumb-tip")[2] < -5e-3  # to the palm's side
    assert moved("wrist", (20.0, 0.0, 0.0), "middle-finger-tip")[2] < -0.05
    assert moved("wrist", (0.0, 20.0, 0.0), "middle-finger-tip")[0] < -0.05  # to the thumb's side
    # Pronation of a raised right hand brings the thumb to the front.
    assert moved("wrist", (0.0, 0.0, 20.0), "thumb-metacarpal")[2] < -5e-3


def test_the_wrist_turns_the_hand_as_one():
    wrist = {"wrist": JointAngles.from_degrees(30.0, -20.0, 50.0)}
    turned = posed_skeleton(HandPose("x", {**POSES["F"].joints, **wrist}))
    still = posed_skeleton(POSES["F"])
    # Rotations of metres: a few rounding errors.
    np.testing.assert_allclose(turned.joints_m, still.joints_m @ turned.frames[0].T, atol=1e-15)
    np.testing.assert_allclose(turned.frames, turned.frames[0] @ still.frames, atol=1e-14)


# --- files


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_a_written_pose_is_read_again(tmp_path, suffix):
    odd = HandPose('odd "name" \\ \x7f\té', {}, "line\nbreak")
    for i, pose in enumerate((POSES["K"], POSES["G"], HandPose("bare"), odd)):
        path = tmp_path / f"{i}{suffix}"
        write_pose(path, pose)
        again = read_pose(path)
        assert again == pose
        assert (again.description, again.source) == (pose.description, pose.source)
        with pytest.raises(OutputError, match="exists already"):
            write_pose(path, pose)
        write_pose(path, pose, force=True)
    # Other angles come back to the last bit but one.
    pose = random_pose(np.random.default_rng(5))
    path = tmp_path / f"random{suffix}"
    write_pose(path, pose)
    again = read_pose(path)
    for name, angles in pose.joints.items():
        degrees = again.angles(name).degrees()
        np.testing.assert_allclose(degrees, angles.degrees(), rtol=4 * np.finfo(float).eps)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "x"', "joints: expected a table joints, with the angles of each joint"),
        ("[joints]", "name: expected a value, got nothing"),
        ('name = "x"\n[joints.ellbow]\nflexion_deg = 1', "joints.ellbow: .* got 'ellbow'"),
        ('name = "x"\n[joints]\nwrist = 1', "joints.wrist: expected a table"),
        ('name = "x"\n[joints.wrist]\nflexion = 1', "wrist.flexion: unknown key; .*did you mean"),
        ('name = "x"\n[joints.wrist]\nflexion_deg = nan', "joints.wrist.flexion_deg: .* finite"),
        (
            'name = "x"\n[joints.wrist]\nabduction_deg = -91',
            r"joint wrist: abduction: expected an angle in \[-90, 110\] degrees, got -91 degrees",
        ),
        ("name = ", "expected a pose"),
    ],
)
def test_files_that_are_no_pose_are_refused_with_their_name(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match=rf"bad\.toml: .*{message}") as info:
        read_pose(path)
    assert "\n" not in str(info.value)


def test_what_is_no_file_of_a_pose_is_refused(tmp_path):
    (tmp_path / "big.json").write_text(json.dumps({"name": "x" * 300_000, "joints": {}}))
    (tmp_path / "latin.toml").write_bytes(b'name = "\xff"')
    for name in ("big.json", "latin.toml", "none.toml", "none.txt", "none.tom\u2028l"):
        with pytest.raises(MeasurementError, match=name[:8]) as info:
            read_pose(tmp_path / name)
        assert str(info.value).isprintable()
    with pytest.raises(OutputError):
        write_pose(tmp_path / "x.txt", POSES["F"])


# --- letters and digits


def test_all_signs_are_there_and_described():
    assert set(POSES) == {"flat", *"ABCDEFGHIKLMNOPQRSTUVWXY", *"0123456789"}
    assert len(POSES) == 35
    for name, pose in POSES.items():
        assert pose.name == name
        assert pose.description
        assert name == "flat" or "Handshape" in pose.source


@pytest.mark.parametrize("sign", SIGNS)
def test_digits_of_a_sign_hardly_penetrate(sign):
    for parts, depth_m in overlaps(POSES[sign]).items():
        most_m = MOST_LETTER_PALM_OVERLAP_M if "palm" in parts else MOST_LETTER_OVERLAP_M
        assert depth_m < most_m


EDGES_M = (1.4e-3, 1.7e-3, COARSE_M)


@pytest.mark.device
@pytest.mark.parametrize(
    ("sign", "edge_length_m"),
    [*product("KMQS", [COARSE_M]), *nightly(product(POSES, EDGES_M))],
)
def test_surface_of_a_sign_is_closed_without_self_intersections(sign, edge_length_m):
    check_surface(hand_mesh(sign, edge_length_m))


def check_surface(mesh):
    surface = mesh.to_trimesh()
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.body_count == 1
    assert surface.volume > 0
    assert len(crossing_faces(mesh.vertices_m, mesh.faces)) == 0


# --- between poses, and random ones


def test_interpolation_ends_at_its_poses_and_is_linear():
    a, b = POSES["A"], POSES["Y"]
    assert interpolate_poses(a, b, 0.0).joints == a.joints
    assert interpolate_poses(a, b, 1.0).joints == b.joints
    half = interpolate_poses(a, b, 0.5)
    for name in JOINT_NAMES:
        middle = 0.5 * (np.array(a.angles(name).degrees()) + b.angles(name).degrees())
        # Sums of angles below 180 degrees: a few rounding errors.
        np.testing.assert_allclose(half.angles(name).degrees(), middle, atol=1e-12)
    with pytest.raises(ModelError, match="share"):
        interpolate_poses(a, b, 1.1)
    with pytest.raises(ModelError, match="expected a HandPose"):
        interpolate_poses("A", b, 0.5)


def test_random_poses_follow_from_the_generator_and_are_plausible():
    poses = [random_pose(np.random.default_rng(seed)) for seed in range(36)]
    assert random_pose(np.random.default_rng(7)) == poses[7] != poses[8]
    for pose in poses:
        for parts, depth_m in overlaps(pose).items():
            assert depth_m <= (MOST_PALM_OVERLAP_M if "palm" in parts else MOST_OVERLAP_M)
    bent = np.array([[p.angles(PIP.format(f)).flexion_rad for f in FINGERS] for p in poses])
    together = np.corrcoef(bent.T)
    # Neighbours bend together: drawn with correlations of 0.6, of which 36 samples keep 0.17 at
    # four standard errors (0.107 each).
    assert (np.diag(together, 1) > 0.17).all()
    # All of the range is used: straight fingers and folded ones.
    assert (np.rad2deg(bent.min(axis=0)) < 15).all()
    assert (np.rad2deg(bent.max(axis=0)) > 90).all()
    last = [[p.angles(f"{f}-finger-phalanx-distal").flexion_rad for f in FINGERS] for p in poses]
    assert np.corrcoef(np.ravel(last), bent.ravel())[0, 1] > 0.9


@pytest.mark.slow
def test_poses_around_a_letter_deviate_as_asked_and_penetrate_no_more_than_it():
    letter = POSES["F"]  # where nearly every draw fits, so that rejection hardly narrows them
    drawn = [pose_around(letter, np.random.default_rng(seed), 6.0) for seed in range(12)]
    own_m = overlaps(letter)
    for parts, depth_m in (found for pose in drawn for found in overlaps(pose).items()):
        most_m = MOST_PALM_OVERLAP_M if "palm" in parts else MOST_OVERLAP_M
        assert depth_m <= max(most_m, own_m[parts])
    # Of 36 draws a standard deviation is known within 12 %; four times as much.
    for name, angle, std_deg in ((MCP, 0, 6.0), (MCP, 1, 3.5)):
        joints = [name.format(f) for f in ("middle", "ring", "pinky")]
        off = [p.angles(j).degrees()[angle] - letter.angles(j).degrees()[angle]
               for p in drawn for j in joints]  # fmt: skip
        assert 0.52 < np.std(off) / std_deg < 1.48


def test_a_pose_around_another_follows_from_the_generator_and_the_spread():
    letter = POSES["F"]
    one, same = (pose_around(letter, np.random.default_rng(7)) for _ in range(2))
    assert one == same
    assert one != letter
    assert pose_around(letter, np.random.default_rng(7), 0.0) == letter
    with pytest.raises(ModelError, match="spread_deg"):
        pose_around(letter, np.random.default_rng(7), 46)
