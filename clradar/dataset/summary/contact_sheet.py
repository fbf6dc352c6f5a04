"""Contact sheet of a data set: images of up to 64 samples with the joints drawn over them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.sample import Sample
from clradar.dataset.store.folder import CONTACT_SHEET, Manifest, stored_path
from clradar.dataset.store.shard_reader import opened_shard, row_of, sample_of
from clradar.dataset.store.shard_schema import axes_of
from clradar.files.atomic import write_file
from clradar.hand import JOINT_NAMES
from clradar.plot import AMPLITUDE_BACKGROUND, png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SAMPLES, COLUMNS = 64, 8
CELL_INCHES, TITLE_INCHES, MARGIN_INCHES = 1.15, 0.22, 0.12
TITLE_PT = 7.0
DPI = 150

DYNAMIC_RANGE_DB = 25.0
"""Of amplitudes; lower ones are black."""

FRAME_M = 0.15
"""Half the side of a cell without an image, about the centre of the hand."""

LINE_COLOUR = "#4cc9f0"
"""Of the joints: visible on every colour of the scale."""


def write_contact_sheet(folder: Path, manifest: Manifest) -> None:
    """Write the contact sheet of a data set, unless it has no samples."""
    samples = [_read(folder, manifest, number) for number in chosen(manifest)]
    if samples:
        write_file(folder / CONTACT_SHEET, png_bytes(contact_sheet(samples), dpi=DPI), force=True)


def chosen(manifest: Manifest) -> list[int]:
    """Return the samples to show, spread evenly over the stored ones."""
    stored = [
        sample
        for number in sorted(manifest.shards)
        for sample in manifest.plan.shard_samples(number)
        if sample not in manifest.aside
    ]
    # Rounded, so that the step does not beat with the cycle of poses.
    positions = np.linspace(0, len(stored) - 1, min(MOST_SAMPLES, len(stored))).tolist()
    return [stored[round(position)] for position in positions]


def _read(folder: Path, manifest: Manifest, sample: int) -> Sample:
    path = stored_path(folder, manifest, sample)
    assert path is not None  # it holds the sample
    with opened_shard(path) as file:
        return sample_of(file, row_of(file, path, sample))


def contact_sheet(samples: list[Sample]) -> Figure:
    """Draw samples side by side: image, joints, pose and number.

    Parameters
    ----------
    samples : list of Sample
        Each is shown by its first product of: maximum projection, volume, depth map, mesh, capture.

    Returns
    -------
    matplotlib.figure.Figure
        Amplitudes in decibels below each image's maximum; x to the left, as seen from the radar.
    """
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(samples))
    rows = -(-len(samples) // columns)
    width = columns * CELL_INCHES + 2 * MARGIN_INCHES
    height = rows * (CELL_INCHES + TITLE_INCHES) + 2 * MARGIN_INCHES
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    inner = 0.94 * CELL_INCHES
    for i, sample in enumerate(samples):
        row, column = divmod(i, columns)
        left = MARGIN_INCHES + column * CELL_INCHES
        bottom = height - MARGIN_INCHES - (row + 1) * (CELL_INCHES + TITLE_INCHES)
        place = (left / width, bottom / height, inner / width, inner / height)
        axes = figure.add_axes(place)
        _draw(axes, sample)
        recipe = sample.recipe
        text = f"{recipe['sample']}: {recipe['pose']['name']}"
        side = "" if recipe["hand"]["handedness"] == "right" else ", left"
        axes.set_title(_short(text) + side, fontsize=TITLE_PT, pad=2, parse_math=False)
    return figure


def _short(text: str) -> str:
    return text if len(text) <= 20 else text[:19] + "…"


def _draw(axes: Any, sample: Sample) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(AMPLITUDE_BACKGROUND)
    rendering = _rendering(sample)
    if rendering is not None:
        image, (x_m, y_m), limits = rendering
        half = [0.5 * (a[1] - a[0]) if len(a) > 1 else 0.5e-3 for a in (x_m, y_m)]
        extent = (x_m[0] - half[0], x_m[-1] + half[0], y_m[0] - half[1], y_m[-1] + half[1])
        axes.imshow(
            image, extent=extent, origin="lower", cmap="magma", vmin=limits[0], vmax=limits[1],
            interpolation="nearest", aspect="equal",
        )  # fmt: skip
        axes.set_xlim(extent[1], extent[0])
        axes.set_ylim(extent[2], extent[3])
        if sample.recipe["image"] is None:  # the axes are Tx and Rx
            return
    else:
        x_m, y_m = sample.recipe["placement"]["center_m"][:2]
        axes.set_xlim(x_m + FRAME_M, x_m - FRAME_M)
        axes.set_ylim(y_m - FRAME_M, y_m + FRAME_M)
        axes.set_aspect("equal")
        if "mesh_vertices" in sample.arrays:
            points = sample.arrays["mesh_vertices"]
            axes.plot(points[:, 0], points[:, 1], ",", color="#bbbbbb")
    if "joints" in sample.arrays:
        _draw_joints(axes, sample.arrays["joints"])


def _draw_joints(axes: Any, joints_m: np.ndarray) -> None:
    starts = [i for i, name in enumerate(JOINT_NAMES) if name.endswith("metacarpal")]
    for first, end in zip(starts, [*starts[1:], len(JOINT_NAMES)], strict=True):
        chain = joints_m[[0, *range(first, end)]]
        chain = chain[np.isfinite(chain).all(axis=1)]
        axes.plot(chain[:, 0], chain[:, 1], color=LINE_COLOUR, linewidth=0.4, alpha=0.8)


def _rendering(sample: Sample) -> tuple[np.ndarray, tuple[Any, Any], tuple[float, float]] | None:
    """Return an image, its axes and the limits of its colours."""
    arrays = sample.arrays
    axes: Mapping[str, Any] = axes_of(sample.recipe)
    if "max_projection" in arrays or "volume" in arrays:
        amplitude = arrays.get("max_projection")
        if amplitude is None:
            amplitude = np.abs(arrays["volume"]).max(axis=0)
        plane = (axes["x_m"].values, axes["y_m"].values)
        return _decibels(amplitude), plane, (-DYNAMIC_RANGE_DB, 0.0)
    if "depth_map" in arrays:
        depth_m = arrays["depth_map"]
        known = depth_m[np.isfinite(depth_m)]
        limits = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        return depth_m, (axes["x_m"].values, axes["y_m"].values), limits
    if "capture" in arrays and "mesh_vertices" not in arrays:
        amplitude = np.abs(arrays["capture"]).mean(axis=2)
        plane = (np.arange(amplitude.shape[1]), np.arange(amplitude.shape[0]))
        return _decibels(amplitude), plane, (-DYNAMIC_RANGE_DB, 0.0)
    return None


def _decibels(amplitude: np.ndarray) -> np.ndarray:
    peak = float(amplitude.max())
    if peak == 0.0:
        return np.full(amplitude.shape, -np.inf)
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(amplitude / peak)
