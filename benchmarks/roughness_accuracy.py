"""How exactly the sweep finds roughness, on synthetic measurements whose truth is known.

    python benchmarks/roughness_accuracy.py --work DIR [--scene NAME ...] [--cases N] [--json FILE]

Flat plates tilted by 5, 12 and 25 degrees, a ball, the default hand as a whole, and palm and
fingers of that hand apart. Heights are drawn with g = (2 k h)^2 between 0.2 and 3 at 77 GHz,
lengths between 1.5 and 5 mm, both evenly over their logarithms; 20 dB of signal to noise; a gain
that the sweep is not told. Seeds of the measurements are fixed (`--first-seed` on), and none is a
simulation's. The measurements of one object are judged by the same simulations, which DIR keeps.
Prints a table, with how often the truth is in the intervals of 68 and 95 %.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from study import ARRAY, SNR_DB, WAVEFORM, Row, parser, run, summarize

import clradar
from calibration import Regions, RoughnessSweep, sweep_roughness
from clradar.hand import hand_mesh
from clradar.jobs.job import FolderStore

K = 2 * np.pi * 77e9 / 299_792_458.0
HEIGHTS_M = np.linspace(0.08e-3, 0.68e-3, 6)
LENGTHS_M = np.array([1.2e-3, 2e-3, 3e-3, 4.5e-3, 6e-3])
SEEDS = 2
G_RANGE, LENGTH_RANGE_M = (0.2, 3.0), (1.5e-3, 5e-3)
GAIN = 7.3


def plate(tilt_deg: float) -> clradar.Scene:
    """A plate of 60 mm, 0.3 m away, tilted about an axis that is none of the array's."""
    mesh = trimesh.creation.box((0.06, 0.06, 1e-4))
    mesh.update_faces(mesh.face_normals[:, 2] < -0.5)
    matrix = np.eye(4)
    axis = np.array([np.sin(0.44), np.cos(0.44), 0.0])
    matrix[:3, :3] = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix()
    matrix[2, 3] = 0.3
    return clradar.Scene.from_mesh(mesh).transformed(matrix)


def ball() -> clradar.Scene:
    mesh = trimesh.creation.icosphere(5, 0.04).apply_translation((0.0, 0.0, 0.34))
    return clradar.Scene.from_mesh(mesh)


def hand() -> clradar.Scene:
    return clradar.Scene.from_mesh(hand_mesh("F"))


APART = "palm and fingers"
OBJECTS: dict[str, Callable[[], clradar.Scene]] = {
    **{f"plate {tilt}": partial(plate, tilt) for tilt in (5, 12, 25)},
    "ball": ball, "hand": hand, APART: hand,
}  # fmt: skip


def truth(rng: np.random.Generator) -> tuple[float, float]:
    """Height and length, metres."""
    g = G_RANGE[0] * (G_RANGE[1] / G_RANGE[0]) ** rng.uniform()
    return np.sqrt(g) / (2 * K), np.exp(rng.uniform(*np.log(LENGTH_RANGE_M)))


def rough(height_m: float, length_m: float) -> clradar.Material:
    return clradar.Material(
        f"rough {1e3 * height_m:.3f} {1e3 * length_m:.3f}", conductor=True,
        roughness_rms_m=height_m, correlation_length_m=length_m,
    )  # fmt: skip


def measured(
    scene: clradar.Scene, regions: Regions | None, seed: int
) -> tuple[clradar.Capture, list[tuple[float, float]]]:
    """A held-out measurement, and the truth of each region."""
    rng = np.random.default_rng(seed)
    truths = [truth(rng) for _ in range(1 if regions is None else len(regions.names))]
    materials = [rough(*one) for one in truths]
    scene = scene.with_material([materials[i] for i in regions.face] if regions else materials[0])
    clean = clradar.simulate(scene, ARRAY, WAVEFORM, estimator="physical", seed=seed)
    noisy = clradar.impair(clean, snr_db=SNR_DB, seed=seed)
    return clradar.Capture(GAIN * noisy.data, ARRAY, WAVEFORM), truths


def rows_of(found: RoughnessSweep, truths: list[tuple[float, float]]) -> list[Row]:
    """One record per region; ratios are found over true."""
    rows = []
    for one, (height_m, length_m) in zip(found.estimates, truths, strict=True):
        h, length, slope = one.roughness_m, one.correlation_m, one.slope
        rows.append(
            {
                "region": one.name,
                "h_error": abs(h.median / height_m - 1),
                "h_within_20": abs(h.median / height_m - 1) < 0.2,
                "h_std_share": h.std / height_m,
                "h_in_68": h.low <= height_m <= h.high,
                "h_in_95": h.low95 <= height_m <= h.high95,
                "l_error": abs(np.log(length.median / length_m)),
                "slope_error": abs(np.log(slope.median * length_m / (np.sqrt(2) * height_m))),
                "text": one.text(),
            }
        )
    return rows


def main() -> None:
    options = parser(__doc__ or "", 6, 10_000)
    options.add_argument("--work", type=Path, required=True)
    options.add_argument("--scene", nargs="*", choices=list(OBJECTS), default=list(OBJECTS))
    given = options.parse_args()
    given.work.mkdir(exist_ok=True)
    # Reasons for doubt are no news here.
    warnings.simplefilter("ignore", clradar.ClradarWarning)
    everything: list[Row] = []
    for name in given.scene:
        scene, first = OBJECTS[name](), given.first_seed + 100 * list(OBJECTS).index(name)
        regions = Regions.of_fingers(scene) if name == APART else None
        # With regions or without, a scene has the same simulations.
        store = FolderStore(given.work / ("hand" if regions else name.replace(" ", "-")))
        swept = partial(
            sweep_roughness, scene=scene, roughness_m=HEIGHTS_M, correlation_m=LENGTHS_M,
            seeds=SEEDS, regions=regions, store=store,
        )  # fmt: skip

        def one(case: int) -> list[Row]:
            capture, truths = measured(scene, regions, first + case)  # noqa: B023
            return [{"object": name} | row for row in rows_of(swept(capture), truths)]  # noqa: B023

        everything += run(given, one)
    groups = {n: lambda row, n=n: row["object"] == n for n in given.scene}
    keys = ("h_within_20", "h_in_68", "h_in_95", "h_error", "h_std_share", "l_error", "slope_error")
    summarize(everything, groups | {"all": lambda row: True}, *keys)


if __name__ == "__main__":
    main()
