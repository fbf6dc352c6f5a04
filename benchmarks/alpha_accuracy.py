"""How exactly the sweep finds alpha, on simulations in place of measurements.

    python benchmarks/alpha_accuracy.py --work DIR [--cases N] [--seeds K] [--step N] [--off-mm D]

The default hand at alpha 0, 0.1 ... 1 with N seeds (12), by the stochastic estimator, in voxels of
2 mm: a minute of processor time for each seed. Each seed in turn is measured, and three draws of K
others are swept; with `--step 2` every second alpha is, with `--off-mm` the mesh is D millimetres
aside. DIR keeps the images. Prints the RMS and largest error, u, and how often the truth is within
95 %.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from study import ARRAY, WAVEFORM, Row, parser, run, summarize

import clradar
from calibration.roughness.estimates import estimate_alpha
from calibration.roughness.meters import BrightnessMeter, surface_points
from clradar.hand import hand_mesh
from clradar.jobs.job import FolderStore
from clradar.simulation import simulate_alphas

ALPHAS = np.linspace(0.0, 1.0, 11)
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 2e-3)
DRAWS = 3


def images(scene: clradar.Scene, seed: int, store: FolderStore) -> list[clradar.DepthMap]:
    """Of one seed, [alpha]."""
    name = f"seed{seed}"
    if name not in store:
        made = simulate_alphas(scene, ARRAY, WAVEFORM, list(ALPHAS), seed=seed)
        volumes = [clradar.backproject(one, GRID, check_grid=False) for (one,) in made]
        store[name] = {"amplitude": np.stack([v.max_projection() for v in volumes])}
    depth_m = np.full(GRID.shape[1:], 0.3)
    maps = store[name]["amplitude"]
    return [clradar.DepthMap(depth_m, one, GRID.x_m, GRID.y_m, 15.0) for one in maps]


def main() -> None:
    options = parser(__doc__ or "", 12, 0)
    options.add_argument("--work", type=Path, required=True)
    options.add_argument("--seeds", type=int, default=3, help="of a sweep")
    options.add_argument("--step", type=int, default=1)
    options.add_argument("--off-mm", type=float, default=0.0)
    given = options.parse_args()
    given.work.mkdir(exist_ok=True)
    scene = clradar.Scene.from_mesh(hand_mesh("F"))
    points = surface_points(scene, None, ARRAY.tx_m.mean(axis=0), clradar.open_device())
    meter = BrightnessMeter(points, None, ARRAY)
    made = [images(scene, seed, FolderStore(given.work)) for seed in range(given.cases)]
    statistics = np.array([[meter.measure(one) for one in row] for row in made])
    displaced = np.array([[meter.displaced(one) for one in row] for row in made])
    off_m = (1e-3 * given.off_mm, 0.0)
    swept, rng = np.arange(0, 11, given.step), np.random.default_rng(given.first_seed)
    made_of = np.tile(ALPHAS[swept], given.seeds)

    def one(case: int) -> list[Row]:
        rows = []
        others = [seed for seed in range(given.cases) if seed != case]
        for _ in range(DRAWS):
            chosen = rng.choice(others, given.seeds, replace=False)
            of = [
                all_[chosen][:, swept].reshape(len(made_of), -1) for all_ in (statistics, displaced)
            ]
            for alpha, image in zip(ALPHAS, made[case], strict=True):
                seen = meter.measure(image, off_m)
                found = estimate_alpha("all", meter.names, seen, made_of, *of, meter.n_points)
                # Half a step of the likelihood's grid more: at the ends of the range.
                low, high = found.interval.low95 - 1e-3, found.interval.high95 + 1e-3
                error = abs(found.alpha - float(alpha))
                within = bool(low <= alpha <= high)
                rows.append({"error": error, "u": found.uncertainty, "in_95": within})
        return rows

    rows = run(given, one)
    print(f"RMS error {np.sqrt(np.mean([row['error'] ** 2 for row in rows])):.3f}")
    summarize(rows, {"all": lambda row: True}, "error", "u", "in_95")


if __name__ == "__main__":
    main()
