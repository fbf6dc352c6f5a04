"""Model-based images beside back-projection: two points, the edges of a plate, a hand.

    python benchmarks/model_based.py -o docs/images/model-based-imaging.png

Prints iterations, residual and time of each, and draws the figure of docs/model-based-imaging.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

import clradar
from clradar import Capture, Scene, Volume, VoxelGrid, Waveform
from clradar.hand import hand_mesh
from clradar.plot import panels_figure, save_figure

SNR_DB = 20.0
ARRAY = clradar.arrays.qar50()
SOME = ARRAY.part(slice(None, None, 3), slice(None, None, 3))
WIDTH_M = 3.8e-3
"""Of a point's image at -3 dB, 0.3 m away."""


def two_points(phase_deg: float) -> Capture:
    apart_m = 0.7 * WIDTH_M
    points_m = [[-apart_m / 2, 0, 0.3], [apart_m / 2, 0, 0.3]]
    amplitudes = [1, np.exp(1j * np.deg2rad(phase_deg))]
    return clradar.forward(points_m, amplitudes, SOME, Waveform.sfcw(72e9, 82e9, 16))


def plate() -> Capture:
    corners_m = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.015 + [0, 0, 0.3]
    scene = Scene(corners_m, [[0, 2, 1], [0, 3, 2]])
    return clradar.simulate(scene, ARRAY, Waveform.sfcw(72e9, 82e9, 16), estimator="physical")


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


def dip_words(row: np.ndarray, grid: VoxelGrid) -> str:
    """The level between two points, relative to the higher one."""
    middle = row[np.abs(grid.x_m) < 0.5e-3].min()
    places = grid.x_m[row > 0.99 * row.max()]
    ends = f"{1e3 * places[0]:.1f} and {1e3 * places[-1]:.1f} mm"
    return f"maxima at {ends}, {20 * np.log10(middle / row.max()):.1f} dB at 0"


def edge_words(row: np.ndarray, grid: VoxelGrid) -> str:
    """How far the amplitude takes from a fifth to four fifths, at the edge at x = -15 mm."""
    edge = row[: np.argmax(row > 0.8 * row.max()) + 1] / row.max()
    from_mm, to_mm = (1e3 * np.interp(level, edge, grid.x_m[: len(edge)]) for level in (0.2, 0.8))
    inside = row[np.abs(grid.x_m) < 0.012]
    return f"edge of {to_mm - from_mm:.1f} mm, inside {inside.min() / inside.max():.2f} to 1"


def floor_words(row: np.ndarray, grid: VoxelGrid) -> str:
    return f"{np.count_nonzero(row)} of {len(row)} voxels of the middle row are not 0"


SCENES: dict[str, tuple[Any, Any, Any, dict[str, int]]] = {
    "points 90° apart in phase": (
        lambda: two_points(90), points_grid, dip_words, {"sparse": 200},
    ),
    "points in phase": (lambda: two_points(0), points_grid, dip_words, {"sparse": 200}),
    "metal plate": (plate, plate_grid, edge_words, {}),
    "hand": (hand, hand_grid, floor_words, {}),
}  # fmt: skip


def images(name: str) -> list[tuple[str, Volume]]:
    make, make_grid, words, iterations = SCENES[name]
    capture, grid = noisy(make()), make_grid()
    found = []
    for method in ("back-projection", "least-squares", "sparse"):
        start_s, start_cpu_s = perf_counter(), process_time()
        if method == "back-projection":
            image = clradar.backproject(capture, grid, check_grid=False)
            label = f"{name}: {method}"
        else:
            image = clradar.reconstruct(
                capture, grid, method=method, check_grid=False, iterations=iterations.get(method)
            )
            label = f"{name}: {method}, {image.meta['iterations']} iterations"
        took_s, cpu_s = perf_counter() - start_s, process_time() - start_cpu_s
        found.append((label, image))
        print(f"{label}: {took_s:.1f} s, {cpu_s:.1f} s of processors, {grid.counts} voxels")
        if method != "back-projection":
            left_db = image.meta["residual_db"]
            print(f"    stopped by {image.meta['stopped']}, residual {left_db:.2f} dB")
        row = np.abs(image.data)[:, image.data.shape[1] // 2].max(axis=0)
        pixels = np.sort(image.max_projection().ravel())
        with np.errstate(divide="ignore"):
            median_db = 20 * np.log10(pixels[len(pixels) // 2] / pixels[-1])
        print(f"    {words(row, grid)}; median pixel {median_db:.1f} dB", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    rows = [[(label, image.depth_map(20.0)) for label, image in images(name)] for name in SCENES]
    save_figure(panels_figure(rows, dynamic_range_db=20.0), output, force=True)


if __name__ == "__main__":
    main()
