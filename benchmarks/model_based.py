"""Model-based images beside back-projection: two points, the edges of a plate, a hand.

    python benchmarks/model_based.py -o docs/images/model-based-imaging.png

Prints iterations, residual and time of each, and draws the figure of docs/model-based-imaging.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

import clradar
from clradar import Capture, Scene, Volume, VoxelGrid, Waveform
from clradar.hand import hand_mesh
from clradar.plot import panels_figure, save_figure

SNR_DB = 20.0
ARRAY = clradar.arrays.qar50()
CELL_M = 3.8e-3
"""Lateral resolution at 0.3 m: the width of a point's image at -3 dB."""


def two_points(phase_deg: float) -> Capture:
    apart_m = 0.7 * CELL_M
    points_m = [[-apart_m / 2, 0, 0.3], [apart_m / 2, 0, 0.3]]
    amplitudes = [1, np.exp(1j * np.deg2rad(phase_deg))]
    return clradar.forward(points_m, amplitudes, ARRAY, Waveform.sfcw(72e9, 82e9, 32))


def plate() -> Capture:
    corners_m = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.015 + [0, 0, 0.3]
    scene = Scene(corners_m, [[0, 2, 1], [0, 3, 2]])
    return clradar.simulate(scene, ARRAY, Waveform.sfcw(72e9, 82e9, 32), estimator="physical")


def hand() -> Capture:
    scene = Scene.from_mesh(hand_mesh("F"), material="palm")
    return clradar.simulate(scene, ARRAY, Waveform.sfcw(72e9, 82e9, 128), estimator="physical")


def noisy(capture: Capture) -> Capture:
    return clradar.impair(capture, snr_db=SNR_DB, seed=1)


def points_grid() -> VoxelGrid:
    return VoxelGrid.from_extent((-0.01, 0.01), (-0.01, 0.01), (0.3, 0.3), 5e-4)


def plate_grid() -> VoxelGrid:
    return VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.288, 0.312), (1e-3, 1e-3, 4e-3))


def hand_grid() -> VoxelGrid:
    return VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), (2e-3, 2e-3, 4e-3))


SCENES: dict[str, tuple[Callable[[], Capture], Callable[[], VoxelGrid], dict[str, int]]] = {
    "two points, 90° apart in phase": (lambda: two_points(90), points_grid, {"sparse": 200}),
    "two points in phase": (lambda: two_points(0), points_grid, {"sparse": 200}),
    "metal plate of 30 mm": (plate, plate_grid, {}),
    "hand, letter F": (hand, hand_grid, {}),
}


def images(name: str) -> list[tuple[str, Volume]]:
    make, make_grid, iterations = SCENES[name]
    capture, grid = noisy(make()), make_grid()
    found = []
    for method in ("back-projection", "least-squares", "sparse"):
        start_s = perf_counter()
        if method == "back-projection":
            image = clradar.backproject(capture, grid, check_grid=False)
            label = method
        else:
            image = clradar.reconstruct(
                capture, grid, method=method, check_grid=False, iterations=iterations.get(method)
            )
            label = f"{method}: {image.meta['iterations']} iterations"
        took_s = perf_counter() - start_s
        found.append((f"{name}\n{label}", image))
        row = np.abs(image.data)[:, image.data.shape[1] // 2].max(axis=0)
        level = np.sort(np.abs(image.data).max(axis=0).ravel())
        print(f"{name}; {method}: {took_s:.1f} s, {grid.counts} voxels")
        for key in ("iterations", "stopped", "residual_db"):
            if key in image.meta:
                print(f"    {key} {image.meta[key]}")
        with np.errstate(divide="ignore"):
            median_db = 20 * np.log10(level[len(level) // 2] / level[-1])
        print(f"    median pixel {median_db:.1f} dB; middle row:")
        print("    " + " ".join(f"{v:.2f}" for v in row / row.max()), flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    rows = [[(label, image.depth_map(20.0)) for label, image in images(name)] for name in SCENES]
    save_figure(panels_figure(rows, dynamic_range_db=20.0), output, force=True)


if __name__ == "__main__":
    main()
