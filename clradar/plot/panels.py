"""One panel of a figure: amplitude, depth, or where two images differ; axes and colour bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.compare import Disagreement, UnmatchedObject, clipped_db
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

MEASURED_COLOUR, SIMULATED_COLOUR = "#b35900", "#1f5fb0"
"""Ends of the scales of differences: the measurement is stronger or nearer, or the simulation."""

LEVEL_DB, DEPTH_MM = 20.0, 10.0
"""Ends of these scales. An object is unmatched from 12 dB, and from 10 mm."""

MATCHED_DB, MATCHED_COLOUR = 6.0, "#a8a8a8"
"""Below this images match: a speckle of another seed differs by as much."""

RING_PT = 13.0
"""Diameter of the ring around an unmatched object."""

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
    size: tuple[float, float],
    *,
    x_labels: bool = True,
    y_labels: bool = True,
    margin: float = 0.0,
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
    inches = min(size[0] / (x_high - x_low), size[1] / (y_high - y_low))
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
        arrow = "\N{LEFTWARDS ARROW} " if view.horizontal == "x" else ""
        name = f"{arrow}{view.horizontal} ({extent.unit.name})"
        axes.set_xlabel(name, fontsize=LABEL_PT, labelpad=2)
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
    panels: Sequence[Axes], drawn: Any, dynamic_range_db: float, top_db: float | None = None
) -> None:
    """Add the colour bar of amplitudes beside some panels."""
    bar = _bar(panels, drawn, "min")
    if top_db is None:
        label_bar(bar, (-dynamic_range_db, 0.0), "below maximum (dB)")
    else:
        label_bar(bar, (top_db - dynamic_range_db, top_db), "radar cross section (dBsm)")


def depth_bar(
    panels: Sequence[Axes],
    drawn: Any,
    limits_mm: tuple[float, float],
    images: Sequence[DepthMap],
    view: View = FRONT,
) -> None:
    low = min(1e3 * float(np.nanmin(image.depth_m)) for image in images) < limits_mm[0] - 1e-6
    high = max(1e3 * float(np.nanmax(image.depth_m)) for image in images) > limits_mm[1] + 1e-6
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[(low, high)]
    bar = _bar(panels, drawn, extend)
    unit = unit_for(*(1e-3 * limit for limit in limits_mm))
    name = "depth z" if view is FRONT else view.along
    label_bar(bar, limits_mm, f"{name} ({unit.name})", 1e3 / unit.per_m)


def difference_bar(panels: Sequence[Axes], drawn: Any, end: float, name: str) -> None:
    """Add the colour bar of differences up to an end beside some panels."""
    label_bar(_bar(panels, drawn, "both"), (-end, end), name)


def _bar(panels: Sequence[Axes], drawn: Any, extend: str) -> Any:
    # As high as a panel where images are lower than that: their names need the room.
    return panels[0].figure.colorbar(
        drawn, ax=list(panels), extend=extend, extendfrac=0.06, fraction=0.06, pad=0.02, aspect=25
    )


def draw_level_difference(axes: Axes, found: Disagreement, unit: LengthUnit) -> Any:
    """Draw where an image is stronger than all of the other nearby, with unmatched objects."""
    from matplotlib.colors import LinearSegmentedColormap

    share = 0.5 * MATCHED_DB / LEVEL_DB
    colours = [
        (0.0, SIMULATED_COLOUR), (0.5 - share, "#c6d9ee"), (0.5 - share, MATCHED_COLOUR),
        (0.5 + share, MATCHED_COLOUR), (0.5 + share, "#f0d9be"), (1.0, MEASURED_COLOUR),
    ]  # fmt: skip
    scale = LinearSegmentedColormap.from_list("unmatched", colours)
    limits = (-LEVEL_DB, LEVEL_DB)
    drawn = draw_mesh(axes, found, unit, found.level_db, scale, limits, DEPTH_BACKGROUND)
    for one in found.missing:
        _draw_ring(axes, one, unit, "solid")
    for one in found.surplus:
        _draw_ring(axes, one, unit, (0, (1.5, 1.5)))
    return drawn


def draw_depth_difference(axes: Axes, found: Disagreement, unit: LengthUnit) -> Any:
    """Draw how much nearer or farther the simulation is."""
    values, limits = 1e3 * found.depth_m, (-DEPTH_MM, DEPTH_MM)
    return draw_mesh(axes, found, unit, values, difference_scale(), limits, DEPTH_BACKGROUND)


def difference_scale() -> Any:
    """Return the colours of differences in depth: blue where the simulation is nearer."""
    from matplotlib.colors import LinearSegmentedColormap

    colours = [SIMULATED_COLOUR, "white", MEASURED_COLOUR]
    return LinearSegmentedColormap.from_list("differences", colours)


def _draw_ring(axes: Axes, one: UnmatchedObject, unit: LengthUnit, style: Any) -> None:
    x, y = (unit.per_m * value for value in one.position_m[:2])
    # A scatter, since a marker of a line cannot have a dashed edge.
    axes.scatter(
        [x], [y], s=RING_PT**2, facecolors="none", edgecolors="black", linewidths=1.0,
        linestyles=[style], clip_on=False, zorder=3,
    )  # fmt: skip


def label_bar(bar: Any, limits: tuple[float, float], name: str, scale: float = 1.0) -> None:
    """Label a bar with round numbers of a unit that is `scale` times that of the limits."""
    ticks = round_ticks(limits[0] / scale, limits[1] / scale, 5)
    bar.set_ticks([scale * t for t in ticks], labels=[typeset(f"{t:g}") for t in ticks])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    bar.outline.set_linewidth(0.6)
    bar.set_label(name, fontsize=LABEL_PT, labelpad=3)
