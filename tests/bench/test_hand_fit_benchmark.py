"""The benchmark of the fit of hands: its cases are what they say, its table says what is there."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clradar import Volume, VoxelGrid
from clradar.hand import JOINT_NAMES, LIMITS_DEG, pose_by_name, posed_skeleton
from clradar.hand.contact import overlaps
from clradar.hand.sampler import MOST_OVERLAP_M
from clradar.hand.shape import AVERAGE
from measurement_io import save_volume

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import hand_fit
import hand_fit_cases
import hand_fit_table

# Numbers of a parametric hand, a rig, a free pose and a left hand among the development cases.
PARAMETRIC, RIG, FREE = 0, 2, 15


def drawn(number: int, null: bool = False) -> hand_fit_cases.Case:
    return hand_fit_cases.draw_case(number, hand_fit_cases.DEVELOPMENT_SEED, null)[0]


def test_a_case_says_where_its_joints_are() -> None:
    for number in (PARAMETRIC, FREE):
        case = drawn(number)
        mirror = [-1.0 if case.handedness == "left" else 1.0, 1.0, 1.0]
        joints_m = posed_skeleton(case.pose, case.shape).joints_m * mirror
        placed_m = joints_m @ case.transform[:3, :3].T + case.transform[:3, 3]
        np.testing.assert_allclose(placed_m, case.joints_m, atol=1e-12)
        again = hand_fit_cases.Case.from_json(case.to_json())
        np.testing.assert_array_equal(again.joints_m, case.joints_m)
        # Degrees and back: a few roundings of angles below pi.
        for joint in JOINT_NAMES:
            np.testing.assert_allclose(
                again.pose.angles(joint).degrees(), case.pose.angles(joint).degrees(), atol=1e-12
            )
        assert (again.letter, again.shape, again.alpha) == (case.letter, case.shape, case.alpha)
    assert case.letter is None
    assert case.handedness == "left"


def test_a_rig_has_other_proportions_and_the_bones_of_the_pose() -> None:
    case = drawn(RIG)
    assert case.kind == "rig"
    joints_m = posed_skeleton(case.pose, case.shape).joints_m
    turned_m = joints_m @ case.transform[:3, :3].T
    lengths = []
    for one, other in ((6, 7), (11, 12), (16, 17), (21, 22)):  # first phalanges
        bone, mine = (j[other] - j[one] for j in (turned_m, case.joints_m))
        cosine = bone @ mine / np.linalg.norm(bone) / np.linalg.norm(mine)
        assert cosine == pytest.approx(1.0, abs=1e-9)
        lengths.append(np.linalg.norm(mine) / np.linalg.norm(bone))
    low, high = hand_fit_cases.RIG_STRETCH
    assert np.all((low <= np.array(lengths)) & (np.array(lengths) <= high))
    assert abs(np.array(lengths) - 1.0).min() > 1e-3


def test_poses_around_a_letter_are_possible_and_not_the_letter() -> None:
    rng = np.random.default_rng(5)
    mean = pose_by_name("V")
    changes = []
    for _ in range(8):
        pose = hand_fit_cases.pose_around("V", AVERAGE, rng)
        digits = [o for o in overlaps(pose) if "palm" not in o.parts]
        # The letter's own digits penetrate by less.
        assert digits[0].depth_m <= MOST_OVERLAP_M
        for joint, angles in pose.joints.items():
            for angle, (low, high) in zip(
                angles.degrees(), LIMITS_DEG[joint].values(), strict=True
            ):
                assert low - 1e-7 <= angle <= high + 1e-7
        bent = "index-finger-phalanx-proximal"
        changes.append(pose.angles(bent).degrees()[0] - mean.angles(bent).degrees()[0])
    # 8 deviates of 12 degrees: their RMS is between 4 and 22 degrees but once in a thousand times
    # on either side (chi squared of 8).
    assert 4.0 < np.sqrt(np.mean(np.square(changes))) < 22.0


def test_the_priors_mean_of_an_unperturbed_letter_is_the_truth() -> None:
    case = drawn(24, null=True)
    found = hand_fit.prior_mean(case, None, case.letter)
    np.testing.assert_allclose(found["joints_mm"], 0.0, atol=1e-9)


def test_a_run_makes_what_is_asked_for_and_keeps_what_is_there(tmp_path: Path) -> None:
    for name in ("cases", "results"):
        (tmp_path / name).mkdir()
    case = drawn(24, null=True)
    image_path, record_path = hand_fit_cases.paths(tmp_path / "cases", 24)
    grid = VoxelGrid((0.0, 0.0, 0.3), (2e-3, 2e-3, 2e-3), (2, 2, 2))
    save_volume(image_path, Volume(np.ones(grid.shape, np.complex64), grid))
    record_path.write_text(case.to_json())
    asked = (tmp_path, 24, True, hand_fit_cases.DEVELOPMENT_SEED)
    assert "mean 0.0 0.0" in hand_fit.run_case(*asked, only=["mean"])
    first = json.loads((tmp_path / "results" / "24.json").read_text())
    hand_fit.run_case(*asked, only=["mean"])
    assert hand_fit.records(tmp_path) == [first]
    assert "fit" not in first
    # No hand is in that image, which is a result of the estimator.
    hand_fit.run_case(*asked, only=["mean", "rigid"])
    (second,) = hand_fit.records(tmp_path)
    assert second["mean"] == first["mean"]
    assert "could not align" in second["rigid"]["failure"]


def record(number: int, tips_mm: float, **changes: Any) -> dict[str, Any]:
    fit = {
        "tips_mm": [tips_mm] * 5,
        "joints_mm": [0.5 * tips_mm] * 25,
        "tip_std_mm": [2.0] * 4 + [6.0],
        "told": [True] * 4 + [False],
        "at_mm": [[0.0, 0.0, 300.0]] * 5,
        "overlap": 0.95,
        "deviance": 100.0,
        "time_s": 10.0,
    }
    truth = dict(fit, deviance=90.0, at_mm=[[tips_mm, 0.0, 300.0]] * 5)
    truth["limit_mm2"] = [np.diag([tips_mm**2] * 3).tolist()] * 5
    case = {"number": number, "kind": "alpha", "letter": "F", "lowest_alpha": 0.4}
    return case | {"fit": fit, "truth": truth} | changes


def test_the_table_counts_what_is_there() -> None:
    failed = {"failure": "could not fit", "time_s": 1.0}
    records = [
        record(0, 1.0), record(1, 3.0), record(2, 5.0), record(3, 9.0, lowest_alpha=0.1),
        record(4, 0.5, kind="null"), record(5, 1.0, fit=failed),
    ]  # fmt: skip
    text = hand_fit_table.table(records)
    row = next(line for line in text.splitlines() if line.startswith("letter, alpha >= 0.3"))
    assert row.split("|")[0].split()[-2:] == ["4", "1"]  # cases, refused
    assert row.split("|")[1].split() == ["3.0", "5.0", "(", "15)"]
    assert row.split("|")[2].split() == ["3.0", "5.0", "(", "12)", "80%"]
    # Within 2 sd: all tips of 1 and 3 mm; of 5 mm the tip with 6 mm alone.
    assert row.split("|")[6].split() == ["73%", "(", "15)"]
    last = next(line for line in text.splitlines()[::-1] if line.startswith("letter, alpha >= 0.3"))
    assert last.endswith("0 of 3")
    assert last.split("|")[-2].split()[2:] == ["(", "20)"]  # refused or not, the truth has a limit
    assert hand_fit_table.missed(records[3])
    assert hand_fit_table.missed(records[5]) is None


def test_what_information_allows_has_the_law_of_its_covariances() -> None:
    """Isotropic ones: Maxwell's; along one direction: the normal distribution's; of draws, the
    standard error of a median is 1.25 / sqrt(80 000) = 0.4 %, and that of 95 % 0.7 %."""
    many = np.ones((40, 1, 1))
    isotropic, along_z = 4.0 * np.eye(3), np.diag([0.0, 0.0, 9.0])
    for covariance, median, most in (
        (isotropic, 2 * 1.5382, 2 * 2.7955),
        (along_z, 3 * 0.6745, 3 * 1.9600),
    ):
        lengths = hand_fit_table.allowed(many * covariance)
        assert np.median(lengths) == pytest.approx(median, rel=0.02)
        assert np.quantile(lengths, 0.95) == pytest.approx(most, rel=0.02)
    # Half of the tips hidden: the pooled 95 % is theirs.
    pooled = hand_fit_table.allowed(np.concatenate([many, 100.0 * many]) * np.eye(3))
    assert np.quantile(pooled, 0.95) == pytest.approx(10 * 2.5003, rel=0.02)


def test_any_part_of_a_run_has_all_kinds() -> None:
    order = hand_fit.order(hand_fit_cases.N_CASES, hand_fit_cases.N_NULLS)
    assert sorted(order) == list(range(hand_fit_cases.N_CASES + hand_fit_cases.N_NULLS))
    first = order[:22]
    assert sum(number >= hand_fit_cases.N_CASES for number in first) == 2
    free = {k for k in first if k < hand_fit_cases.N_CASES and hand_fit_cases.is_free(k)}
    assert len(free) == 3
