"""How exactly the sweep finds alpha, on simulations in place of measurements.

    python benchmarks/alpha_accuracy.py --work DIR [--cases N] [--seeds K] [--step N] [--off-mm D]

The default hand at alpha 0, 0.1 ... 1 with N seeds (12), by the stochastic estimator, in voxels of
2 mm: a minute of processor time for each seed. Each seed in turn is measured, and three draws of K
others are swept; with `--step 2` every second alpha is, with `--off-mm` the mesh is D millimetres
aside. DIR keeps the images. Prints the RMS and largest error, u, and how often the truth is within
95 %.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from study import ARRAY, WAVEFORM

import clradar
from calibration.roughness.alpha import BrightnessMeter, estimate_alpha
from calibration.roughness.surface_points import surface_points
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
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--work", type=Path, required=True)
    options.add_argument("--cases", type=int, default=12, help="seeds, more than --seeds")
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
    measured = np.array([[meter.measure(one, off_m) for one in row] for row in made])
    swept, rng = np.arange(0, 11, given.step), np.random.default_rng(0)
    errors, stds, within = [], [], []
    for case in range(given.cases):
        others = [seed for seed in range(given.cases) if seed != case]
        for chosen in (rng.choice(others, given.seeds, replace=False) for _ in range(DRAWS)):
            made_of = np.tile(ALPHAS[swept], given.seeds)
            n = len(made_of)
            rows = [one[chosen][:, swept].reshape(n, -1) for one in (statistics, displaced)]
            for alpha, seen in zip(ALPHAS, measured[case], strict=True):
                found = estimate_alpha("all", meter.names, seen, made_of, *rows, meter.n_points)
                errors.append(found.alpha - alpha)
                stds.append(found.uncertainty)
                # Half a step of the likelihood's grid more: at the ends of the range.
                low, high = found.interval.low95 - 1e-3, found.interval.high95 + 1e-3
                within.append(low <= alpha <= high)
    rms, largest = np.sqrt(np.mean(np.square(errors))), np.abs(errors).max()
    print(
        f"{len(errors)} estimates: RMS error {rms:.3f}, largest {largest:.2f}; u "
        f"{np.median(stds):.3f}, largest {max(stds):.2f}; within 95 %: {np.mean(within):.1%}"
    )


if __name__ == "__main__":
    main()
