"""The result of the fit of a hand: doubts, words, JSON, figure, and the start of the next fit."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_fits import UNTOLD, made_up_fit
from hand_renderings import rendered_depth, state_of
from mano_files import mano_model, mano_pickle
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse

from calibration import fit_hand
from calibration.hand_fit.figure import OTHERS, hand_fit_figure
from calibration.hand_fit.hand_model import RiggedHand
from calibration.hand_fit.hand_state import angles_of
from calibration.hand_fit.recognition import (
    ELSEWHERE,
    MARGIN_M,
    MIN_OVERLAP,
    check_likeness,
    check_overlap,
    doubts,
)
from calibration.hand_fit.result import DOUBTFUL_LIKENESS, DOUBTFUL_OVERLAP, TIPS, HandFit
from calibration.hand_fit.starts import Start, starts_of
from clradar import Capture, DepthMap, Volume, VoxelGrid, Waveform, arrays
from clradar.errors import CompareError, MeasurementError, ModelError
from clradar.files.json_file import write_json
from clradar.hand import JOINT_NAMES, LETTERS, POSES, HandShape, pose_by_name, write_pose
from clradar.rigs import Rig, read_rig


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


def image_to(end_m: float) -> Volume:
    """A grid around a hand at 0.3 m, whose x ends somewhere."""
    grid = VoxelGrid.from_extent((-0.14, end_m), (-0.14, 0.14), (0.2, 0.4), 20e-3)
    return Volume(np.zeros(grid.shape, np.complex64), grid)


def test_images_without_signal_are_refused_by_one_line_about_the_hand():
    array = arrays.qar50().part(slice(None, None, 24), slice(None, None, 24))
    silent = np.zeros((array.n_tx, array.n_rx, 8), np.complex64)
    for dark in (image_to(0.14), Capture(silent, array, Waveform.sfcw(72e9, 82e9, 8))):
        with pytest.raises(CompareError, match=r"^could not fit the hand, because [^\n]*$"):
            fit_hand(dark, "F", device="pocl")


def test_what_is_no_hand_is_refused():
    for likeness in (0.1, float("nan")):
        with pytest.raises(CompareError, match=r"correlate by .* 0.60 is the least"):
            check_likeness(likeness)
    check_likeness(0.7)
    with pytest.raises(CompareError, match=r"from 'F', it overlaps .* by 0.52, .*pose='all'"):
        check_overlap(0.52, "F")
    check_overlap(MIN_OVERLAP, "F")


def test_a_fit_that_overlaps_little_is_doubted_and_a_good_one_is_not():
    sure = {"joint_covariance_m2": np.tile(1e-6 * np.eye(3), (25, 1, 1))}
    right = (made_up_fit(**sure), made_up_fit(overlap=None, likeness=0.93, **sure))
    for fit in right:
        assert doubts(fit, image_to(0.14), ELSEWHERE) == ()
        (remark,) = doubts(fit, image_to(0.14), 9.0)
        assert "in front of or behind" in remark
        assert "3.0 times as large" in remark
        assert fit.told_tips.all()
        assert not fit.doubtful
    wrong = (
        made_up_fit("F", "L", overlap=DOUBTFUL_OVERLAP - 0.01, **sure),
        made_up_fit("F", "L", overlap=None, likeness=DOUBTFUL_LIKENESS - 0.01, **sure),
    )
    for fit in wrong:
        assert not fit.told_tips.any()
        assert not fit.told_angles.any()
        assert any("as of a hand of other proportions" in each for each in fit.remarks())


def test_the_digits_that_are_cut_are_named():
    fit = made_up_fit("B")
    order = np.argsort(-fit.tips_m[:, 0])  # the little finger is farthest along x
    assert order[0] == 4
    end_m = 0.5 * (fit.tips_m[4, 0] + fit.tips_m[3, 0])
    assert end_m - MARGIN_M > fit.tips_m[3, 0]
    axis_m = np.linspace(-0.14, 0.14, 15)
    x_m = np.linspace(-0.14, end_m, 15)
    depth = DepthMap(np.full((15, 15), 0.3), np.ones((15, 15)), x_m, axis_m, 20.0)
    (remark,) = doubts(fit, depth)
    assert "are the tips of: pinky (" in remark
    joints_m = np.array(fit.joints_m)
    joints_m[4] = np.nan  # a rig without a tip is not cut
    assert doubts(made_up_fit("B", joints_m=joints_m), image_to(0.14)) == ()
    near = VoxelGrid.from_extent((-0.14, 0.14), (-0.14, 0.14), (0.32, 0.4), 20e-3)
    (remark,) = doubts(fit, Volume(np.zeros(near.shape, np.complex64), near))
    assert "thumb, index, middle, ring, pinky (" in remark


def test_an_unusual_shape_is_remarked_where_it_was_fitted():
    fit = made_up_fit(shape=HandShape(girth=1.2))  # log 1.2 / 0.045 = 4.05
    assert doubts(fit, image_to(0.14)) == ()
    fitted = replace(fit, parameter_names=(*fit.parameter_names, "shape girth"))
    (remark,) = doubts(fitted, image_to(0.14))
    assert remark == "its shape is unusual: girth 4.1 standard deviations above the average adult's"


def points(lines: list[Any]) -> np.ndarray:
    return np.concatenate([line.get_xydata() for line in lines])


def test_joints_and_tips_are_where_the_hand_is():
    axis_m = np.linspace(-0.12, 0.12, 13)
    measured = DepthMap(np.full((13, 13), 0.3), np.ones((13, 13)), axis_m, axis_m, 15.0)
    fit = made_up_fit(joint_covariance_m2=np.tile(np.diag([1e-6, 4e-6, 9e-6]), (25, 1, 1)))
    amplitude, depth, *_ = hand_fit_figure(measured, fit, dynamic_range_db=10.0).axes
    assert amplitude.collections[0].get_clim() == (-10.0, 0.0)
    for axes in (amplitude, depth):
        rings = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
        centres_mm = np.array([ring.center for ring in rings])
        assert np.allclose(centres_mm, 1e3 * fit.tips_m[:, :2])
        # Two standard deviations to either side: 2 mm along x, 4 mm along y.
        for ring in rings:
            box = ring.get_path().transformed(ring.get_patch_transform()).get_extents()
            assert np.allclose(box.size, [4.0, 8.0])
        crosses = points([line for line in axes.lines if to_hex(line.get_color()) == OTHERS])
        assert np.allclose(crosses, 1e3 * fit.basins[1].joints_m[list(TIPS), :2])


def mano(folder: Path, side: str = "right") -> Rig:
    path = folder / f"MANO_{side.upper()}.pkl"
    path.write_bytes(mano_pickle(mano_model(side)))
    return read_rig(path)


def without_tips(fit: HandFit, more: float = 30.0) -> HandFit:
    """The fit without tips, the deviance of its other basin larger by so much."""

    def cut(joints_m: np.ndarray) -> np.ndarray:
        cut_m = np.array(joints_m)
        cut_m[list(TIPS)] = np.nan
        return cut_m

    covariance_m2 = np.array(fit.joint_covariance_m2)
    covariance_m2[list(TIPS)] = np.nan
    best, other = (replace(basin, joints_m=cut(basin.joints_m)) for basin in fit.basins)
    return replace(
        fit, joints_m=cut(fit.joints_m), joint_covariance_m2=covariance_m2,
        basins=(best, replace(other, deviance=fit.deviance + more)),
    )  # fmt: skip


def test_other_poses_are_told_apart_by_the_last_joints():
    fit = without_tips(made_up_fit("F", "L"), more=1.0)
    last = [tip - 1 for tip in TIPS]
    apart_m = np.linalg.norm((fit.basins[1].joints_m - fit.joints_m)[last], axis=1)
    np.testing.assert_array_equal(fit.tips_apart_m(fit.basins[1]), apart_m)
    (remark,) = fit.remarks()
    assert "(deviance +1.0), with the end of the " in remark
    assert f" {1e3 * apart_m.max():.0f} mm away" in remark


def test_the_result_says_that_there_are_no_tips():
    fit = without_tips(made_up_fit())
    assert "Tips" not in fit.report()
    assert "The rig has no tips" in fit.report()
    assert not fit.told_tips.any()
    record = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert record["joints_m"]["thumb-tip"] is record["joint_std_m"]["thumb-tip"] is None
    assert record["basins"][1]["joints_m"]["thumb-phalanx-distal"] is not None


@pytest.mark.slow
@pytest.mark.parametrize("side", ["right", "left"])
def test_a_mano_model_is_fitted(tmp_path, side):
    """To the rendering's own picture of a pose 8 degrees off the letter in one joint."""
    rig = mano(tmp_path, side)
    hand = RiggedHand(rig)
    state = state_of(POSES["L"], hand)
    angles = state.angles_rad
    angles[5] += np.radians(8.0)  # the knuckle of the index finger
    true = state.with_angles(angles)
    depth = rendered_depth(hand, true)
    fit = fit_hand(depth, "L", rig=rig, closed_loop=False, device="pocl")
    assert fit.handedness == side
    assert fit.shape is None
    known = np.isfinite(fit.joints_m).all(axis=1)
    assert known.sum() == 16
    true_m = hand.joints_m(true.pose, true.shape) + true.transform[:3, 3]
    apart_m = np.linalg.norm(fit.joints_m - true_m, axis=1)[known]
    assert apart_m.max() < 2e-3
    assert np.isfinite(fit.joint_std_m[known]).all()
    assert len(fit.scene.faces) == len(rig.faces)
    json.dumps(fit.to_dict(), allow_nan=False)
