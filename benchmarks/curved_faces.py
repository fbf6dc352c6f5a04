"""How far images of coarse faces are from those of fine ones, with flat and with curved facets.

    python benchmarks/curved_faces.py [--shapes ball tube hand] [--estimators physical expected]

A ball and a tube of 40 mm radius and a hand, 0.3 m from one antenna in three of the 94 x 94 imager,
32 frequencies. Printed are the RMS differences of the complex images to that of a fine mesh with
curved facets, in dB: of the same fine mesh with other samples (another seed; the physical
estimator draws none), and of coarser meshes of the same surface. alpha is 0.3 for rays.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable

import numpy as np
import trimesh

import clradar
from clradar import Capture, Scene, Volume, VoxelGrid
from clradar.hand import hand_mesh

RADIUS_M = 0.04
FULL = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(FULL.tx_m[::3], FULL.rx_m[::3])
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 32)
SAMPLES_PER_MM2 = {"physical": 8.0, "expected": 8.0}


def ball(edge_m: float) -> Scene:
    """Icosphere of about these edges, its normals estimated from its faces."""
    cuts = max(1, round(np.log2(1.05 * RADIUS_M / edge_m)))
    mesh = trimesh.creation.icosphere(subdivisions=cuts, radius=RADIUS_M)
    return lit_half(mesh)


def tube(edge_m: float) -> Scene:
    """A tube 40 mm long across the line of sight; its sides are long strips."""
    mesh = trimesh.creation.cylinder(RADIUS_M, 0.04, round(2 * np.pi * RADIUS_M / edge_m))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return lit_half(mesh)


def lit_half(mesh: trimesh.Trimesh) -> Scene:
    """Return what faces the radar; the rest would only cost time."""
    lit = mesh.triangles_center[:, 2] < 0.25 * RADIUS_M
    return Scene(mesh.vertices + np.array([0.0, 0.0, 0.3]), mesh.faces[lit], 0.3)


def hand(edge_m: float) -> Scene:
    """The embedded hand, with the normals of its implicit surface."""
    return Scene.from_mesh(hand_mesh("F", edge_m), alpha=0.3)


SHAPES: dict[str, tuple[Callable[[float], Scene], float, tuple[float, ...]]] = {
    "ball": (ball, 0.7e-3, (23e-3, 12e-3, 6e-3, 3e-3, 1.5e-3)),
    "tube": (tube, 0.5e-3, (16e-3, 8e-3, 4e-3, 2e-3)),
    "hand": (hand, 1.0e-3, (4e-3, 2.8e-3, 2e-3, 1.6e-3)),
}
"""Maker, fine edge and coarse edges, metres, of each shape."""


def image(scene: Scene, estimator: str, facets: str, seed: int = 0) -> Volume:
    """Return the image over the whole object, 2 mm apart."""
    capture: Capture = clradar.simulate(
        scene, ARRAY, WAVEFORM, estimator=estimator, facets=facets, seed=seed,
        samples_per_mm2=SAMPLES_PER_MM2[estimator],
    )  # fmt: skip
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.24, 0.34), 2e-3)
    return clradar.backproject(capture, grid)


def error_db(found: Volume, truth: Volume) -> float:
    """Return the RMS of the difference relative to the RMS of the truth, decibels."""
    away = found.data.astype(complex) - truth.data
    return 20 * np.log10(np.linalg.norm(away) / np.linalg.norm(truth.data))


def mean_edge_mm(scene: Scene) -> float:
    edges = np.roll(scene.triangles_m, -1, axis=1) - scene.triangles_m
    # Of a strip the edge that is bent.
    return 1e3 * float(np.median(np.linalg.norm(edges, axis=2).min(axis=1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", nargs="+", choices=list(SHAPES), default=list(SHAPES))
    parser.add_argument("--estimators", nargs="+", default=list(SAMPLES_PER_MM2))
    options = parser.parse_args()
    warnings.simplefilter("ignore", clradar.ClradarWarning)
    for shape in options.shapes:
        make, fine_m, edges_m = SHAPES[shape]
        scenes = [make(edge_m) for edge_m in edges_m]
        fine = make(fine_m)
        for estimator in options.estimators:
            truth = image(fine, estimator, "curved")
            print(f"{shape}, {estimator}", flush=True)
            if estimator != "physical":
                other = error_db(image(fine, estimator, "curved", seed=1), truth)
                print(f"  other samples {other:.1f} dB", flush=True)
            for scene in scenes:
                found = [error_db(image(scene, estimator, f), truth) for f in ("flat", "curved")]
                print(
                    f"  {mean_edge_mm(scene):5.1f} mm: flat {found[0]:6.1f} dB, "
                    f"curved {found[1]:6.1f} dB",
                    flush=True,
                )


if __name__ == "__main__":
    main()
