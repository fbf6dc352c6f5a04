"""What the accuracy studies share: the imager, drawn motions, rows that are printed and kept."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from core.work import ARRAY, WAVEFORM
from scipy.spatial.transform import Rotation

import clradar
from clradar.errors import CompareError

SNR_DB = 20.0

Row = dict[str, Any]


def parser(text: str, cases: int, first_seed: int) -> argparse.ArgumentParser:
    """Options of every study: how many cases, from which seed, and where rows are kept."""
    made = argparse.ArgumentParser(description=text.splitlines()[0])
    made.add_argument("--cases", type=int, default=cases)
    made.add_argument("--first-seed", type=int, default=first_seed)
    made.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    made.add_argument("--json", type=Path, help="rows, written after each case")
    return made


def run(given: argparse.Namespace, one: Callable[[int], list[Row]]) -> list[Row]:
    """The rows of all cases; each is printed, and kept, as it is done."""
    rows: list[Row] = []
    for number in given.only or range(given.cases):
        for row in one(number):
            rows.append({"case": number, **row})
            print("  ".join(f"{k} {_text(v)}" for k, v in rows[-1].items()), flush=True)
        if given.json is not None:
            given.json.write_text(json.dumps(rows, indent=1, default=float))
    return rows


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return " ".join(f"{v:.1f}" for v in value) if isinstance(value, list) else str(value)


def timed(estimate: Callable[[], Row]) -> Row:
    """What was found, or why nothing was, with the processor time."""
    start_s = time.process_time()
    try:
        found = estimate()
    except CompareError as failure:
        found = {"failure": str(failure)}
    return found | {"time_s": time.process_time() - start_s}


def summarize(rows: list[Row], groups: Mapping[str, Callable[[Row], bool]], *keys: str) -> None:
    """Print of each group median, 95 % and maximum of numbers, and how often a truth holds."""
    for name, chosen in groups.items():
        mine = [row for row in rows if chosen(row)]
        refused = sum("failure" in row for row in mine)
        texts = [f"{key} {_summary(mine, key)}" for key in keys]
        print(f"{name}, {len(mine)} ({refused} refused): {'; '.join(texts)}")


def _summary(rows: list[Row], key: str) -> str:
    values = np.concatenate([np.ravel(row[key]) for row in rows if key in row] or [np.empty(0)])
    if not values.size:
        return "-"
    if values.dtype == bool:
        return f"{values.mean():.1%}"
    return f"{np.median(values):.2f}, {np.quantile(values, 0.95):.2f}, {values.max():.2f}"


def middle_m(scene: clradar.Scene) -> np.ndarray:
    """The centre of the bounding box, shape (3,), metres."""
    return 0.5 * (scene.vertices_m.min(axis=0) + scene.vertices_m.max(axis=0))


def random_motion(
    scene: clradar.Scene, rng: np.random.Generator, most_deg: float = 15.0, most_m: float = 20e-3
) -> np.ndarray:
    """A rigid motion, (4, 4): both axes uniform over the sphere, both sizes up to the most."""
    axis, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    size_deg, size_m = rng.uniform(0.0, (most_deg, most_m))
    motion, at = np.eye(4), middle_m(scene)
    motion[:3, :3] = Rotation.from_rotvec(size_deg * axis, degrees=True).as_matrix()
    motion[:3, 3] = at - motion[:3, :3] @ at + size_m * shift
    return motion


def image(
    scene: clradar.Scene,
    grid: clradar.VoxelGrid,
    seed: int,
    snr_db: float | None = SNR_DB,
    **settings: Any,
) -> clradar.Volume:
    """The image of a scene, with noise."""
    capture = clradar.simulate(scene, ARRAY, WAVEFORM, seed=seed, **settings)
    if snr_db is not None:
        capture = clradar.impair(capture, snr_db=snr_db, seed=seed)
    return clradar.backproject(capture, grid)
