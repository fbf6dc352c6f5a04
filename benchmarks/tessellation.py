"""Whether a hand's image depends on how finely its surface is cut into triangles.

    python benchmarks/tessellation.py [--poses F S] [--alphas 0.3 0.5] [--edges-mm 3.44 2.2]

For each pose and alpha the hand is imaged with about 60 000 faces and with each edge length
(3.44 mm: 10 000), with two seeds each. Printed are relative RMS differences of maximum projections:
with random rays and flat facets, of two seeds (the mean over both meshes), and of the two meshes
with different seeds (the mean over both ways). A ratio of 1 means that the triangles have no
measurable effect.
"""

from __future__ import annotations

import argparse

import numpy as np

import clradar
from clradar.hand import hand_mesh

FINE_M = 1.405e-3
SEEDS = (0, 1)


def image(pose: str, edge_length_m: float, alpha: float, seed: int) -> tuple[np.ndarray, int]:
    """Return the maximum projection, linear, and the number of faces."""
    mesh = hand_mesh(pose, edge_length_m)
    capture = clradar.simulate(
        clradar.Scene.from_mesh(mesh, alpha=alpha),
        clradar.arrays.qar50(),
        clradar.Waveform.sfcw(72e9, 82e9, 128),
        estimator="stochastic",
        facets="flat",
        seed=seed,
    )
    grid = clradar.VoxelGrid.from_extent(
        x_m=(-0.1, 0.1), y_m=(-0.1, 0.1), z_m=(0.24, 0.36), spacing_m=2e-3
    )
    return clradar.backproject(capture, grid).max_projection(), len(mesh.faces)


def images(pose: str, edge_length_m: float, alpha: float) -> tuple[list[np.ndarray], int]:
    """Return the images of both seeds, and the number of faces."""
    made = [image(pose, edge_length_m, alpha, seed) for seed in SEEDS]
    return [image for image, _ in made], made[0][1]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the RMS difference over the geometric mean of both RMS values."""
    return float(np.linalg.norm(a - b) / np.sqrt(np.linalg.norm(a) * np.linalg.norm(b)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", nargs="+", default=["F", "S"])
    parser.add_argument("--alphas", nargs="+", type=float, default=[0.0, 0.3, 0.5, 0.7])
    parser.add_argument("--edges-mm", nargs="+", type=float, default=[3.44, 2.2, 1.7])
    options = parser.parse_args()
    print("pose  alpha          faces  two seeds  two meshes  ratio")
    for pose in options.poses:
        for alpha in options.alphas:
            fine, n_fine = images(pose, FINE_M, alpha)
            for edge_mm in options.edges_mm:
                coarse, n_coarse = images(pose, edge_mm / 1e3, alpha)
                seeds = 0.5 * (difference(*coarse) + difference(*fine))
                meshes = 0.5 * (difference(coarse[0], fine[1]) + difference(coarse[1], fine[0]))
                row = f"{pose:5} {alpha:5.2f} {n_coarse:6d} / {n_fine:6d} {seeds:9.3f} "
                print(f"{row} {meshes:10.3f} {meshes / seeds:6.2f}", flush=True)


if __name__ == "__main__":
    main()
