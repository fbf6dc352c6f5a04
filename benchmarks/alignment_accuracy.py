"""How exactly meshes and images are aligned, on synthetic measurements whose truth is known.

    python benchmarks/alignment_accuracy.py [--quick] [--cases N] [--method mesh ...] [--bent]

Ten poses of the hand, moved by up to 20 mm and 15 degrees; alpha 0 to 0.6, drawn for the
measurement and for the simulation apart; 20 dB of signal to noise; another seed for everything.
`quick` is `align_mesh` without the correction of its bias, `mesh` is `align_mesh`, `register` is
`register` with alpha fitted, `same-alpha` is `register` with the measurement's alpha, and `volume`
is `align` of a volume simulated where the mesh was given. With `--bent` the measured hand has three
fingers bent otherwise by 15 degrees, and the truth is the pose of its palm.
Prints a table and writes ``benchmarks/alignment_accuracy.json``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from alignment_pairs import (
    ALPHAS,
    SAMPLES_PER_MM2,
    bent_otherwise,
    error_of,
    image,
    mesh,
    middle_m,
    random_motion,
)
from hand_poses import poses
from scipy.spatial.transform import Rotation

import clradar
from calibration import Alignment, align, align_mesh, register
from clradar.errors import CompareError

METHODS = ("quick", "mesh", "register", "same-alpha", "volume")
OTHERS = ("box", "sphere", "left", "tilted box")
SPACING_M = 2e-3
FIRST_SEED = 10_000


def run_case(
    case: int, names: list[str], methods: list[str], bent: bool = False
) -> list[dict[str, Any]]:
    rng = np.random.default_rng(FIRST_SEED + case)
    name = names[case % len(names)]
    scene = mesh(name)
    truth = random_motion(scene, rng)
    alphas = ALPHAS if name in poses() else ALPHAS[2:]  # a box that is specular may show nothing
    alpha, other_alpha = (float(rng.choice(alphas)) for _ in range(2))
    shown, palm = bent_otherwise(name, rng) if bent else (scene, np.eye(4))
    measured = image(shown.transformed(truth).with_alpha(alpha), FIRST_SEED + case, SPACING_M)
    truth = truth @ palm
    rows = []
    for method in methods:
        start_s = time.perf_counter()
        row: dict[str, Any] = {"case": case, "object": name, "alpha": alpha, "method": method}
        try:
            found = aligned(method, measured, scene, alpha, other_alpha, case)
        except CompareError as failure:
            row["failure"] = str(failure)
        else:
            error = error_of(found.transform, truth, middle_m(scene))
            row |= {
                "position_mm": error.position_mm,
                "rotation_deg": error.rotation_deg,
                "ratio": ratios(found, truth),
                "inlier_share": found.inlier_share,
                "likeness": found.likeness,
                "overlap": found.overlap,
                "rms_mm": 1e3 * found.rms_m,
                "converged": found.converged,
                "residual_ratio": found.residual_ratio,
                "remarks": len(found.remarks()),
                "degenerate": list(found.degenerate_directions),
            }
        row["time_s"] = time.perf_counter() - start_s
        print(row_text(row), flush=True)
        rows.append(row)
    return rows


def aligned(
    method: str,
    measured: clradar.Volume,
    scene: clradar.Scene,
    alpha: float,
    other_alpha: float,
    case: int,
) -> Alignment:
    seed = 2 * FIRST_SEED + 100 * case
    if method in ("quick", "mesh"):
        return align_mesh(measured, scene, correct_bias=method == "mesh", seed=seed)
    if method == "volume":
        simulated = image(scene.with_alpha(other_alpha), seed, SPACING_M, None)
        return align(measured, simulated)
    found = register(
        measured,
        scene.with_alpha(alpha),
        fit_alpha=method == "register",
        samples_per_mm2=SAMPLES_PER_MM2,
        seed=seed,
    )
    return found.alignment


def ratios(found: Alignment, truth: np.ndarray) -> list[float]:
    """Return the error over its standard deviation: three rotations, three shifts."""
    off = truth @ np.linalg.inv(found.transform)
    shift = off[:3, :3] @ found.centre_m + off[:3, 3] - found.centre_m
    error = np.concatenate([Rotation.from_matrix(off[:3, :3]).as_rotvec(), shift])
    return list(error / np.sqrt(np.diag(found.covariance)))


def row_text(row: dict[str, Any]) -> str:
    head = f"{row['case']:4d} {row['object']:8s} alpha {row['alpha']:.2f} {row['method']:10s}"
    if "failure" in row:
        return f"{head} {row['failure']}"
    tail = "" if row["converged"] else " NOT converged"
    like = "" if row["likeness"] is None else f", likeness {row['likeness']:.2f}"
    if row["overlap"] is not None:
        like += f", overlap {row['overlap']:.2f}"
    if row["residual_ratio"] is not None:
        like += f", residuals {row['residual_ratio']:.1f} x noise"
    return (
        f"{head} {row['position_mm']:6.2f} mm {row['rotation_deg']:6.2f} deg, inliers "
        f"{row['inlier_share']:.2f}{like}, {row['time_s']:.0f} s{tail}"
    )


def print_summary(rows: list[dict[str, Any]]) -> None:
    print(f"{'':34s} position (mm)     rotation (deg)    error / std, share within 1 and 2")
    print(f"{'method':12s}{'alpha':8s}{'runs':>5s}{'failed':>7s}   median   95 %   median   95 %")
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        for label, chosen in [("all", mine)] + [
            (f"{a:g}", [r for r in mine if r["alpha"] == a]) for a in ALPHAS
        ]:
            done = [row for row in chosen if "failure" not in row]
            if not done:
                continue
            mm, deg = (np.array([r[k] for r in done]) for k in ("position_mm", "rotation_deg"))
            # Robust: the median of |x| of a Gaussian is 0.674 standard deviations.
            ratios_of = np.abs([r["ratio"] for r in done])
            within = " ".join(f"{np.mean(ratios_of < k):5.0%}" for k in (1, 2))
            ratio = np.median(ratios_of) / 0.6745
            print(
                f"{method:12s}{label:8s}{len(chosen):5d}{len(chosen) - len(done):7d}"
                f"{np.median(mm):9.2f}{np.quantile(mm, 0.95):7.2f}"
                f"{np.median(deg):9.2f}{np.quantile(deg, 0.95):7.2f}{ratio:10.2f} {within}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="five cases, mesh alone")
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--method", choices=METHODS, action="append")
    parser.add_argument("--others", action="store_true", help="boxes, sphere, a left hand instead")
    parser.add_argument("--bent", action="store_true", help="three fingers bent otherwise")
    parser.add_argument(
        "--json", type=Path, default=Path(__file__).with_name("alignment_accuracy.json")
    )
    given = parser.parse_args()
    methods = given.method or (["mesh"] if given.quick else list(METHODS))
    names = list(OTHERS) if given.others else list(poses())
    rows: list[dict[str, Any]] = []
    for case in range(given.first, given.first + (5 if given.quick else given.cases)):
        rows += run_case(case, names, methods, given.bent)
        given.json.write_text(json.dumps(rows, indent=1))
    print_summary(rows)


if __name__ == "__main__":
    main()
