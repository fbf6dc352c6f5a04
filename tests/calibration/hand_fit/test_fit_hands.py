"""Frames of a moving hand, each from the one before: losing it, finding it, and going on later."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_frames import MadeUp
from scipy.spatial.transform import Rotation

from calibration import fit_hands
from calibration.hand_fit.fit_hands import FASTEST_M_S, followed
from calibration.hand_fit.following import Settled
from calibration.hand_fit.frame_fit import FOLLOWED, NOTHING, SEARCHED, FrameFit
from calibration.hand_fit.result import ANGLE_NAMES
from calibration.hand_fit.track import FRAME_S, Track
from clradar.errors import CompareError, MeasurementError, ModelError
from clradar.model import Volume, VoxelGrid


def run(fitting: MadeUp, frames: Any = range(8), after: Track | None = None) -> Any:
    numbers = [(i, i) for i in range(len(frames))]
    return list(followed(fitting, frames, numbers, after, None))


def test_frames_are_followed_from_the_first_on():
    fitting = MadeUp()
    outcome = run(fitting)
    assert [fit.how for fit, _ in outcome] == [SEARCHED] + 7 * [FOLLOWED]
    assert [fit.start for fit, _ in outcome][:3] == ["F", "frame 0", "frame 1"]
    assert fitting.calls == [("search", 0)] + [("follow", i) for i in range(1, 8)]
    std = [fit.shape_std for fit, _ in outcome[:3]]
    assert all((later < earlier).all() for earlier, later in pairwise(std))


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


def test_no_hand_at_all_is_an_error():
    with pytest.raises(CompareError, match="nothing is there; and no hand in any other frame"):
        run(MadeUp(), [None, None])


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
