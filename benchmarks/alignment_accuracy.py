"""How exactly meshes and images are aligned, on synthetic measurements whose truth is known.

    python benchmarks/alignment_accuracy.py [--cases 20] [--method mesh ...] [--bent]

Hands in ten poses, moved by up to 20 mm and 15 degrees; alpha 0 to 0.6, drawn for measurement and
simulation apart; 20 dB; another seed for everything. `quick` is `align_mesh` without the correction
of its bias, `mesh` is `align_mesh`, `register` is `register` with alpha fitted, `volume` is `align`
of a volume simulated where the mesh was given. With `--bent` three fingers of the measured hand are
bent otherwise by 15 degrees, and the truth is the pose of its palm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from study import Row, image, middle_m, parser, random_motion, run, summarize, timed

import clradar
from calibration import align, align_mesh, register
from calibration.registration.rigid_motion import kabsch
from clradar.hand import JOINT_NAMES, POSES, hand_mesh

NAMES = ("flat", "F", "L", "V", "W", "Y", "B", "C", "5", "S")
METHODS = ("quick", "mesh", "register", "volume")
ALPHAS = (0.0, 0.15, 0.3, 0.45, 0.6)
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.24, 0.36), 2e-3)
RAYS = {"estimator": "stochastic", "samples_per_mm2": 6.0, "rays_per_sample": 4}
KNUCKLES = [f"{finger}-finger-phalanx-proximal" for finger in ("index", "middle", "ring", "pinky")]


def bent_otherwise(name: str, rng: np.random.Generator) -> tuple[clradar.Scene, np.ndarray]:
    """A hand with three fingers bent otherwise by 15 degrees, and the motion of its palm."""
    pose = POSES[name]
    chosen = rng.choice(KNUCKLES, 3, replace=False)
    by_rad = np.radians(15.0) * rng.choice([-1, 1])
    # Where a knuckle cannot bend further, the other way.
    if any(pose.joints[bone].flexion_rad + by_rad > np.radians(95.0) for bone in chosen):
        by_rad = -by_rad
    joints = {
        bone: replace(angles, flexion_rad=angles.flexion_rad + by_rad * (bone in chosen))
        for bone, angles in pose.joints.items()
    }
    before, after = hand_mesh(pose), hand_mesh(replace(pose, joints=joints))
    palm = [JOINT_NAMES.index(joint) for joint in ("wrist", *KNUCKLES)]
    motion = kabsch(before.joints_m[palm], after.joints_m[palm], np.ones(len(palm)))
    return clradar.Scene.from_mesh(after), motion


def aligned(
    method: str, measured: clradar.Volume, scene: clradar.Scene, truth: np.ndarray, seed: int
) -> Row:
    if method in ("quick", "mesh"):
        found = align_mesh(measured, scene, correct_bias=method == "mesh", seed=seed)
    elif method == "volume":
        found = align(measured, image(scene, GRID, seed, None, **RAYS))
    else:
        found = register(measured, scene, fit_alpha=True, seed=seed, samples_per_mm2=6.0).alignment
    off = truth @ np.linalg.inv(found.transform)
    shift = off[:3, :3] @ found.centre_m + off[:3, 3] - found.centre_m
    turn = Rotation.from_matrix(off[:3, :3]).as_rotvec()
    at = (truth @ [*middle_m(scene), 1.0] - found.transform @ [*middle_m(scene), 1.0])[:3]
    return {
        "position_mm": 1e3 * float(np.linalg.norm(at)),
        "rotation_deg": float(np.degrees(np.linalg.norm(turn))),
        "error_over_std": np.abs(
            np.concatenate([turn, shift]) / np.sqrt(np.diag(found.covariance))
        ).tolist(),
        "converged": found.converged,
    }


def main() -> None:
    options = parser(__doc__ or "", 20, 10_000)
    options.add_argument("--method", choices=METHODS, action="append")
    options.add_argument("--bent", action="store_true", help="three fingers bent otherwise")
    given = options.parse_args()

    def one(case: int) -> list[Row]:
        seed, name = given.first_seed + case, NAMES[case % len(NAMES)]
        rng = np.random.default_rng(seed)
        scene = clradar.Scene.from_mesh(hand_mesh(name))
        truth = random_motion(scene, rng)
        alpha, other_alpha = (float(rng.choice(ALPHAS)) for _ in range(2))
        shown, palm = bent_otherwise(name, rng) if given.bent else (scene, np.eye(4))
        measured = image(shown.transformed(truth).with_alpha(alpha), GRID, seed, **RAYS)
        rows = []
        for method in given.method or METHODS:
            start = scene.with_alpha(other_alpha)
            found = timed(lambda: aligned(method, measured, start, truth @ palm, 2 * seed))  # noqa: B023
            rows.append({"pose": name, "alpha": alpha, "method": method, **found})
        return rows

    groups = {m: lambda row, m=m: row["method"] == m for m in given.method or METHODS}
    keys = ("position_mm", "rotation_deg", "error_over_std", "time_s")
    summarize(run(given, one), groups, *keys)


if __name__ == "__main__":
    main()
