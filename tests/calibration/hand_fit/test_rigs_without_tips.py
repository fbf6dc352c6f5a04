"""Rigs that have no tips, as MANO models: what is said of the last joints instead."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_fits import made_up_fit
from hand_renderings import rendered_depth, state_of
from mano_files import mano_model, mano_pickle

from calibration import HandFit, fit_hand
from calibration.hand_fit.hand_model import RiggedHand
from calibration.hand_fit.result import TIPS
from clradar.cli.tables import digit_rows
from clradar.hand import POSES
from clradar.rigs import Rig, read_rig

LAST = [tip - 1 for tip in TIPS]


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
    apart_m = np.linalg.norm((fit.basins[1].joints_m - fit.joints_m)[LAST], axis=1)
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
    assert [row[1:4] for row in digit_rows(fit)] == [["", "", ""]] * 6


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
