"""One panel of a figure: amplitude, depth, or where two images differ; axes and colour bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.compare import Disagreement, clipped_db
from clradar.model import DepthMap
from clradar.model.length_unit import LengthUnit, unit_for
from clradar.plot.layout import LABEL_PT, TICK_PT, Extent, label_axes, pixel_edges
from clradar.plot.views import FRONT, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AMPLITUDE_BACKGROUND = "#262626"
"""Colour where the amplitude is below the dynamic range: neutral, and not in the scale."""

DEPTH_BACKGROUND = "#d9d9d9"
"""Colour where there is no depth: neutral, and not in the scale."""

MEASURED_COLOUR, SIMULATED_COLOUR = "#b35900", "#1f5fb0"
"""Ends of the scales of differences: the measurement is stronger or nearer, or the simulation."""

CURVE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of Okabe and Ito (2008), which colour-blind readers distinguish."""

LEVEL_DB, DEPTH_MM = 20.0, 10.0
"""Ends of these scales. An object is unmatched from 12 dB, and from 10 mm."""

MATCHED_DB, MATCHED_COLOUR = 6.0, "#a8a8a8"
"""Below this images match: a speckle of another seed differs by as much."""

RING_PT = 13.0
"""Diameter of the ring around an unmatched object."""

DEPTH_PERCENTILES = (1.0, 99.0)
"""Depths that the colour scale spans, so that a few outliers do not stretch it."""

BELOW_MAXIMUM, CROSS_SECTION = "below maximum (dB)", "radar cross section (dBsm)"


def amplitude_scale() -> Any:
    """Return the colours of levels, from the lower end of the dynamic range on."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    # Without the lower end of the scale, which is nearly black as the background is.
    colours = matplotlib.colormaps["inferno"](np.linspace(0.2, 1.0, 256))
    background = {"bad": AMPLITUDE_BACKGROUND, "under": AMPLITUDE_BACKGROUND}
    return ListedColormap(colours).with_extremes(**background)


def depth_scale() -> Any:
    """Return the colours of depths: near is light."""
    import matplotlib

    return matplotlib.colormaps["viridis_r"].with_extremes(bad=DEPTH_BACKGROUND)


def difference_scale() -> Any:
    """Return the colours of differences in depth: blue where the simulation is nearer."""
    from matplotlib.colors import LinearSegmentedColormap

    colours = [SIMULATED_COLOUR, "white", MEASURED_COLOUR]
    return LinearSegmentedColormap.from_list("differences", colours)


def unmatched_scale() -> Any:
    """Return the colours of differences in level: grey where images match."""
    from matplotlib.colors import LinearSegmentedColormap

    share = 0.5 * MATCHED_DB / LEVEL_DB
    colours = [
        (0.0, SIMULATED_COLOUR), (0.5 - share, "#c6d9ee"), (0.5 - share, MATCHED_COLOUR),
        (0.5 + share, MATCHED_COLOUR), (0.5 + share, "#f0d9be"), (1.0, MEASURED_COLOUR),
    ]  # fmt: skip
    return LinearSegmentedColormap.from_list("unmatched", colours)


def colours_of(scale: Any) -> np.ndarray:
    """Return the 256 colours of a scale, shape (256, 3), uint8."""
    return np.round(255 * scale(np.linspace(0.0, 1.0, 256))[:, :3]).astype(np.uint8)


def peak_dbsm(image: DepthMap) -> float:
    """Return the maximum of an image whose squared amplitude is in m^2 (`Volume.as_rcs`)."""
    return 20 * math.log10(float(image.amplitude.max()))


def draw_amplitude(
    axes: Axes, image: DepthMap, unit: LengthUnit, top_db: float | None = None
) -> Any:
    """Draw levels: relative to the image's maximum, or in dBsm below `top_db`."""
    level_db = clipped_db(image)
    level_db[level_db <= -image.dynamic_range_db] = np.nan
    if top_db is not None:
        level_db += peak_dbsm(image)
    top_db = top_db or 0.0
    limits = (top_db - image.dynamic_range_db, top_db)
    return draw_mesh(axes, image, unit, level_db, amplitude_scale(), limits)


def draw_depth(
    axes: Axes, image: DepthMap, unit: LengthUnit, limits_mm: tuple[float, float]
) -> Any:
    """Draw depths, in the unit of their limits."""
    depth_unit = unit_for(*(1e-3 * limit for limit in limits_mm))
    low, high = (1e-3 * depth_unit.per_m * limit for limit in limits_mm)
    values = depth_unit.per_m * image.depth_m
    return draw_mesh(axes, image, unit, values, depth_scale(), (low, high))


