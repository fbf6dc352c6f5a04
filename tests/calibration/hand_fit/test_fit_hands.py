"""Frames of a moving hand: what they tell of the next one, following, losing and finding it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_renderings import APERTURE, rendered_depth, state_of
from made_up_frames import MadeUp
from scipy.spatial.transform import Rotation

from calibration import fit_hands
from calibration.hand_fit.belief import (
    MOST_STD_RAD,
    SHAPE_FRAMES,
    SPEED_LASTS_S,
    SPEED_STD_DEG_S,
    Belief,
)
from calibration.hand_fit.fit_hands import FASTEST_M_S, followed
from calibration.hand_fit.following import Follower, Settled
from calibration.hand_fit.frame_fit import FOLLOWED, NOTHING, SEARCHED, FrameFit
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_shape_vector import SHAPE_STD, shape_covariance, shape_of, vector_of
from calibration.hand_fit.hand_state import HIGHEST_RAD, LOWEST_RAD, N_ANGLES, HandState
from calibration.hand_fit.prior import angle_covariance
from calibration.hand_fit.result import ANGLE_NAMES, TIPS
from calibration.hand_fit.track import FRAME_S, Track
from calibration.registration.mesh_fit import initial_log_brightness
from clradar.errors import CompareError, MeasurementError, ModelError
from clradar.hand import interpolate_poses, pose_by_name
from clradar.hand.shape import AVERAGE
from clradar.model import Volume, VoxelGrid
from clradar.opencl import open_device

STATE = HandState(pose_by_name("F"), AVERAGE, np.eye(4))
STEP_S = 0.125


def measured_exactly(belief: Belief, state: HandState, std: float = 1e-4) -> Belief:
    """After a frame that tells all known quantities within `std`."""
    known = belief.known
    information = np.linalg.inv(belief.covariance[known, known])
    return belief.measured(state, np.linalg.inv(information + np.eye(known.stop) / std**2))


@pytest.mark.parametrize("fit_shape", [False, True])
def test_a_belief_begins_at_the_prior_of_a_fit(fit_shape):
    belief = Belief.of_start(STATE, 12.0, fit_shape)
    prior = belief.prior(STATE)
    np.testing.assert_array_equal(prior.mean_rad, STATE.angles_rad)
    np.testing.assert_array_equal(prior.mean_shape, vector_of(AVERAGE))
    own = np.linalg.inv(prior.information[6 : 6 + N_ANGLES, 6 : 6 + N_ANGLES])
    np.testing.assert_allclose(own, angle_covariance(12.0), rtol=0, atol=1e-12)
    assert (belief.shape_std.size > 0) == fit_shape


def test_measured_angles_tell_the_velocity():
    """A joint that turns evenly is soon predicted: the forgetting of velocities leaves a part."""
    rate_rad_s = np.zeros(N_ANGLES)
    rate_rad_s[7] = 0.8
    belief = Belief.of_start(STATE, 12.0, False)
    for frame in range(6):
        state = STATE.with_angles(STATE.angles_rad - frame * STEP_S * rate_rad_s)
        belief = measured_exactly(belief if frame == 0 else belief.after(STEP_S), state)
    ahead = belief.after(STEP_S).mean[:N_ANGLES] - state.angles_rad
    lasts = np.exp(-STEP_S / SPEED_LASTS_S)
    np.testing.assert_allclose(ahead, -lasts * STEP_S * rate_rad_s, rtol=0, atol=1e-3)


def test_a_measured_belief_is_that_of_the_normal_distribution():
    """Against the joint distribution conditioned on a measurement with the same information."""
    before = Belief.of_start(STATE, 12.0, True).after(STEP_S)
    n, known = len(before.mean), before.known
    noise = np.diag(np.linspace(1e-4, 1e-2, known.stop))
    seen = np.eye(n)[known]
    gain = before.covariance @ seen.T @ np.linalg.inv(before.covariance[known, known] + noise)
    result = 0.02 * np.cos(np.arange(known.stop))
    mean = before.mean + gain @ result
    covariance = before.covariance - gain @ seen @ before.covariance
    shape = shape_of(mean[N_ANGLES : known.stop])
    # Angles near their limits would be clipped by a state.
    state = HandState(STATE.pose, shape, np.eye(4)).with_angles(mean[:N_ANGLES])
    inside = np.abs(state.angles_rad - mean[:N_ANGLES]) < 1e-9
    after = before.measured(state, covariance[known, known])
    np.testing.assert_allclose(after.covariance, covariance, rtol=0, atol=1e-12)
    moved = np.flatnonzero(inside)
    np.testing.assert_allclose(after.mean[moved], mean[moved], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.mean[N_ANGLES : known.stop], mean[N_ANGLES : known.stop],
                               rtol=0, atol=1e-12)  # fmt: skip


def test_the_information_on_the_shape_adds_up_to_that_of_two_frames():
    """Each frame has all of its own, half of the one before, a quarter ...: twice one's in all."""
    belief = Belief.of_start(STATE, 12.0, True)
    each = 1.0 / 0.03**2
    seen = replace(STATE, shape=shape_of(vector_of(AVERAGE) + 0.01))
    for frame in range(40):
        belief = belief if frame == 0 else belief.after(STEP_S)
        known = belief.known
        information = np.linalg.inv(belief.covariance[known, known])
        told = information[N_ANGLES:, N_ANGLES:] @ belief.mean[N_ANGLES : known.stop]
        information[N_ANGLES:, N_ANGLES:] += each * np.eye(8)
        # The mean of a normal distribution, whose angles have no part in that of the shape.
        shape = np.linalg.solve(
            information[N_ANGLES:, N_ANGLES:], told + each * vector_of(seen.shape)
        )
        state = replace(STATE, shape=shape_of(shape))
        belief = belief.measured(state, np.linalg.inv(information))
    inner = np.linalg.inv(shape_covariance())
    all_of_it = np.linalg.inv(inner + SHAPE_FRAMES * each * np.eye(8))
    np.testing.assert_allclose(belief.shape_std, np.sqrt(np.diag(all_of_it)), rtol=1e-9)
    mean = SHAPE_FRAMES * each * all_of_it @ vector_of(seen.shape)
    np.testing.assert_allclose(belief.mean[N_ANGLES : known.stop], mean, rtol=0, atol=1e-9)


