"""How exactly `calibration.fit_hand` finds a posed hand, on measurements whose truth is known.

    python benchmarks/hand_fit.py FOLDER [--workers N] [--cases N] [--table]

Sixty cases with seeds of their own (`hand_fit_cases.py`) and six null cases. Each is fitted from
the letter around which its pose was drawn, or from all letters where it is free; next to that are
the letter moved rigidly (`calibration.align_mesh`), the prior's mean (the letter on the true palm)
and the fit that starts at the truth and searches for nothing, which shows what the search misses.
FOLDER keeps the images in `cases` and a JSON record of every case in `results`: a run that is
stopped goes on where it was, and `--table` prints the table of what is there.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from hand_fit_cases import (
    BENCHMARK_SEED,
    N_CASES,
    N_NULLS,
    Case,
    load_case,
    make_case,
    text,
)
from hand_fit_table import table

import clradar
from calibration import HandFit, align_mesh, fit_hand
from calibration.hand_fit.certainty import certainty, information_at, joints_at
from calibration.hand_fit.descent import HandFitter, fitted_parameters
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.result import TIPS
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.mesh_pose import depth_for_mesh
from calibration.registration.radar import Radar
from calibration.registration.rigid_motion import kabsch
from clradar.errors import CompareError
from clradar.hand import hand_mesh, pose_by_name, posed_skeleton
from clradar.hand.shape import AVERAGE

PALM = (0, 6, 11, 16, 21)
"""Wrist and knuckles in `clradar.hand.JOINT_NAMES`."""

FIT_SEED = 500


def errors(case: Case, joints_m: np.ndarray) -> dict[str, Any]:
    """Distances of joints, (25, 3), from the true ones, and where the tips are."""
    apart_mm = 1e3 * np.linalg.norm(joints_m - case.joints_m, axis=1)
    tips = list(TIPS)
    return {
        "tips_mm": apart_mm[tips].tolist(),
        "joints_mm": apart_mm.tolist(),
        "at_mm": (1e3 * joints_m[tips]).tolist(),
    }


def record_of(case: Case, found: HandFit) -> dict[str, Any]:
    return errors(case, found.joints_m) | {
        "tip_std_mm": (1e3 * found.tip_std_m).tolist(),
        "joint_std_mm": (1e3 * found.joint_std_m).tolist(),
        "told": found.told_tips.tolist(),
        "untold": list(found.untold),
        "overlap": found.overlap,
        "likeness": found.likeness,
        "alpha": found.alpha,
        "deviance": found.deviance,
        "converged": found.converged,
        "start": found.start,
        "remarks": list(found.remarks()),
        "basins": [
            {"start": b.start, "deviance": b.deviance, **errors(case, b.joints_m)}
            for b in found.basins
        ],
    }


def fitted(case: Case, volume: clradar.Volume, start: str) -> dict[str, Any]:
    found = fit_hand(
        volume,
        start,
        handedness=case.handedness,
        fit_shape=case.kind != "null",
        seed=FIT_SEED + case.number,
    )
    return record_of(case, found)


def from_truth(case: Case, volume: clradar.Volume, start: str) -> dict[str, Any]:
    """The descent from the truth, with the prior of the fit from `start` and without a search.

    `limit_mm2`, (5, 3, 3), is the covariance of the tips that information and prior have at the
    truth itself.
    """
    opened = clradar.open_device()
    fitter = HandFitter(
        ParametricHand(case.handedness, opened),
        depth_for_mesh(volume, None),
        Radar.of("hand_fit", None, None).aperture,
        opened,
        fitted_parameters(case.kind != "null"),
    )
    mean = HandState(pose_by_name(start), AVERAGE, case.transform)
    prior = Prior.about(mean, angle_covariance())
    truth = HandState(case.pose, case.shape, case.transform)
    seed = FIT_SEED + case.number
    found = fitter.descend(truth, initial_log_brightness(), prior, seed=seed)
    # Brightness alone is fitted there.
    there = fitter.judged(replace(found, state=truth), prior, seed=seed + 1000)
    told = replace(information_at(fitter, there, prior, seed + 1000), widening=1.0)
    limit = certainty(fitter, there, prior, seed + 1000, told)
    found = fitter.judged(found, prior, seed=seed + 1000)
    known = certainty(fitter, found, prior, seed + 1000)
    return errors(case, joints_at(fitter, found.state)) | {
        "tip_std_mm": (1e3 * known.joint_std_m[list(TIPS)]).tolist(),
        "limit_mm2": (1e6 * limit.joint_covariance_m2[list(TIPS)]).tolist(),
        "deviance": found.deviance,
    }


def rigid_only(case: Case, volume: clradar.Volume, start: str) -> dict[str, Any]:
    """The mesh of the letter, moved onto the image, however little of that it explains."""
    mesh = hand_mesh(start, handedness=case.handedness)
    scene = clradar.Scene.from_mesh(mesh)
    found = align_mesh(
        volume, scene, correct_bias=False, min_inlier_share=1e-3, seed=FIT_SEED + case.number
    )
    return errors(case, _moved(mesh.joints_m, found.transform))


def prior_mean(case: Case, volume: clradar.Volume, start: str) -> dict[str, Any]:
    """The letter with the true shape, its palm where the true one is."""
    mirror = [-1.0 if case.handedness == "left" else 1.0, 1.0, 1.0]
    mean_m = posed_skeleton(pose_by_name(start), case.shape).joints_m * mirror
    palm = list(PALM)
    motion = kabsch(mean_m[palm], case.joints_m[palm], np.ones(len(palm)))
    return errors(case, _moved(mean_m, motion))


def _moved(points_m: np.ndarray, transform: np.ndarray) -> np.ndarray:
    return points_m @ transform[:3, :3].T + transform[:3, 3]


ESTIMATORS: dict[str, Callable[[Case, clradar.Volume, str], dict[str, Any]]] = {
    "fit": fitted,
    "mean": prior_mean,
    "rigid": rigid_only,
    "truth": from_truth,
}
"""In this order: a free pose's other estimates take the letter that the fit started at."""


