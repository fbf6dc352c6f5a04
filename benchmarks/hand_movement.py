"""How exactly `calibration.fit_hands` follows a moving hand whose truth is known.

    clradar record-hand F flat L --frames 20 --alpha 0.4 --length-mm 178 --breadth-mm 82 \
        --girth 1.04 --shift-mm 10 0 15 --turn-deg 0 15 5 --seed 11 -o moving
    python benchmarks/hand_movement.py moving --pose F,flat,L [--alone 2,8,14]

Prints errors of tips and joints, shape and processor time for every frame; next to that, for the
frames of --alone, those of `fit_hand` from the same starting poses, without a frame before.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from calibration import fit_hand, fit_hands
from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES, vector_of
from calibration.hand_fit.result import TIPS
from clradar.hand import HandShape
from measurement_io import open_recording

TOLD_M = 4e-3


def truth_of(folder: Path) -> tuple[list[np.ndarray], HandShape]:
    """Joints of every frame, and the shape, of a recording of `clradar record-hand`."""
    truth = json.loads((folder / "truth/truth.json").read_text())
    joints_m = [np.array(list(frame["joints_m"].values())) for frame in truth["frames"]]
    lengths = {"finger_lengths": tuple(truth["shape"]["finger_lengths"])}
    return joints_m, HandShape(**(truth["shape"] | lengths))


def row(
    frame: int, how: str, fit: Any, shape: HandShape, joints_m: np.ndarray, true_shape: HandShape,
    cpu_s: float,
) -> dict[str, Any]:  # fmt: skip
    """The errors of a fit; `shape` is the one that it found."""
    apart_mm = 1e3 * np.linalg.norm(fit.joints_m - joints_m, axis=1)
    away = vector_of(shape) - vector_of(true_shape)
    return {
        "frame": frame,
        "how": how,
        "tips_mm": apart_mm[list(TIPS)].round(2).tolist(),
        "tip_std_mm": (1e3 * fit.tip_std_m).round(2).tolist(),
        "joints_mm": round(float(np.median(apart_mm)), 2),
        "shape_percent": dict(zip(SHAPE_NAMES, (100 * away).round(2).tolist(), strict=True)),
        "cpu_s": round(cpu_s, 1),
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Tips and joints over frames: median and 95 %, told tips, coverage, shape, time."""
    tips = np.array([one["tips_mm"] for one in rows]).ravel()
    std = np.array([one["tip_std_mm"] for one in rows]).ravel()
    told = std < 1e3 * TOLD_M
    shape = np.array([list(one["shape_percent"].values()) for one in rows])
    return {
        "frames": len(rows),
        "tips_mm": [round(float(np.percentile(tips, q)), 2) for q in (50, 95)],
        "told_tips_mm": [round(float(np.percentile(tips[told], q)), 2) for q in (50, 95)],
        "told_share": round(float(told.mean()), 2),
        "within_two_std": round(float((tips < 2 * std).mean()), 2),
        "joints_mm": round(float(np.median([one["joints_mm"] for one in rows])), 2),
        "shape_rms_percent": round(float(np.sqrt((shape**2).mean())), 2),
        "cpu_s": round(float(np.mean([one["cpu_s"] for one in rows])), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--pose", default="F,flat,L")
    parser.add_argument("--hand", default="right")
    parser.add_argument("--alone", default="")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    recording = open_recording(chosen.recording)
    joints_m, true_shape = truth_of(chosen.recording)
    poses = chosen.pose.split(",")
    rows, started_s = [], time.process_time()
    for fit, _ in fit_hands(recording, poses, handedness=chosen.hand):
        now_s = time.process_time()
        if fit.state is None:
            print(json.dumps({"frame": fit.frame, "how": fit.how, "notes": fit.notes}), flush=True)
        else:
            at = fit.frame
            rows.append(row(at, fit.how, fit, fit.state.shape, joints_m[at], true_shape,
                            now_s - started_s))  # fmt: skip
            print(json.dumps(rows[-1] | {"notes": fit.notes}), flush=True)
        started_s = time.process_time()
    print(json.dumps({"all": summary(rows)}))
    for how in ("followed", "searched"):
        print(json.dumps({how: summary([one for one in rows if one["how"] == how])}))
    alone = []
    for frame in (int(text) for text in chosen.alone.split(",") if text):
        started_s = time.process_time()
        one = fit_hand(
            recording[frame], poses, handedness=chosen.hand, fit_shape=True, closed_loop=False
        )
        cpu_s = time.process_time() - started_s
        alone.append(row(frame, "alone", one, one.shape, joints_m[frame], true_shape, cpu_s))
        print(json.dumps(alone[-1]), flush=True)
    if alone:
        frames = {one["frame"] for one in alone}
        print(json.dumps({"alone": summary(alone)}))
        both = summary([one for one in rows if one["frame"] in frames])
        print(json.dumps({"the same frames, followed": both}))


if __name__ == "__main__":
    main()
