"""The result of the fit of a hand in words and in JSON, and as the start of the next fit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_fits import UNTOLD, made_up_fit

from calibration.hand_fit.hand_state import angles_of
from calibration.hand_fit.result import TIPS, HandFit
from calibration.hand_fit.starts import Start, starts_of
from clradar.errors import MeasurementError, ModelError
from clradar.files.json_file import write_json
from clradar.hand import JOINT_NAMES, LETTERS, POSES, HandShape, pose_by_name, write_pose


@pytest.fixture(scope="module")
def fit() -> HandFit:
    return made_up_fit(shape=HandShape(length_m=0.18, girth=0.95))


def test_the_record_is_strict_json_with_joints_and_angles_by_name(fit):
    record = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert list(record["joints_m"]) == list(JOINT_NAMES)
    assert record["joints_m"]["thumb-tip"] == fit.tips_m[0].tolist()
    assert record["joint_std_m"]["index-finger-tip"] == pytest.approx(5e-3)
    assert np.trace(record["joint_covariance_m2"]["index-finger-tip"]) == pytest.approx(25e-6)
    assert [digit for digit, told in record["told_tips"].items() if not told] == ["thumb", "index"]
    assert {name for name, row in record["angles"].items() if not row["told"]} == set(UNTOLD)
    middle = record["angles"]["ring-finger-phalanx-intermediate flexion"]
    assert middle["value_deg"] == pytest.approx(
        POSES["F"].angles("ring-finger-phalanx-intermediate").degrees()[0]
    )
    assert middle["std_deg"] == pytest.approx(3.0)


def test_the_report_has_tips_and_what_is_not_told(fit):
    text = fit.report()
    x, y, z = 1e3 * fit.tips_m[1]
    assert f"index {x:.1f}, {y:.1f}, {z:.1f} ± 5.0;" in text
    assert "tells 21 of 23 angles" in text
    assert all(name in text for name in UNTOLD)
    assert "from 'D' with deviance +30.0" in text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"converged": False}, "the pose still changed"),
        (
            {"overlap": 0.7},
            "overlaps with the measurement by 0.70, below 0.8, as of a hand of other",
        ),
        ({"overlap": None, "likeness": 0.8}, "correlates with the measurement by 0.80, below 0.84"),
        ({"notes": ("the thumb is hidden",)}, "the thumb is hidden"),
    ],
)
def test_doubts_are_remarks(fit, changes, said):
    assert not fit.remarks()
    doubtful = replace(fit, **changes)
    (remark,) = doubtful.remarks()
    assert said in remark
    assert f"Doubtful: {remark}." in doubtful.report()
    told = [angle["told"] for angle in doubtful.to_dict()["angles"].values()]
    assert told == doubtful.told_angles.tolist()
    assert len(doubtful.to_dict()["untold"]) == told.count(False)
    assert any(told) == (not doubtful.doubtful)
    assert ("tells 21 of 23 angles" in doubtful.report()) == any(told)


def test_only_a_different_pose_that_fits_as_well_is_a_rival(fit):
    best, other = fit.basins
    near = replace(other, deviance=fit.deviance + 3.0)
    (remark,) = replace(fit, basins=(best, near)).remarks()
    farthest = np.linalg.norm(other.joints_m - fit.joints_m, axis=1)[list(TIPS)].max()
    where = f"the tip of the middle finger {1e3 * farthest:.0f} mm away"
    assert f"deviance +3.0), with {where}" in remark
    same = replace(near, joints_m=fit.joints_m + 2e-3)
    assert not replace(fit, basins=(best, same)).remarks()


def test_the_shape_of_a_rig_is_not_stated(fit, tmp_path):
    of_rig = replace(fit, shape=None)
    assert of_rig.to_dict()["shape"] is None
    write_json(tmp_path / "fit.json", of_rig.to_dict(), force=False)
    for source in (of_rig, tmp_path / "fit.json"):
        assert starts_of(source)[0].shape is None
    lacking = {key: value for key, value in of_rig.to_dict().items() if key != "shape"}
    write_json(tmp_path / "fit.json", lacking, force=True)
    with pytest.raises(MeasurementError, match="'shape' of a fitted hand, got none"):
        starts_of(tmp_path / "fit.json")


def test_a_fit_is_read_as_the_next_start(fit, tmp_path):
    folder = tmp_path / "fit"
    folder.mkdir()
    write_json(folder / "fit.json", {**fit.to_dict(), "command": "fit-hand"}, force=False)
    for source in (fit, str(folder), folder / "fit.json"):
        (start,) = starts_of(source)
        # Pose files have degrees: the last bit may change.
        assert np.allclose(angles_of(start.pose), angles_of(fit.pose), rtol=0.0, atol=1e-12)
        assert start.pose.name == fit.pose.name
        assert (start.shape, start.handedness) == (fit.shape, "right")
        assert start.transform is not None
        assert np.array_equal(start.transform, fit.transform)


def test_starts_by_name_file_pose_and_several(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "F").mkdir()  # a name is a name, whatever lies there
    write_pose("mine.toml", replace(POSES["L"], name="mine"))
    write_pose("mine.json", replace(POSES["L"], name="mine"))
    assert [s.pose.name for s in starts_of("all")] == list(LETTERS)
    several = starts_of(["f", "mine.toml", Path("mine.json"), pose_by_name("Y"), Start(POSES["B"])])
    assert [s.pose.name for s in several] == ["F", "mine", "mine", "Y", "B"]
    assert several[1].pose.joints == POSES["L"].joints
    assert {(s.shape, s.handedness, s.transform) for s in several} == {(None, None, None)}


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ("ZZ", "pose: expected one of 'flat', 'A'"),
        ([], "pose: expected at least one, got none"),
        (3, "pose: expected a name, a pose, an earlier fit, or several, got int"),
        (["F", 3], "pose: expected a name, a pose file, a HandPose or a HandFit, got int"),
    ],
)
def test_wrong_starts_are_named(pose, said):
    with pytest.raises(ModelError) as caught:
        starts_of(pose)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"pose": None}, "expected 'pose' of a fitted hand, got None"),
        ({"shape": {"size_m": 1}}, "shape: "),
        ({"handedness": "up"}, "handedness: expected"),
        ({"transform": np.diag([2.0, 1, 1, 1]).tolist()}, "transform: expected a rotation"),
    ],
)
def test_a_broken_fit_is_named(fit, tmp_path, change, said):
    write_json(tmp_path / "fit.json", {**fit.to_dict(), **change}, force=False)
    with pytest.raises(MeasurementError) as caught:
        starts_of(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / 'fit.json'}: ")
    assert said in str(caught.value)
