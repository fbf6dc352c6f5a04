"""How exactly `calibration.fit_hand` finds a posed hand, on measurements whose truth is known.

    python benchmarks/hand_fit.py [--cases 60] [--json rows.json]

Kinds go round: "alpha", a parametric hand; "physical", the same of a drawn material, by the
physical estimator; "rig", a rigged hand of other proportions, with alpha. Poses are drawn 12
degrees around a letter; every sixth is free and fitted from all letters.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from study import Row, image, parser, random_motion, run, summarize, timed

import clradar
from calibration import fit_hand
from calibration.hand_fit.result import TIPS
from clradar.hand import (
    LETTERS,
    POSES,
    HandShape,
    hand_mesh,
    pose_around,
    random_pose,
    random_shape,
)
from clradar.rigs import read_rig

KINDS = ("alpha", "physical", "rig")
GRID = clradar.VoxelGrid.from_extent((-0.12, 0.12), (-0.12, 0.12), (0.19, 0.41), 2e-3)
SPREAD_DEG = 12.0
ALPHAS, LOW_ALPHA = (0.3, 0.6), 0.1
RIG_STRETCH = (0.93, 1.07)


class Case(NamedTuple):
    """What is measured, in the antenna frame."""

    letter: str | None
    side: str
    surface: str
    scene: clradar.Scene
    joints_m: np.ndarray


def rig(shape: HandShape, side: str, rng: np.random.Generator) -> clradar.rigs.Rig:
    """A rigged hand, read from a file: a shape that is stretched along each axis, skinned."""
    sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
    from rig_files import RigMaker

    stretch = rng.uniform(*RIG_STRETCH, 3) * [-1.0 if side == "left" else 1.0, 1.0, 1.0]
    maker = RigMaker(
        shape=shape, turn=np.diag(stretch), local_turns=False, edge_length_m=2.5e-3,
        called=f"{{}}_{side}".format,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        return read_rig(maker.save(Path(folder) / f"{side}.glb"))


def surfaced(scene: clradar.Scene, number: int, rng: np.random.Generator) -> tuple[Any, str]:
    """The scene with its material or alpha, and that in words."""
    if KINDS[number % 3] == "physical":
        rough = replace(
            clradar.material("skin"),
            name="rough skin",
            roughness_rms_m=float(rng.uniform(0.05e-3, 0.25e-3)),
            correlation_length_m=float(rng.uniform(3e-3, 5e-3)),
        )
        chosen = [clradar.material("palm"), rough][number // 3 % 2]
        return scene.with_material(chosen), chosen.name
    dark = number % 10 == 9
    alpha = LOW_ALPHA if dark else float(rng.uniform(*ALPHAS))
    return scene.with_alpha(alpha), f"alpha {alpha:.2f}"


def drawn(number: int, seed: int) -> Case:
    rng = np.random.default_rng(seed)
    side = "left" if number % 4 == 3 else "right"
    letter = None if number // 3 % 6 == 5 else str(LETTERS[int(rng.integers(len(LETTERS)))])
    shape = random_shape(rng)
    pose = random_pose(rng) if letter is None else pose_around(POSES[letter], rng, SPREAD_DEG)
    if KINDS[number % 3] == "rig":
        mesh: Any = rig(shape, side, rng).posed(pose)
    else:
        mesh = hand_mesh(pose, handedness=side, shape=shape)
    scene = clradar.Scene.from_mesh(mesh)
    motion = random_motion(scene, rng)
    scene, surface = surfaced(scene.transformed(motion), number, rng)
    joints_m = mesh.joints_m @ motion[:3, :3].T + motion[:3, 3]
    return Case(letter, side, surface, scene, joints_m)


def errors(case: Case, joints_m: np.ndarray) -> Row:
    apart_mm = 1e3 * np.linalg.norm(joints_m - case.joints_m, axis=1)
    return {"tips_mm": apart_mm[list(TIPS)].tolist(), "joints_mm": float(np.median(apart_mm))}


def fitted(case: Case, volume: clradar.Volume, seed: int) -> Row:
    found = fit_hand(volume, case.letter or "all", handedness=case.side, fit_shape=True, seed=seed)
    made = errors(case, found.joints_m)
    tips_mm = np.array(made["tips_mm"])
    return made | {
        "determined_mm": tips_mm[found.told_tips].tolist(),
        "tips_over_std": (tips_mm / (1e3 * found.tip_std_m)).tolist(),
        "overlap": found.overlap,
        "start": found.start,
    }


def main() -> None:
    given = parser(__doc__ or "", 60, 61_000).parse_args()
    warnings.simplefilter("ignore", clradar.ClradarWarning)

    def one(number: int) -> list[Row]:
        seed = given.first_seed + number
        case, kind = drawn(number, seed), KINDS[number % 3]
        estimator = "physical" if kind == "physical" else "expected"
        volume = image(case.scene, GRID, 1_000_000 + seed, estimator=estimator)
        found = timed(lambda: fitted(case, volume, seed))
        row = {"kind": kind, "letter": case.letter or "any", "surface": case.surface}
        return [row | found]

    rows = run(given, one)
    groups = {
        "letter, parametric": lambda r: r["letter"] != "any" and r["kind"] == "alpha",
        "letter, rigs": lambda r: r["letter"] != "any" and r["kind"] == "rig",
        "letter, physical": lambda r: r["letter"] != "any" and r["kind"] == "physical",
        "any pose": lambda r: r["letter"] == "any",
        "all": lambda r: True,
    }
    keys = ("tips_mm", "determined_mm", "joints_mm", "tips_over_std", "time_s")
    summarize(rows, groups, *keys)


if __name__ == "__main__":
    main()
