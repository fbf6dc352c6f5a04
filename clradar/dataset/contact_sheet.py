"""The contact sheet of a complete data set: a glance at up to 64 of its samples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.folder import CONTACT_SHEET, Manifest
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import metres, read_recipe
from clradar.dataset.sample import Sample
from clradar.dataset.shards import opened_shard, row_of, sample_of
from clradar.files.atomic import write_file
from clradar.hand import JOINT_NAMES
from clradar.plot import AMPLITUDE_BACKGROUND, png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SAMPLES, COLUMNS = 64, 8
CELL_INCHES, TITLE_PT, DPI = 1.15, 7.0, 150

DYNAMIC_RANGE_DB = 25.0
"""Of amplitudes; lower ones are black."""

FRAME_M = 0.15
"""Half the side of a cell without an image, about the centre of the hand."""

LINE_COLOUR = "#4cc9f0"
"""Of the joints: visible on every colour of the scale."""


def write_contact_sheet(folder: Path, manifest: Manifest) -> None:
    """Write it unless it is there; of samples that are spread evenly over the stored ones."""
    stored, path = manifest.stored, folder / CONTACT_SHEET
    if not stored or path.is_file():
        return
    # Rounded, so that the step does not beat with the cycle of poses.
    positions = np.linspace(0, len(stored) - 1, min(MOST_SAMPLES, len(stored))).tolist()
    samples = []
    for sample in (stored[round(position)] for position in positions):
        shard = folder / str(manifest.place_of(sample))
        with opened_shard(shard) as file:
            samples.append(sample_of(file, row_of(file, shard, sample), manifest.plan)[0])
    write_file(path, png_bytes(contact_sheet(samples), dpi=DPI), force=True)


def contact_sheet(samples: list[Sample]) -> Figure:
    """Draw samples side by side: image, joints, pose and number; x to the left.

    Each is shown by its first product of: maximum projection, volume, depth map, mesh, capture;
    amplitudes in decibels below each image's maximum.
    """
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(samples))
    rows = -(-len(samples) // columns)
    size = (columns * CELL_INCHES + 0.2, rows * (CELL_INCHES + 0.22) + 0.2)
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    for number, sample in enumerate(samples, start=1):
        axes = figure.add_subplot(rows, columns, number)
        drawn = read_recipe(sample.recipe)
        _draw(axes, drawn.plan, sample.arrays)
        text = f"{drawn.sample}: {drawn.pose.name}"
        text = text if len(text) <= 20 else text[:19] + "…"
        side = "" if drawn.plan.hands.handedness == "right" else ", left"
        axes.set_title(text + side, fontsize=TITLE_PT, pad=2, parse_math=False)
    return figure


def _draw(axes: Any, plan: Plan, arrays: Mapping[str, np.ndarray]) -> None:
    axes.set(xticks=[], yticks=[], facecolor=AMPLITUDE_BACKGROUND, aspect="equal")
    image, limits = _image(arrays)
    if image is None:
        x_m, y_m, _ = metres(plan.placement)
        extent = (x_m - FRAME_M, x_m + FRAME_M, y_m - FRAME_M, y_m + FRAME_M)
        points = arrays.get("mesh_vertices", np.empty((0, 3)))
        axes.plot(points[:, 0], points[:, 1], ",", color="#bbbbbb")
    elif plan.keeps_images:
        extent = (*_edges_m(plan.image.grid.x_m), *_edges_m(plan.image.grid.y_m))
    else:  # the axes are Rx and Tx
        extent = (-0.5, image.shape[1] - 0.5, -0.5, image.shape[0] - 0.5)
    if "joints" in arrays and (image is None or plan.keeps_images):
        _draw_joints(axes, arrays["joints"])
    if image is not None:
        axes.imshow(
            image, extent=extent, origin="lower", cmap="magma", vmin=limits[0], vmax=limits[1],
            interpolation="nearest",
        )  # fmt: skip
    axes.set(xlim=(extent[1], extent[0]), ylim=(extent[2], extent[3]))


def _draw_joints(axes: Any, joints_m: np.ndarray) -> None:
    starts = [i for i, name in enumerate(JOINT_NAMES) if name.endswith("metacarpal")]
    for first, end in zip(starts, [*starts[1:], len(JOINT_NAMES)], strict=True):
        chain = joints_m[[0, *range(first, end)]]
        chain = chain[np.isfinite(chain).all(axis=1)]
        axes.plot(chain[:, 0], chain[:, 1], color=LINE_COLOUR, linewidth=0.4, alpha=0.8)


def _edges_m(axis_m: np.ndarray) -> tuple[float, float]:
    half_m = 0.5 * (axis_m[1] - axis_m[0]) if len(axis_m) > 1 else 0.5e-3
    return axis_m[0] - half_m, axis_m[-1] + half_m


def _image(arrays: Mapping[str, np.ndarray]) -> tuple[np.ndarray | None, tuple[float, float]]:
    """Return what is drawn of a sample, and the limits of its colours."""
    amplitude = arrays.get("max_projection")
    if amplitude is None and "volume" in arrays:
        amplitude = np.abs(arrays["volume"]).max(axis=0)
    if amplitude is None and "depth_map" in arrays:
        depth_m = arrays["depth_map"]
        known = depth_m[np.isfinite(depth_m)]
        return depth_m, (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if amplitude is None and "capture" in arrays and "mesh_vertices" not in arrays:
        amplitude = np.abs(arrays["capture"]).mean(axis=2)
    if amplitude is None:
        return None, (0.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return 20 * np.log10(amplitude / amplitude.max()), (-DYNAMIC_RANGE_DB, 0.0)
