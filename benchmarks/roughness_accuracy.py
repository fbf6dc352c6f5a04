"""How exactly the sweep finds roughness, on synthetic measurements whose truth is known.

    python benchmarks/roughness_accuracy.py --work DIR [--scene NAME ...] [--cases N] [--json FILE]

Flat plates tilted by 5, 12 and 25 degrees, a ball, the default hand as a whole, and palm and
fingers of that hand apart. Heights are drawn with g = (2 k h)^2 between 0.2 and 3 at 77 GHz,
lengths between 1.5 and 5 mm, both evenly over their logarithms; 20 dB of signal to noise; a gain
that the sweep is not told. Seeds of the measurements are fixed (`FIRST_SEED` on), and none is a
simulation's. The measurements of one object are judged by the same simulations. DIR keeps what was
simulated, so that the program can be stopped and begun again. Prints a table, with how often
the truth is in the intervals of 68 and 95 %.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import clradar
from calibration import Regions, RoughnessSweep, sweep_roughness
from clradar.hand import hand_mesh
from clradar.jobs.job import FolderStore
from measurement_io import open_capture, save_capture

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
K = 2 * np.pi * 77e9 / 299_792_458.0
HEIGHTS_M = np.linspace(0.08e-3, 0.68e-3, 6)
LENGTHS_M = np.array([1.2e-3, 2e-3, 3e-3, 4.5e-3, 6e-3])
SEEDS = 2
FIRST_SEED = 10_000
G_RANGE, LENGTH_RANGE_M = (0.2, 3.0), (1.5e-3, 5e-3)
SNR_DB, GAIN = 20.0, 7.3
OFF_M, OFF_DEG = 0.5e-3, 0.5
"""Of the misplaced measurements."""


@dataclass(frozen=True)
class Object:
    """What is measured."""

    scene: clradar.Scene
    regions: Regions | None = None


def plate(tilt_deg: float) -> Object:
    """A plate of 60 mm, 0.3 m away, tilted about an axis that is none of the array's."""
    mesh = trimesh.creation.box((0.06, 0.06, 1e-4))
    mesh.update_faces(mesh.face_normals[:, 2] < -0.5)
    matrix = np.eye(4)
    axis = np.array([np.sin(0.44), np.cos(0.44), 0.0])
    matrix[:3, :3] = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix()
    matrix[2, 3] = 0.3
    return Object(clradar.Scene.from_mesh(mesh).transformed(matrix))


def ball() -> Object:
    mesh = trimesh.creation.icosphere(5, 0.04).apply_translation((0.0, 0.0, 0.34))
    return Object(clradar.Scene.from_mesh(mesh))


def hand(apart: bool = False) -> Object:
    mesh = hand_mesh("F")
    scene = clradar.Scene.from_mesh(mesh)
    return Object(scene, Regions.of_fingers(scene, mesh.joints_m) if apart else None)


OBJECTS: dict[str, Callable[[], Object]] = {
    "plate 5": lambda: plate(5.0),
    "plate 12": lambda: plate(12.0),
    "plate 25": lambda: plate(25.0),
    "ball": ball,
    "hand": hand,
    "palm and fingers": lambda: hand(True),
}


def truth(rng: np.random.Generator) -> tuple[float, float]:
    """Height and length, metres."""
    g = G_RANGE[0] * (G_RANGE[1] / G_RANGE[0]) ** rng.uniform()
    return np.sqrt(g) / (2 * K), np.exp(rng.uniform(*np.log(LENGTH_RANGE_M)))


def rough(height_m: float, length_m: float) -> clradar.Material:
    return clradar.Material(
        f"rough {1e3 * height_m:.3f} {1e3 * length_m:.3f}", conductor=True,
        roughness_rms_m=height_m, correlation_length_m=length_m,
    )  # fmt: skip


def misplaced(scene: clradar.Scene, rng: np.random.Generator) -> clradar.Scene:
    """Moved by OFF_M and turned by OFF_DEG about its middle, in a direction drawn."""
    offset, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(OFF_DEG) * axis).as_matrix()
    middle_m = scene.vertices_m.mean(axis=0)
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = middle_m - turn @ middle_m + OFF_M * offset
    return scene.transformed(matrix)


