"""Image error and processor time of the estimators of alpha against samples and rays.

    python benchmarks/estimators.py [--alpha 0.2 0.5 0.8]

The hand of the default experiment, 94 x 94 antennas, 128 frequencies, the paper's volume. Error:
RMS of the difference to a converged image, the expected one of 16 samples per mm^2 and another
seed, over the whole volume, both scaled to one ray per mm^2.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from study import ARRAY, WAVEFORM

import clradar
from clradar.hand import hand_mesh

GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
CASES = [
    *(("expected", density, 1) for density in (0.0625, 0.25, 1.0, 4.0)),
    *(("stochastic", *case) for case in ((1.0, 4), (10.0, 1), (10.0, 4), (10.0, 16), (10.0, 64))),
]
"""Estimator, samples per mm^2, rays per sample."""


def run(scene: clradar.Scene, estimator: str, density: float, rays: int, seed: int) -> np.ndarray:
    capture = clradar.simulate(
        scene, ARRAY, WAVEFORM, estimator=estimator, samples_per_mm2=density, rays_per_sample=rays,
        seed=seed,
    )  # fmt: skip
    return clradar.backproject(capture, GRID, tolerance_db=-60).data / (density * rays)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--alpha", type=float, nargs="+", default=[0.2, 0.5, 0.8])
    for alpha in parser.parse_args().alpha:
        scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=alpha)
        reference = run(scene, "expected", 16.0, 1, 1000)
        for case in CASES:
            start_s = time.process_time()
            error = np.mean(np.abs(run(scene, *case, 0) - reference) ** 2)
            level_db = 10 * np.log10(error / np.mean(np.abs(reference) ** 2))
            print(
                f"alpha {alpha:g}  {case[0]:10} {case[1]:6g} /mm2 x {case[2]:2d}  {level_db:6.1f} "
                f"dB  {time.process_time() - start_s:6.2f} s with the image",
                flush=True,
            )


if __name__ == "__main__":
    main()
