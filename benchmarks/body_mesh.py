"""A person of 1.8 m as a closed mesh: round cones blended into one smooth surface.

    python benchmarks/body_mesh.py body.ply --faces 1000000 --z-mm 1200

The mesh is in metres in the antenna frame: y up, the front towards the antennas.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh
from skimage.measure import marching_cubes

HEIGHT_M = 1.8
BLEND_PER_M = 60.0
"""How sharply parts meet: of the soft minimum of their distances."""

_RIGHT = [  # start, end (x, y, z from the soles), radii there, how much flatter in z
    ((0.09, 0.90, 0.0), (0.10, 0.52, -0.01), 0.085, 0.055, 1.0),  # thigh
    ((0.10, 0.52, -0.01), (0.11, 0.09, 0.02), 0.055, 0.038, 1.0),  # shank
    ((0.11, 0.04, 0.03), (0.13, 0.035, -0.13), 0.040, 0.032, 1.0),  # foot
    ((0.18, 1.42, 0.0), (0.27, 1.14, 0.01), 0.050, 0.042, 1.0),  # upper arm
    ((0.27, 1.14, 0.01), (0.33, 0.90, -0.05), 0.042, 0.030, 1.0),  # forearm
    ((0.33, 0.88, -0.06), (0.35, 0.76, -0.08), 0.035, 0.022, 1.0),  # hand
]
_MIDDLE = [
    ((-0.05, 0.97, 0.0), (0.05, 0.97, 0.0), 0.130, 0.130, 1.15),  # pelvis
    ((0.0, 1.05, 0.0), (0.0, 1.25, 0.0), 0.130, 0.140, 1.25),  # belly
    ((-0.09, 1.34, 0.0), (0.09, 1.34, 0.0), 0.120, 0.120, 1.15),  # chest
    ((0.0, 1.42, 0.0), (0.0, 1.58, -0.01), 0.065, 0.055, 1.0),  # neck
    ((0.0, 1.66, -0.015), (0.0, 1.715, -0.01), 0.078, 0.084, 0.9),  # head
    ((0.0, 1.655, -0.09), (0.0, 1.63, -0.095), 0.012, 0.016, 1.0),  # nose
]
_LEFT = [((-a[0], *a[1:]), (-b[0], *b[1:]), *rest) for a, b, *rest in _RIGHT]
PARTS = [*_MIDDLE, *_RIGHT, *_LEFT]


def distance_m(at_m: np.ndarray) -> np.ndarray:
    """Return roughly the distance from the surface, shape (n,), below 0 within: (n, 3) from the
    soles."""
    total = np.zeros(len(at_m))
    for start, end, r0, r1, flatter in PARTS:
        scale = np.array([1.0, 1.0, flatter])
        a, b = np.array(start) * scale, np.array(end) * scale
        away, axis = at_m * scale - a, b - a
        t = np.clip(away @ axis / (axis @ axis), 0.0, 1.0)
        part_m = np.linalg.norm(away - t[:, None] * axis, axis=1) - (r0 + t * (r1 - r0))
        total += np.exp(-BLEND_PER_M * np.clip(part_m, -1.0, 1.0))
    return np.asarray(-np.log(total) / BLEND_PER_M)


def body_mesh(n_faces: int = 1_000_000, z_m: float = 1.2) -> trimesh.Trimesh:
    """Return the mesh with about so many faces, its middle at (0, 0, `z_m`)."""
    # Of 4.8 faces by marching cubes over the square of a cell's edge, each cut into four.
    levels = max(0, round(np.log(n_faces / 60_000) / np.log(4)))
    step_m = np.sqrt(4.8 * 4**levels / n_faces)
    box_m = ((-0.45, 0.45), (-0.05, 1.9), (-0.3, 0.3))
    axes_m = [np.arange(low, high, step_m) for low, high in box_m]
    grid_m = np.stack(np.meshgrid(*axes_m, indexing="ij"), axis=-1)
    values = np.stack([distance_m(part.reshape(-1, 3)).reshape(part.shape[:2]) for part in grid_m])
    vertices_m, faces, _, _ = marching_cubes(values, 0.0, spacing=(step_m,) * 3)
    vertices_m = _on_surface(vertices_m + [axis[0] for axis in axes_m])
    for _ in range(levels):
        vertices_m, faces = trimesh.remesh.subdivide(vertices_m, faces)
        vertices_m = _on_surface(vertices_m)
    low, high = vertices_m[:, 1].min(), vertices_m[:, 1].max()
    vertices_m = (vertices_m - [0.0, 0.5 * (low + high), 0.0]) * (HEIGHT_M / (high - low))
    vertices_m += [0.0, 0.0, z_m]
    return trimesh.Trimesh(vertices_m, faces, process=False)


def _on_surface(vertices_m: np.ndarray) -> np.ndarray:
    """The vertices moved to where the distance is 0, by two steps of Newton's method."""
    parts = [vertices_m[i : i + 50_000].copy() for i in range(0, len(vertices_m), 50_000)]
    for at_m in parts:
        for _ in range(2):
            steps = 1e-5 * np.eye(3)
            slope = np.stack([distance_m(at_m + s) - distance_m(at_m - s) for s in steps], axis=1)
            slope /= 2e-5
            at_m -= slope * (distance_m(at_m) / (slope**2).sum(axis=1))[:, None]
    return np.concatenate(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path)
    parser.add_argument("--faces", type=int, default=1_000_000)
    parser.add_argument("--z-mm", type=float, default=1200.0)
    given = parser.parse_args()
    mesh = body_mesh(given.faces, given.z_mm / 1e3)
    mesh.export(given.output)
    print(f"{given.output}: {len(mesh.faces)} faces, {mesh.area:.2f} m^2")


if __name__ == "__main__":
    main()