def measured(
    folder: Path, own: Object, name: str, case: int, off: bool
) -> tuple[clradar.Capture, list[tuple[float, float]]]:
    """A held-out measurement, and the truth of each region."""
    seed = FIRST_SEED + 100 * list(OBJECTS).index(name) + case
    rng = np.random.default_rng(seed)
    regions = own.regions
    truths = [truth(rng) for _ in range(1 if regions is None else len(regions.names))]
    materials = [rough(*one) for one in truths]
    scene = own.scene
    if regions is None:
        scene = scene.with_material(materials[0])
    else:
        scene = scene.with_material([materials[i] for i in regions.face])
    path = folder / f"{name.replace(' ', '-')}-{case}{'-off' if off else ''}.h5"
    if not path.exists():
        placed = misplaced(scene, rng) if off else scene
        clean = clradar.simulate(placed, ARRAY, WAVEFORM, estimator="physical", seed=seed)
        noisy = clradar.impair(clean, snr_db=SNR_DB, seed=seed)
        save_capture(path, clradar.Capture(GAIN * noisy.data, ARRAY, WAVEFORM))
    return open_capture(path), truths


def rows_of(name: str, found: RoughnessSweep, truths: list[tuple[float, float]]) -> list[Any]:
    """One record per region."""
    rows = []
    for one, (height_m, length_m) in zip(found.estimates, truths, strict=True):
        h, length, slope = one.roughness_m, one.correlation_m, one.slope
        true_slope = np.sqrt(2) * height_m / length_m
        rows.append(
            {
                "object": name,
                "region": one.name,
                "g": (2 * K * height_m) ** 2,
                "h_mm": 1e3 * height_m,
                "l_mm": 1e3 * length_m,
                "text": one.text(),
                "tells": [one.tells_roughness, one.tells_correlation, one.tells_slope],
                "h_ratio": h.median / height_m,
                "h_std_share": h.std / height_m,
                "h_in_68": h.low <= height_m <= h.high,
                "h_in_95": h.low95 <= height_m <= h.high95,
                "l_ratio": length.median / length_m,
                "l_in_68": length.low <= length_m <= length.high,
                "slope_ratio": slope.median / true_slope,
                "slope_in_68": slope.low <= true_slope <= slope.high,
                "fit_probability": one.fit_probability,
            }
        )
    return rows


def summary(rows: list[dict[str, Any]], label: str) -> str:
    error = np.abs(np.array([row["h_ratio"] for row in rows]) - 1)
    length = np.abs(np.log([row["l_ratio"] for row in rows]))
    slope = np.abs(np.log([row["slope_ratio"] for row in rows]))
    within = {key: np.mean([row[key] for row in rows]) for key in ("h_in_68", "h_in_95", "l_in_68")}
    return (
        f"| {label} | {len(rows)} | {np.median(error):.1%} | {np.quantile(error, 0.9):.1%} | "
        f"{np.mean(error < 0.2):.0%} | {np.median([row['h_std_share'] for row in rows]):.1%} | "
        f"{within['h_in_68']:.0%} | {within['h_in_95']:.0%} | {np.expm1(np.median(length)):.1%} | "
        f"{within['l_in_68']:.0%} | {np.expm1(np.median(slope)):.1%} |"
    )


HEADER = (
    "| object | cases | error of h, median | 90 % | within 20 % | stated u | in 68 % | in 95 % "
    "| error of l, median | in 68 % | error of slope |\n" + 11 * "|---" + "|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--scene", nargs="*", choices=list(OBJECTS), default=list(OBJECTS))
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--calibrated", action="store_true")
    parser.add_argument("--off", action="store_true", help="measurements are misplaced")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.work.mkdir(exist_ok=True)
    # Reasons for doubt are no news here.
    warnings.simplefilter("ignore", clradar.ClradarWarning)
    rows: list[dict[str, Any]] = []
    for name in options.scene:
        own = OBJECTS[name]()
        # With regions or without, a scene has the same simulations.
        store = FolderStore(options.work / ("hand" if own.regions else name.replace(" ", "-")))
        for case in range(options.cases):
            capture, truths = measured(options.work, own, name, case, options.off)
            if options.calibrated:
                capture = clradar.Capture(capture.data / GAIN, ARRAY, WAVEFORM)
            found = sweep_roughness(
                capture, own.scene, HEIGHTS_M, LENGTHS_M, seeds=SEEDS, regions=own.regions,
                calibrated=options.calibrated, store=store,
            )  # fmt: skip
            rows += rows_of(name, found, truths)
            for row in rows[-len(truths) :]:
                true = f"h {row['h_mm']:.3f} mm, l {row['l_mm']:.2f} mm, g {row['g']:.2f}"
                print(f"{name} {case} {row['region']}: {true}: {row['text']}", flush=True)
    print(HEADER)
    for name in options.scene:
        print(summary([row for row in rows if row["object"] == name], name))
    print(summary(rows, "all"))
    told = [row for row in rows if row["tells"][0]]
    if told:
        print(summary(told, "all where h is told"))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1, default=float))


if __name__ == "__main__":
    main()