def test_what_is_not_measured_stays_within_the_limits():
    belief = Belief.of_start(STATE, 12.0, False)
    for _ in range(100):
        belief = belief.after(STEP_S)
    std = np.sqrt(np.diag(belief.covariance))
    assert (std[:N_ANGLES] <= MOST_STD_RAD * (1 + 1e-12)).all()
    assert (belief.mean[:N_ANGLES] >= LOWEST_RAD).all()
    assert (belief.mean[:N_ANGLES] <= HIGHEST_RAD).all()
    # Velocities keep the spread that they have without any measurement.
    speed = np.sqrt(np.diag(angle_covariance(SPEED_STD_DEG_S)))
    np.testing.assert_allclose(std[N_ANGLES:], speed, rtol=1e-9)
    assert np.linalg.eigvalsh(belief.covariance).min() > 0


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


@pytest.mark.slow
def test_a_frame_tells_of_the_shape():
    follower = follower_of(fit_shape=True)
    truth = state_of(pose_by_name("flat"), follower.model)
    depth = rendered_depth(follower.model, truth)
    belief = Belief.of_start(truth, 12.0, True)
    found = follower.settle(depth, truth, initial_log_brightness(), belief)
    assert found.belief.known.stop == 31
    assert (found.belief.shape_std[:2] < 0.5 * SHAPE_STD[:2]).all()  # length and breadth


def run(fitting: MadeUp, frames: Any = range(8), after: Track | None = None) -> Any:
    numbers = [(i, i) for i in range(len(frames))]
    return list(followed(fitting, frames, numbers, after, None))


def test_a_lost_hand_is_noticed_and_found_again():
    """The usual misfit per cell is 0.9; from frame 4 on it is 1.3 unless the hand is found."""
    fitting = MadeUp(misfits={4: 390.0})
    outcome = run(fitting)
    fit = outcome[4][0]
    assert (fit.how, fit.start) == (SEARCHED, "F")
    assert "1.30, and was 0.90" in fit.notes[0]
    assert fitting.calls.count(("search", 4)) == 1
    assert [fit.how for fit, _ in outcome[5:]] == 3 * [FOLLOWED]
    alone, after = outcome[0][1].belief.shape_std, outcome[4][1].belief.shape_std
    assert (after < alone).all()  # the shape is not forgotten


@pytest.mark.parametrize(
    ("searched", "said"), [(386.0, "no better pose"), (np.nan, "found nothing: could not fit")]
)
def test_a_search_that_finds_nothing_better_changes_nothing(searched, said):
    fitting = MadeUp(misfits=dict.fromkeys(range(4, 8), 390.0), searched={4: searched})
    outcome = run(fitting)
    fit = outcome[4][0]
    assert (fit.how, fit.misfit) == (FOLLOWED, 390.0)
    assert said in fit.notes[1]
    # This misfit is the usual one from now on.
    assert [call for call in fitting.calls if call[0] == "search"] == [("search", 0), ("search", 4)]


def test_a_tip_that_moves_faster_than_any_is_searched_for():
    class Jumping(MadeUp):
        def follow(self, image: int, track: Track, passed_s: float) -> Settled:
            found = super().follow(image, track, passed_s)
            far_m = np.zeros((25, 3))
            far_m[14, 1] = 1.05 * FASTEST_M_S * passed_s if image == 3 else 0.0
            return replace(found, joints_m=found.joints_m + far_m)

    outcome = run(Jumping(searched={3: 200.0}))
    assert outcome[3][0].how == SEARCHED
    assert "the tip of the middle moved by" in outcome[3][0].notes[0]