def run_case(folder: Path, number: int, null: bool, first_seed: int, only: list[str]) -> str:
    """Make a case, estimate what is not known of it, write its record; return a line about it."""
    warnings.simplefilter("ignore", clradar.ClradarWarning)  # remarks are in the record
    make_case(folder / "cases", number, first_seed, null)
    case, volume = load_case(folder / "cases", number)
    path = folder / "results" / f"{number:02d}.json"
    record = json.loads(path.read_text()) if path.exists() else {}
    for name in ("number", "kind", "letter", "handedness", "lowest_alpha", "material", "estimator"):
        record[name] = getattr(case, name)
    start = case.letter or "all"
    for name, estimate in ESTIMATORS.items():
        # Without its fit, a free pose has no letter.
        if name in only and name not in record and (start != "all" or name == "fit"):
            record[name] = timed(lambda: estimate(case, volume, start))  # noqa: B023
            part = path.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps(record, indent=1))
            part.replace(path)
        if name == "fit":
            start = record.get(name, {}).get("start", start)
    return line(case, record)


def timed(estimate: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What an estimator found, or why it failed, with its processor time."""
    start_s = time.process_time()
    try:
        found = estimate()
    except CompareError as failure:
        found = {"failure": str(failure)}
    except Exception:  # one case must not end the run: the table counts it as a failure
        found = {"failure": traceback.format_exc()}
    return found | {"time_s": time.process_time() - start_s}


def line(case: Case, record: dict[str, Any]) -> str:
    said = []
    for name in ESTIMATORS:
        found = record.get(name)
        if found is None:
            continue
        if "failure" in found:
            said.append(f"{name}: {found['failure'].strip().splitlines()[-1]}")
        else:
            tips = " ".join(f"{e:.1f}" for e in found["tips_mm"])
            said.append(f"{name} {tips} ({found['time_s']:.0f} s)")
    return f"{text(case)[:40]} | " + " | ".join(said)


def order(n_cases: int, n_nulls: int) -> list[int]:
    """Numbers of the cases, null ones in between: any part of the run has all kinds."""
    every = max(1, n_cases // n_nulls) if n_nulls else n_cases + 1
    numbers = list(range(n_cases))
    for null in range(n_nulls):
        numbers.insert(null * (every + 1) + every // 2, n_cases + null)
    return numbers


def records(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted((folder / "results").glob("*.json"))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cases", type=int, default=N_CASES)
    parser.add_argument("--nulls", type=int, default=N_NULLS)
    parser.add_argument("--number", type=int, nargs="*", help="only these cases")
    parser.add_argument("--only", nargs="*", choices=ESTIMATORS, default=list(ESTIMATORS))
    parser.add_argument("--first-seed", type=int, default=BENCHMARK_SEED)
    parser.add_argument("--table", action="store_true", help="only print the table")
    given = parser.parse_args()
    if not given.table:
        for name in ("cases", "results"):
            (given.folder / name).mkdir(parents=True, exist_ok=True)
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the workers, which are started afresh
        numbers = given.number or order(given.cases, given.nulls)
        with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
            runs = [
                pool.submit(
                    run_case, given.folder, n, n >= given.cases, given.first_seed, given.only
                )
                for n in numbers
            ]
            for done in as_completed(runs):
                print(done.result(), flush=True)
    print(table(records(given.folder)))


if __name__ == "__main__":
    main()
