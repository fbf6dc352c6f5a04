"""One panel of a figure: an amplitude or a depth image with its axes and colour bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.compare import Disagreement, clipped_db
from clradar.model import DepthMap
from clradar.model.length_unit import LengthUnit, unit_for
from clradar.plot.layout import (
    LABEL_PT,
    TICK_DISTANCE,
    TICK_PT,
    Extent,
    axis_ticks,
    pixel_edges,
    round_ticks,
    typeset,
)
from clradar.plot.views import FRONT, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AMPLITUDE_BACKGROUND = "#262626"
"""Colour where the amplitude is below the dynamic range: neutral, and not in the scale."""

DEPTH_BACKGROUND = "#d9d9d9"
"""Colour where there is no depth: neutral, and not in the scale."""

DEPTH_PERCENTILES = (1.0, 99.0)
"""Depths that the colour scale spans, so that a few outliers do not stretch it."""


def draw_amplitude(
    axes: Axes, image: DepthMap, unit: LengthUnit, top_db: float | None = None
) -> Any:
    """Draw levels: relative to the image's maximum, or in dBsm below `top_db`."""
    from matplotlib.colors import ListedColormap

    scale = ListedColormap(amplitude_colours()).with_extremes(
        bad=AMPLITUDE_BACKGROUND, under=AMPLITUDE_BACKGROUND
    )
    level_db = clipped_db(image)
    level_db[level_db <= -image.dynamic_range_db] = np.nan
    limits = (-image.dynamic_range_db, 0.0)
    if top_db is not None:
        level_db += peak_dbsm(image)
        limits = (top_db - image.dynamic_range_db, top_db)
    return draw_mesh(axes, image, unit, level_db, scale, limits, AMPLITUDE_BACKGROUND)


def amplitude_colours() -> np.ndarray:
    """The colours of levels from the lower end of the dynamic range on, shape (256, 4), 0 to 1."""
    import matplotlib

    # Without the lower end of the scale, which is nearly black as the background is.
    return np.asarray(matplotlib.colormaps["inferno"](np.linspace(0.2, 1.0, 256)))


def peak_dbsm(image: DepthMap) -> float:
    """Return the maximum of an image whose squared amplitude is in m^2 (`Volume.as_rcs`)."""
    return 20 * math.log10(float(image.amplitude.max()))


def draw_depth(
    axes: Axes, image: DepthMap, unit: LengthUnit, limits_mm: tuple[float, float]
) -> Any:
    import matplotlib

    scale = matplotlib.colormaps["viridis_r"].with_extremes(bad=DEPTH_BACKGROUND)
    return draw_mesh(axes, image, unit, 1e3 * image.depth_m, scale, limits_mm, DEPTH_BACKGROUND)


def draw_mesh(
    axes: Axes,
    image: DepthMap | Disagreement,
    unit: LengthUnit,
    values: np.ndarray,
    scale: Any,
    limits: tuple[float, float],
    background: str,
) -> Any:
    axes.set_facecolor(background)
    x, y = pixel_edges(image, unit)
    # A mesh, not an image: it takes uneven steps and smooths nothing. Rasterised, because one path
    # per pixel makes PDF and SVG files enormous.
    return axes.pcolormesh(
        x,
        y,
        np.ma.masked_invalid(values),
        cmap=scale,
        vmin=limits[0],
        vmax=limits[1],
        shading="flat",
        rasterized=True,
    )


def draw_frame(
    axes: Axes,
    extent: Extent,
    width: float,
    height: float,
    *,
    x_labels: bool,
    y_labels: bool,
    margin: float,
    view: View = FRONT,
) -> None:
    """Set limits, ticks and labels; x increases to the left, in the radar's view and from above."""
    x_low, x_high = extent.x
    y_low, y_high = extent.y
    axes.set_xlim(*((x_high, x_low) if view.horizontal == "x" else (x_low, x_high)))
    axes.set_ylim(y_low, y_high)
    # A low image is at the lower edge, so that the labels of its x axis are below the colour bar.
    axes.set_aspect("equal", adjustable="box", anchor="S")
    axes.grid(visible=False)
    # An image much thinner than its panel has space for fewer ticks than the panel.
    inches = min(width / (x_high - x_low), height / (y_high - y_low))
    x_ticks = axis_ticks(x_low, x_high, (x_high - x_low) * inches, margin)
    most = (y_high - y_low) * inches / TICK_DISTANCE
    y_ticks = round_ticks(y_low, y_high, most, margin)
    if len(y_ticks) == 1:  # no scale to read; labels above each other take less than beside
        y_ticks = round_ticks(y_low, y_high, 2 * most, margin)
    axes.set_xticks(x_ticks, [typeset(f"{t:g}") if x_labels else "" for t in x_ticks])
    axes.set_yticks(y_ticks, [typeset(f"{t:g}") if y_labels else "" for t in y_ticks])
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    if x_labels:
        axes.set_xlabel(f"{view.horizontal} ({extent.unit.name})", fontsize=LABEL_PT, labelpad=2)
    if y_labels:
        axes.set_ylabel(f"{view.vertical} ({extent.unit.name})", fontsize=LABEL_PT, labelpad=1)


def depth_limits_mm(images: Sequence[DepthMap]) -> tuple[float, float]:
    """Return the depths that the colour scale of these images spans, whole millimetres."""
    return limits_of_depths_mm(
        np.concatenate([1e3 * image.depth_m[image.mask] for image in images])
    )


def limits_of_depths_mm(depths_mm: np.ndarray) -> tuple[float, float]:
    """Return what the colour scale of depths in millimetres, shape (n,), spans."""
    # Rounded first: 0.3 m is 299.999999… mm.
    low, high = np.round(np.percentile(depths_mm, DEPTH_PERCENTILES), 6)
    low, high = math.floor(low), math.ceil(high)
    if high - low < 2:
        low, high = low - 1, high + 1
    return float(low), float(high)


def amplitude_bar(
    axes: Axes, drawn: Any, dynamic_range_db: float, top_db: float | None = None
) -> None:
    bar = axes.figure.colorbar(drawn, cax=axes, extend="min", extendfrac=0.06)
    if top_db is None:
        label_bar(bar, (-dynamic_range_db, 0.0), "amplitude (dB)")
    else:
        label_bar(bar, (top_db - dynamic_range_db, top_db), "radar cross section (dBsm)")


def depth_bar(
    axes: Axes,
    drawn: Any,
    limits_mm: tuple[float, float],
    images: Sequence[DepthMap],
    view: View = FRONT,
) -> None:
    low = min(1e3 * float(np.nanmin(image.depth_m)) for image in images) < limits_mm[0] - 1e-6
    high = max(1e3 * float(np.nanmax(image.depth_m)) for image in images) > limits_mm[1] + 1e-6
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[(low, high)]
    bar = axes.figure.colorbar(drawn, cax=axes, extend=extend, extendfrac=0.06)
    unit = unit_for(*(1e-3 * limit for limit in limits_mm))
    name = "depth z" if view is FRONT else view.along
    label_bar(bar, limits_mm, f"{name} ({unit.name})", 1e3 / unit.per_m)


def label_bar(bar: Any, limits: tuple[float, float], name: str, scale: float = 1.0) -> None:
    """Label a bar with round numbers of a unit that is `scale` times that of the limits."""
    ticks = round_ticks(limits[0] / scale, limits[1] / scale, 5)
    bar.set_ticks([scale * t for t in ticks], labels=[typeset(f"{t:g}") for t in ticks])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    bar.outline.set_linewidth(0.6)
    bar.set_label(name, fontsize=LABEL_PT, labelpad=3)
