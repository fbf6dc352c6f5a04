"""The figure of an image's mean and standard deviation over seeds, with profiles and their band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap, Spread
from clradar.plot.layout import (
    SINGLE_PANEL_WIDTH,
    Extent,
    label_axes,
    new_panels,
    panel_size,
    settled,
    typeset,
)
from clradar.plot.panels import CURVE_COLOURS, amplitude_bar, draw_amplitude, draw_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVELS_DB = 30.0
"""Of the images, decibel."""

BAND = CURVE_COLOURS[0]


def spread_figure(
    found: Spread, title: str | None = None, *, dynamic_range_db: float = LEVELS_DB
) -> Figure:
    """Draw mean and standard deviation of an image over seeds, and profiles with their band.

    Axes in this order: mean of the amplitude, and its standard deviation on the same scale, in dB
    relative to the largest mean, down to `dynamic_range_db` below it; amplitude and depth along x
    through that maximum, as mean with a band of one standard deviation to either side, the depth
    where at least half of the seeds have one; the colour bar. A mean that is zero everywhere, or an
    image of fewer than two pixels along x or y, is a `CompareError`.
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
    unit = extent.unit
    size = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    figure, (images, profiles) = new_panels(2, 2, size, title, labels=2)
    names = (f"Mean amplitude, {len(found.seeds)} seeds", "Standard deviation of a seed")
    for axes, name, level in zip(images, names, levels, strict=True):
        draw_frame(axes, extent, name)
        if level.amplitude.any():
            drawn = draw_amplitude(axes, level, unit, 0.0)
        else:
            axes.set_facecolor(images[0].get_facecolor())
    row, _ = np.unravel_index(int(found.amplitude.argmax()), found.amplitude.shape)
    often = 2 * found.depth_count[row] >= len(found.seeds)
    place = f"y = {typeset(f'{unit.per_m * found.y_m[row]:.4g}')} {unit.name}"
    amplitudes = found.amplitude[row] / top, found.amplitude_sd[row] / top
    depth, depth_sd = (
        np.where(often, unit.per_m * values[row], np.nan)
        for values in (found.depth_m, found.depth_sd_m)
    )
    curves = {"amplitude (maximum 1)": amplitudes, f"depth z ({unit.name})": (depth, depth_sd)}
    for axes, (name, (mean, deviation)) in zip(profiles, curves.items(), strict=True):
        x = unit.per_m * found.x_m
        axes.fill_between(x, mean - deviation, mean + deviation, color=BAND, alpha=0.3, linewidth=0)
        axes.plot(x, mean, color=BAND, linewidth=1.0)
        axes.set_box_aspect(extent.aspect)
        axes.set_xlim(extent.x[1], extent.x[0])  # to the left, as in the images above
        x_name = f"\N{LEFTWARDS ARROW} x ({unit.name})"
        label_axes(axes, x_name, name, f"At {place}: mean, one deviation")
    profiles[0].set_ylim(bottom=0.0)
    amplitude_bar(images, drawn)
    return settled(figure)
