"""Image error and time of the two estimators against the number of rays and samples.

    .venv/bin/python benchmarks/estimators.py [--alpha 0.2 0.5 0.8] [--figure estimators.png]

The hand of the default experiment, 94 x 94 antennas, 128 frequencies, the paper's volume. Error:
RMS of the difference to a converged image over the whole volume, relative to that image's RMS,
both scaled to one ray per mm^2. The converged image is the expected one at REFERENCE_PER_MM2 with a
seed of its own. Prints a table and writes ``benchmarks/estimators.json``, and a figure.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar.hand import hand_mesh

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
REFERENCE_PER_MM2, REFERENCE_SEED = 16.0, 1000
EXPECTED = [(density, 1) for density in (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)]
STOCHASTIC = [(1.0, 4), (10.0, 1), (10.0, 4), (10.0, 16), (10.0, 64)]
"""Samples per mm^2 and rays per sample."""


def run(
    scene: clradar.Scene, estimator: str, density: float, rays: int, seed: int, device: Any
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the image, scaled to one ray per mm^2, and what it took."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    capture = clradar.simulate(
        scene, ARRAY, WAVEFORM, estimator=estimator, samples_per_mm2=density, rays_per_sample=rays,
        seed=seed, device=device,
    )  # fmt: skip
    row = {
        "estimator": estimator,
        "samples_per_mm2": density,
        "rays_per_sample": rays,
        "wall_s": time.perf_counter() - wall_s,
        "cpu_s": time.process_time() - cpu_s,
        **{name: capture.meta["rays"][name] for name in ("samples", "outgoing", "paths")},
    }
    image = clradar.backproject(capture, GRID, tolerance_db=-60, device=device).data
    return image / (density * rays), row


def relative_rms_db(image: np.ndarray, reference: np.ndarray) -> float:
    error = np.mean(np.abs(image - reference) ** 2) / np.mean(np.abs(reference) ** 2)
    return float(10 * np.log10(error))


def study(alpha: float, device: Any) -> list[dict[str, Any]]:
    scene = clradar.Scene.from_mesh(hand_mesh("F", device=device), alpha=alpha)
    reference, _ = run(scene, "expected", REFERENCE_PER_MM2, 1, REFERENCE_SEED, device)
    rows = []
    for estimator, cases in (("expected", EXPECTED), ("stochastic", STOCHASTIC)):
        for density, rays in cases:
            image, row = run(scene, estimator, density, rays, 0, device)
            row = {"alpha": alpha, **row, "error_db": relative_rms_db(image, reference)}
            print(
                f"alpha {alpha:g}  {estimator:10}  {density:6g} /mm2 x {rays:2d}  "
                f"{row['error_db']:6.1f} dB  {row['wall_s']:6.2f} s  {row['cpu_s']:6.2f} s of CPU  "
                f"{row['paths'] / 1e6:.2f} M paths",
                flush=True,
            )
            rows.append(row)
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    alphas = sorted({row["alpha"] for row in rows})
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharey=True)
    for alpha, colour in zip(alphas, ("C0", "C1", "C2", "C3", "C4"), strict=False):
        for estimator, style in (("stochastic", "o--"), ("expected", "s-")):
            chosen = [r for r in rows if (r["alpha"], r["estimator"]) == (alpha, estimator)]
            chosen.sort(key=lambda r: r["cpu_s"])
            error = [r["error_db"] for r in chosen]
            label = f"{estimator}, alpha = {alpha:g}"
            settings = {"color": colour, "markersize": 4, "linewidth": 1}
            axes[1].plot([r["cpu_s"] for r in chosen], error, style, label=label, **settings)
            chosen.sort(key=lambda r: r["samples"] * r["rays_per_sample"])
            error = [r["error_db"] for r in chosen]
            rays = [r["samples"] * r["rays_per_sample"] for r in chosen]
            axes[0].plot(rays, error, style, **settings)
    axes[0].set(
        xscale="log", xlabel="samples x rays per sample (expected: samples)",
        ylabel="error of the image, dB",
    )  # fmt: skip
    axes[1].set(xscale="log", xlabel="processor time of the simulation, s")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.legend(handles=axes[1].get_lines(), fontsize=7, loc="outside upper center", ncols=3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--alpha", type=float, nargs="+", default=[0.2, 0.5, 0.8])
    parser.add_argument("--device", default=None)
    parser.add_argument("--figure", type=Path, default=None)
    parser.add_argument("--redraw", action="store_true", help="from estimators.json, no new run")
    given = parser.parse_args()
    record = Path(__file__).with_name("estimators.json")
    if given.redraw:
        rows = json.loads(record.read_text())["rows"]
    else:
        device = clradar.open_device(given.device)
        warm = clradar.Scene.from_mesh(hand_mesh("F", device=device), alpha=0.5)
        run(warm, "expected", 0.01, 1, 0, device)
        run(warm, "stochastic", 0.1, 1, 0, device)
        rows = [row for alpha in given.alpha for row in study(alpha, device)]
        result = {"device": dict(device.describe()), "rows": rows}
        record.write_text(json.dumps(result, indent=1) + "\n")
    if given.figure is not None:
        draw(rows, given.figure)


if __name__ == "__main__":
    main()