def test_frames_without_a_hand_are_passed_over():
    class Damaged(list[Any]):
        def __getitem__(self, index: Any) -> Any:
            if index == 4:
                raise MeasurementError("000004.npy: damaged")
            return super().__getitem__(index)

    outcome = run(MadeUp(), Damaged([None, 1, 2, None, 4, 5, 6, 7]))
    assert [fit.how for fit, _ in outcome] == [
        NOTHING, SEARCHED, FOLLOWED, NOTHING, NOTHING, FOLLOWED, FOLLOWED, FOLLOWED,
    ]  # fmt: skip
    assert "nothing is there" in outcome[0][0].notes[0]
    assert "damaged" in outcome[4][0].notes[0]
    assert outcome[5][0].start == "frame 2"
    assert np.isnan(outcome[3][0].tips_m).all()


@pytest.mark.parametrize("searched", [590.0, 450.0, np.nan])
def test_a_hand_that_is_gone_is_not_fitted_to_something_else(searched):
    """A box has twice the misfit of a hand; a search finds one again that has left and come."""
    fitting = MadeUp(misfits={4: 600.0}, searched={4: searched})
    outcome = run(fitting)
    fit, track = outcome[4]
    assert (fit.how, fit.state) == (NOTHING, None)
    assert "none is seen: the misfit per cell is" in fit.notes[0]
    assert track is not None
    assert (track.frame, track.seen) == (4, 3)
    assert outcome[5][0].start == "frame 3"


@pytest.mark.parametrize("at", [1, 4])
def test_going_on_after_a_track_gives_the_same(at):
    """Through the arrays that a folder keeps, bit by bit."""
    fitting = MadeUp(misfits={4: 390.0})
    whole = run(fitting)
    track = whole[at][1]
    assert track is not None
    arrays = {name: np.array(values) for name, values in track.to_arrays().items()}
    rest = run(MadeUp(misfits={4: 390.0}), after=Track.from_arrays(arrays))
    assert [fit.frame for fit, _ in rest] == list(range(at + 1, 8))
    for (one, _), (other, _) in zip(whole[at + 1 :], rest, strict=True):
        assert one.to_dict() == other.to_dict()


def test_the_record_of_a_frame_is_json_that_is_read_again():
    (fit, _), (nothing, _) = run(MadeUp(), [0, None])
    for one in (fit, nothing):
        record = json.loads(json.dumps(one.to_dict(), allow_nan=False))
        again = FrameFit.from_dict(record, Path("000000.json"))
        assert (again.how, again.start, again.notes) == (one.how, one.start, one.notes)
        np.testing.assert_array_equal(again.joints_m, one.joints_m)
        np.testing.assert_array_equal(again.joint_std_m, one.joint_std_m)
    assert fit.to_dict()["angles"][ANGLE_NAMES[3]]["told"] is False
    record = fit.to_dict()
    for broken in ({k: v for k, v in record.items() if k != "joints_m"}, {**record, "angles": 3}):
        with pytest.raises(MeasurementError, match=r"000000\.json: expected the record of"):
            FrameFit.from_dict(broken, Path("000000.json"))


def test_wrong_arguments():
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.28, 0.32), 4e-3)
    dark = Volume(np.zeros(grid.counts[::-1], np.complex64), grid)
    for options, part in (
        ({"frames": [2]}, "frames of the recording"),
        ({"frames": []}, "at least one"),
        ({"frames": [1, 0]}, "ascending"),
        ({"pose": "elbow"}, "elbow"),
        ({"handedness": "both"}, "handedness"),
    ):
        with pytest.raises(ModelError, match=part):
            fit_hands([dark, dark], **{"pose": "F", "device": "pocl", **options})
    with pytest.raises(CompareError, match="no hand in any other frame"):
        list(fit_hands([dark, dark], "F", device="pocl"))


@pytest.mark.parametrize("gap", [1, 3])
def test_a_hand_that_was_lost_is_looked_for_where_it_would_be(gap):
    track = run(MadeUp(), [0])[0][1]
    assert track is not None
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.1]).as_matrix()
    turn[:3, 3] = [0.01, 0.0, 0.0]
    moving = replace(track, moved=turn, moved_s=FRAME_S)
    found = moving.predicted(gap * FRAME_S)
    wanted = np.linalg.matrix_power(turn, gap) @ track.state.transform
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    half = moving.predicted(0.5 * FRAME_S) @ np.linalg.inv(track.state.transform)
    np.testing.assert_allclose(half @ half, turn, atol=1e-12)