def draw_mesh(
    axes: Axes,
    image: DepthMap | Disagreement,
    unit: LengthUnit,
    values: np.ndarray,
    scale: Any,
    limits: tuple[float, float],
) -> Any:
    """Draw values by the colours of a scale; where there are none is its background."""
    axes.set_facecolor(scale.get_bad())
    # A mesh, not an image: it takes uneven steps and smooths nothing. Rasterised, because one path
    # per pixel makes PDF and SVG files enormous.
    return axes.pcolormesh(
        *pixel_edges(image, unit), np.ma.masked_invalid(values), cmap=scale,
        vmin=limits[0], vmax=limits[1], shading="flat", rasterized=True,
    )  # fmt: skip


def draw_level_difference(axes: Axes, found: Disagreement, unit: LengthUnit) -> Any:
    """Draw where an image is stronger than all of the other nearby, with unmatched objects."""
    scale = unmatched_scale().with_extremes(bad=DEPTH_BACKGROUND)
    drawn = draw_mesh(axes, found, unit, found.level_db, scale, (-LEVEL_DB, LEVEL_DB))
    rings: list[tuple[Any, Any]] = [(one, "solid") for one in found.missing]
    rings += [(one, (0, (1.5, 1.5))) for one in found.surplus]
    for one, style in rings:
        x, y = (unit.per_m * value for value in one.position_m[:2])
        # A scatter, since a marker of a line cannot have a dashed edge.
        axes.scatter(
            [x], [y], s=RING_PT**2, facecolors="none", edgecolors="black", linewidths=1.0,
            linestyles=[style], clip_on=False, zorder=3,
        )  # fmt: skip
    return drawn


def draw_frame(
    axes: Axes,
    extent: Extent,
    title: str = "",
    *,
    x_labels: bool = True,
    y_labels: bool = True,
    margin: float = 0.0,
    view: View = FRONT,
) -> None:
    """Set limits, ticks and labels; x increases to the left, in the radar's view and from above."""
    from clradar.plot.ticks import InnerTicks

    arrow = "\N{LEFTWARDS ARROW} " if view.horizontal == "x" else ""
    x_name, y_name = (
        f"{name} ({extent.unit.name})" for name in (arrow + view.horizontal, view.vertical)
    )
    label_axes(axes, x_name * x_labels, y_name * y_labels, title, grid=False)
    axes.set_xlim(*(extent.x[::-1] if view.horizontal == "x" else extent.x))
    axes.set_ylim(*extent.y)
    # A low image is at the lower edge, so that the labels of its x axis are below the colour bar.
    axes.set_aspect("equal", adjustable="box", anchor="S")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(InnerTicks(margin))
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelbottom=x_labels, labelleft=y_labels)


def depth_limits_mm(images: Sequence[DepthMap]) -> tuple[float, float]:
    """The depths that the colour scale of these images spans, whole millimetres."""
    depths_mm = np.concatenate([1e3 * image.depth_m[image.mask] for image in images])
    # Rounded first: 0.3 m is 299.999999… mm.
    low, high = np.round(np.percentile(depths_mm, DEPTH_PERCENTILES), 6)
    low, high = math.floor(low), math.ceil(high)
    if high - low < 2:
        low, high = low - 1, high + 1
    return float(low), float(high)


def amplitude_bar(panels: Sequence[Axes], drawn: Any, *, dbsm: bool = False) -> None:
    """Add the colour bar of amplitudes beside some panels."""
    add_bar(panels, drawn, CROSS_SECTION if dbsm else BELOW_MAXIMUM, "min")


def depth_bar(
    panels: Sequence[Axes], drawn: Any, images: Sequence[DepthMap], view: View = FRONT
) -> None:
    """Add the colour bar of depths, with an arrow to where some are beyond it."""
    ends_m = [end(image.depth_m) for end in (np.nanmin, np.nanmax) for image in images]
    unit = unit_for(*(1e-3 * limit for limit in depth_limits_mm(images)))
    low, high = drawn.get_clim()
    outside = unit.per_m * min(ends_m) < low - 1e-6, unit.per_m * max(ends_m) > high + 1e-6
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[outside]
    add_bar(panels, drawn, f"{'depth z' if view is FRONT else view.along} ({unit.name})", extend)


def add_bar(panels: Sequence[Axes], drawn: Any, name: str, extend: str = "both") -> None:
    """Add a colour bar beside some panels."""
    from matplotlib.ticker import MaxNLocator

    bar: Any = panels[0].figure.colorbar(
        drawn, ax=list(panels), extend=extend, extendfrac=0.06, fraction=0.06, pad=0.02, aspect=25
    )
    bar.locator = MaxNLocator(5, steps=[1, 2, 5, 10])
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    bar.outline.set_linewidth(0.6)
    bar.set_label(name, fontsize=LABEL_PT, labelpad=3)
