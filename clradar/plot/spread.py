"""The figure of an image's mean and standard deviation over seeds, with profiles and their band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap, Spread
from clradar.plot.figures import plain
from clradar.plot.layout import (
    LABEL_PT,
    SINGLE_PANEL_WIDTH,
    Extent,
    new_panels,
    panel_size,
    settled,
    typeset,
)
from clradar.plot.panels import AMPLITUDE_BACKGROUND, amplitude_bar, draw_amplitude, draw_frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVELS_DB = 30.0
"""Of the images, decibel."""

BAND = "#4c72b0"


def spread_figure(
    found: Spread, title: str | None = None, *, dynamic_range_db: float = LEVELS_DB
) -> Figure:
    """Draw mean and standard deviation of an image over seeds, and profiles with their band.

    Parameters
    ----------
    found : Spread
    title : str, optional
        Plain text above all panels.
    dynamic_range_db : float, decibel
        Levels further below the largest mean are background: deviations are smaller than means.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: mean of the amplitude, and its standard deviation on the same scale, in
        dB relative to the largest mean; amplitude and depth along x through that maximum, as mean
        with a band of one standard deviation to either side; the colour bar.

    Raises
    ------
    CompareError
        The mean is zero everywhere, or has fewer than two pixels along x or y.
    """
    top = float(found.amplitude.max())
    if top == 0.0 or min(found.amplitude.shape) < 2:
        n_y, n_x = found.amplitude.shape
        got = "zeros" if top == 0.0 else f"{n_x} x {n_y} pixels"
        raise CompareError(f"spread_figure: expected an image with two axes to draw, got {got}")
    levels = [
        DepthMap(found.depth_m, values / top, found.x_m, found.y_m, dynamic_range_db)
        for values in (found.amplitude, found.amplitude_sd)
    ]
    extent = Extent.around(levels[:1])
    size = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    figure, (images, profiles) = new_panels(2, 2, size, title, heads=2, labels=(2, 2))
    names = (f"Mean amplitude, {len(found.seeds)} seeds", "Standard deviation of a seed")
    for axes, name, level in zip(images, names, levels, strict=True):
        draw_frame(axes, extent, size)
        axes.set_title(name, fontsize=LABEL_PT, pad=4)
        axes.set_facecolor(AMPLITUDE_BACKGROUND)
        if level.amplitude.any():
            drawn = draw_amplitude(axes, level, extent.unit, 0.0)
    row, _ = np.unravel_index(int(found.amplitude.argmax()), found.amplitude.shape)
    columns = (
        ("amplitude (maximum 1)", found.amplitude[row] / top, found.amplitude_sd[row] / top),
        (f"depth z ({extent.unit.name})", *(extent.unit.per_m * d[row] for d in depths(found))),
    )
    place = f"y = {typeset(f'{extent.unit.per_m * found.y_m[row]:.4g}')} {extent.unit.name}"
    for axes, column in zip(profiles, columns, strict=True):
        _draw_profile(axes, extent.unit.per_m * found.x_m, column, extent)
        axes.set_title(f"At {place}: mean, one deviation", fontsize=LABEL_PT, pad=4)
    amplitude_bar(images, drawn, dynamic_range_db)
    return settled(figure)


def depths(found: Spread) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and deviation of the depth where at least half of the seeds have one, metres."""
    often = 2 * found.depth_count >= len(found.seeds)
    depth_m, deviation_m = (
        np.where(often, values, np.nan) for values in (found.depth_m, found.depth_sd_m)
    )
    return depth_m, deviation_m


def _draw_profile(
    axes: Axes, x: np.ndarray, column: tuple[str, np.ndarray, np.ndarray], extent: Extent
) -> None:
    """Draw mean and band over x, which increases to the left as in the images above."""
    name, mean, deviation = column
    axes.fill_between(x, mean - deviation, mean + deviation, color=BAND, alpha=0.3, linewidth=0)
    axes.plot(x, mean, color=BAND, linewidth=1.0)
    axes.set_xlim(extent.x[1], extent.x[0])
    if name.startswith("amplitude"):
        axes.set_ylim(bottom=0.0)
    plain(axes, f"x ({extent.unit.name})", name)
