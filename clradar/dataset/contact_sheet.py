"""The contact sheet of a data set: a glance at up to 64 of its samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clradar.dataset.folder import read_manifest, stored_sample
from clradar.dataset.sample import Sample, read_recipe
from clradar.files.failures import fail
from clradar.hand.joints import CHAINS
from clradar.plot.drawing import AMPLITUDE_BACKGROUND, new_figure

MOST_SAMPLES, COLUMNS = 64, 8
CELL_INCHES, TITLE_PT = 1.15, 7.0

DYNAMIC_RANGE_DB = 25.0  # of amplitudes; lower ones are black
DRAWN: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "max_projection": lambda amplitude: _level_db(amplitude),
    "volume": lambda voxels: _level_db(np.abs(voxels).max(axis=0)),
    "depth_map": lambda depth_m: depth_m,
    "capture": lambda samples: _level_db(np.abs(samples).mean(axis=2)),
}
"""Of each sample the first of these products, and how; one without has its joints alone."""


def contact_sheet(folder: Path) -> Figure:
    """Draw samples that are spread evenly over the stored ones: image, joints, pose and number."""
    manifest = read_manifest(folder)
    if not (stored := manifest.stored):
        fail(folder, "a data set with at least one shard of samples", "none")
    # Rounded, so that the step does not beat with the cycle of poses.
    at = np.linspace(0, len(stored) - 1, min(MOST_SAMPLES, len(stored))).round().astype(int)
    rows, columns = -(-len(at) // COLUMNS), min(COLUMNS, len(at))
    figure = new_figure(columns * CELL_INCHES + 0.2, rows * (CELL_INCHES + 0.22) + 0.4)
    scale = f"amplitudes from {DYNAMIC_RANGE_DB:g} dB below each maximum; depths from near to far"
    figure.supxlabel(scale, fontsize=TITLE_PT, wrap=True)
    for number, sample in enumerate((stored[i] for i in at.tolist()), start=1):
        axes = figure.add_subplot(rows, columns, number)
        _draw(axes, stored_sample(folder, manifest, sample)[0])
    return figure


def _draw(axes: Any, sample: Sample) -> None:
    """Draw a sample, x to the left."""
    axes.set(xticks=[], yticks=[], facecolor=AMPLITUDE_BACKGROUND, aspect="equal")
    drawn = read_recipe(sample.recipe)
    images = (made(sample.arrays[n]) for n, made in DRAWN.items() if n in sample.arrays)
    image = next(images, None)
    grid = drawn.plan.image.grid if drawn.plan.keeps_images else None
    if image is not None:
        extent = (-0.5, image.shape[1] - 0.5, -0.5, image.shape[0] - 0.5)  # Rx and Tx
        if grid is not None:
            dx, dy = grid.spacing_m[:2] / 2
            extent = (grid.x_m[0] - dx, grid.x_m[-1] + dx, grid.y_m[0] - dy, grid.y_m[-1] + dy)
        axes.imshow(image, extent=extent, origin="lower", cmap="magma", interpolation="nearest")
    if "joints" in sample.arrays and (image is None or grid is not None):
        for chain in CHAINS:
            x_m, y_m, _ = sample.arrays["joints"][[0, *chain]].T
            axes.plot(x_m, y_m, color="#4cc9f0", linewidth=0.4, alpha=0.8)
    axes.invert_xaxis()
    text = f"{drawn.sample}: {drawn.pose.name}"[:20]
    side = "" if drawn.plan.hands.handedness == "right" else ", left"
    axes.set_title(text + side, fontsize=TITLE_PT, pad=2, parse_math=False)


def _level_db(amplitude: np.ndarray) -> Any:
    """Return amplitudes in decibels below their maximum."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(20 * np.log10(amplitude / amplitude.max()), -DYNAMIC_RANGE_DB)
