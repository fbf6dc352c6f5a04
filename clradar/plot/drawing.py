"""Panels of figures: their size and labels; amplitude, depth, or where two images differ in one.

matplotlib lays them out.
"""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from clradar.compare.images import Disagreement, clipped_db
from clradar.errors import quoted
from clradar.model import DepthMap
from clradar.model.length_unit import LengthUnit, unit_for
from clradar.plot.views import FRONT, View

DPI = 300  # of bitmaps: the narrowest panel has more dots than the usual image has pixels
TITLE_PT, LABEL_PT, TICK_PT, CAPTION_PT = 9.0, 8.0, 7.0, 7.0
LINE_SPACING = 1.5
POINTS_PER_INCH = 72.0
LETTER_EM = 0.66  # a generous mean width for the letters of a sans-serif font, in em

# Inches.
GAP, MARGIN, BAR_ROOM, LABELS = 0.11, 0.1, 0.85, 0.6
ROW_WIDTH, PANEL_WIDTH = 7.6, 1.0
SINGLE_PANEL_WIDTH, MULTIPLE_PANEL_WIDTH = 2.5, 2.1
PANEL_ASPECTS = (0.4, 2.5)
MOST_HEIGHT = 3.4
LEAST_IMAGE, LEAST_ROW = 1.1, 1.4  # for ticks and the name of a colour bar

AMPLITUDE_BACKGROUND = "#262626"  # below the dynamic range: neutral, and not in the scale
DEPTH_BACKGROUND = "#d9d9d9"  # where there is no depth: the same
MEASURED_COLOUR, SIMULATED_COLOUR = "#b35900", "#1f5fb0"  # ends of differences: stronger, nearer
CURVE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of Okabe and Ito (2008), which colour-blind readers distinguish."""

LEVEL_DB, DEPTH_MM = 20.0, 10.0  # ends of scales: an object is unmatched from 12 dB, from 10 mm
MATCHED_DB, MATCHED_COLOUR = 6.0, "#a8a8a8"  # images match below: speckle of two seeds differs so

AMPLITUDE_SCALE = ListedColormap(
    matplotlib.colormaps["inferno"](np.linspace(0.2, 1.0, 256))
).with_extremes(bad=AMPLITUDE_BACKGROUND, under=AMPLITUDE_BACKGROUND)
"""Without the lower end of the scale, which is nearly black as the background is."""

DEPTH_SCALE = matplotlib.colormaps["viridis_r"].with_extremes(bad=DEPTH_BACKGROUND)  # near is light
LOW, HIGH = (0.5 * (1 + sign * MATCHED_DB / LEVEL_DB) for sign in (-1, 1))
DIFFERENCE_SCALE, UNMATCHED_SCALE = (
    LinearSegmentedColormap.from_list("", colours).with_extremes(bad=DEPTH_BACKGROUND)
    for colours in (
        [SIMULATED_COLOUR, "white", MEASURED_COLOUR],
        [
            (0.0, SIMULATED_COLOUR), (LOW, "#c6d9ee"), (LOW, MATCHED_COLOUR),
            (HIGH, MATCHED_COLOUR), (HIGH, "#f0d9be"), (1.0, MEASURED_COLOUR),
        ],
    )
)  # fmt: skip
"""Of depths, blue where the simulation is nearer; of levels, grey where images match."""

RING_PT = 13.0  # diameter of the ring around an unmatched object
DEPTH_PERCENTILES = (1.0, 99.0)  # that colours span, so that a few outliers do not stretch them

BELOW_MAXIMUM, CROSS_SECTION = "below maximum (dB)", "radar cross section (dBsm)"


@dataclass(frozen=True, slots=True)
class Extent:
    """The region that all panels of a figure show, in the unit that it is labelled in."""

    x: tuple[float, float]
    y: tuple[float, float]
    unit: LengthUnit

    @classmethod
    def around(
        cls, images: Sequence[DepthMap | Disagreement], unit: LengthUnit | None = None
    ) -> Extent:
        centres_m = [float(axis[i]) for m in images for axis in (m.x_m, m.y_m) for i in (0, -1)]
        unit = unit or unit_for(*centres_m)
        edges = zip(*(pixel_edges(image, unit) for image in images), strict=True)
        x, y = ((min(e[0] for e in ends), max(e[-1] for e in ends)) for ends in edges)
        return cls(x, y, unit)

    @property
    def aspect(self) -> float:
        """Height over width of a panel; limited, so that a thin image does not fill its panel."""
        ratio = (self.y[1] - self.y[0]) / (self.x[1] - self.x[0])
        return float(np.clip(ratio, *PANEL_ASPECTS))


def pixel_edges(image: DepthMap | Disagreement, unit: LengthUnit) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders between pixels along x and y, one more than pixels."""
    axes = (unit.per_m * image.x_m, unit.per_m * image.y_m)
    # A single row or column has no spacing of its own: as wide as the other axis' pixels, or 1 mm.
    step = min((np.diff(a).min() for a in axes if len(a) > 1), default=1e-3 * unit.per_m)
    edges = []
    for axis in axes:
        half = np.diff(axis) / 2 if len(axis) > 1 else np.array([step / 2])
        edges.append(np.concatenate([axis[:1] - half[:1], axis[:-1] + half, axis[-1:] + half[-1:]]))
    return edges[0], edges[1]


def panel_size(width: float, aspect: float) -> tuple[float, float]:
    """Return the width and height of a panel, inches: as near to `width` as the limits allow."""
    height = min(max(width, PANEL_WIDTH) * aspect, MOST_HEIGHT)
    return max(height / aspect, PANEL_WIDTH), height


def new_figure(
    width: float, height: float, title: str | None = None, dpi: float | None = None
) -> Figure:
    """Return an empty figure of a size in inches, laid out by matplotlib, with a plain title."""
    figure = Figure((width, height), dpi or DPI, facecolor="white", layout="constrained")
    lines = wrapped(title or "", width - BAR_ROOM, TITLE_PT)
    if lines:
        figure.suptitle("\n".join(lines), fontsize=TITLE_PT, fontweight="bold", parse_math=False)
    return figure


def new_panels(
    rows: int,
    columns: int,
    size: tuple[float, float],
    title: str | None = None,
    *,
    bars: int = 1,
    labels: int = 1,
    dpi: float | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows of panels of a size in inches, to be laid out by `settled`.

    There is room for `bars` colour bars side by side, and labels to the left of some columns.
    """
    width = columns * (size[0] + GAP) + labels * LABELS + bars * BAR_ROOM
    low = size[1] < LEAST_IMAGE  # rows are higher than images; `settled` takes what is too much
    height = rows * (LEAST_ROW if low else size[1] + 1.0) + 1.0
    figure = new_figure(width, height, title, dpi)
    figure.set_layout_engine(
        "constrained" if low else "compressed", w_pad=GAP / 4, h_pad=GAP / 4, wspace=0.0, hspace=0.0
    )
    return figure, figure.subplots(rows, columns, squeeze=False).tolist()


def settled(figure: Figure, below: float = 0.0) -> Figure:
    """Lay a figure out: its axes then have their places, whatever its resolution.

    It is as high as axes, titles and `below` inches below them.
    """
    engine: Any = figure.get_layout_engine()
    engine.execute(figure)
    figure.set_layout_engine("none")
    to_inches = figure.dpi_scale_trans.inverted().transform_bbox
    drawn = to_inches(Bbox.union([a.get_tightbbox() or a.bbox for a in figure.axes]))
    titles = sum(GAP + to_inches(text.get_window_extent()).height for text in figure.texts)
    boxes = [to_inches(axes.bbox) for axes in figure.axes]
    width, height = figure.get_figwidth(), below + drawn.height + titles + MARGIN / 2
    figure.set_figheight(height)
    for axes, box in zip(figure.axes, boxes, strict=True):
        bottom = box.y0 - drawn.y0 + below + MARGIN / 4
        axes.set_position((box.x0 / width, bottom / height, box.width / width, box.height / height))
    for text in figure.texts:
        text.set(y=1.0 - MARGIN / 4 / height, va="top")
    return figure


def text_height(lines: float, size_pt: float = CAPTION_PT) -> float:
    """Return the height of some lines of text, inches."""
    return lines * size_pt * LINE_SPACING / POINTS_PER_INCH


def title_panel(axes: Axes, label: str, width: float, size_pt: float) -> None:
    """Write a title that is as wide as a panel, in lines."""
    lines = "\n".join(wrapped(label, width, size_pt))
    axes.set_title(lines, fontsize=size_pt, pad=4, parse_math=False)


def wrapped(text: object, width: float, size_pt: float, most: int = 3) -> list[str]:
    """Break lines of text into at most `most` of a width in inches; more ends in an ellipsis."""
    letters = max(8, int(width * POINTS_PER_INCH / (LETTER_EM * size_pt)))
    wrapper = textwrap.TextWrapper(letters, max_lines=most, placeholder="…")
    parts = (quoted(part, sys.maxsize) for part in str(text).split("\n"))
    return [line for part in parts for line in wrapper.wrap(part)][:most]


def typeset(number: str) -> str:
    """Return a number with a true minus sign."""
    return number.replace("-", "\N{MINUS SIGN}")


def label_axes(axes: Axes, x_name: str, y_name: str, title: str = "", *, grid: bool = True) -> None:
    """Give axes their names, title, and the type of all figures."""
    axes.grid(visible=False)
    if grid:
        axes.grid(linewidth=0.3)
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    axes.set_xlabel(x_name, fontsize=LABEL_PT, labelpad=2)
    axes.set_ylabel(y_name, fontsize=LABEL_PT, labelpad=1)
    if title:
        axes.set_title(title, fontsize=LABEL_PT, pad=4, parse_math=False)


class InnerTicks(MaxNLocator):
    """Round values, a share `away` of the axis from its ends: labels of neighbours do not touch."""

    def __init__(self, away: float) -> None:
        super().__init__("auto", steps=[1, 2, 5, 10], min_n_ticks=1)
        self._away = away

    def tick_values(self, vmin: float, vmax: float) -> Any:
        low, high = sorted((vmin, vmax))
        away = self._away * (high - low)
        inner = [v for v in super().tick_values(low, high) if low + away <= v <= high - away]
        return np.array(inner or [(low + high) / 2])


def colours_of(scale: Any) -> np.ndarray:
    """Return the 256 colours of a scale, shape (256, 3), uint8."""
    return np.round(255 * scale(np.linspace(0.0, 1.0, 256))[:, :3]).astype(np.uint8)


def peak_dbsm(image: DepthMap) -> float:
    """Return the maximum of an image whose squared amplitude is in m^2 (`Volume.as_rcs`)."""
    return 20 * math.log10(float(image.amplitude.max()))


def amplitude(
    axes: Axes, image: DepthMap, extent: Extent, top_db: float | None = None, **framed: Any
) -> QuadMesh:
    """Draw levels: relative to the image's maximum, or in dBsm below `top_db`."""
    level_db = clipped_db(image)
    level_db[level_db <= -image.dynamic_range_db] = np.nan
    if top_db is not None:
        level_db += peak_dbsm(image)
    top_db = top_db or 0.0
    limits = (top_db - image.dynamic_range_db, top_db)
    return _mesh(axes, image, level_db, AMPLITUDE_SCALE, limits, extent, framed)


def depth(
    axes: Axes, image: DepthMap, extent: Extent, limits_mm: tuple[float, float], **framed: Any
) -> QuadMesh:
    """Draw depths, in the unit of their limits."""
    unit = unit_for(*(1e-3 * limit for limit in limits_mm))
    low, high = (1e-3 * unit.per_m * limit for limit in limits_mm)
    values = unit.per_m * image.depth_m
    return _mesh(axes, image, values, DEPTH_SCALE, (low, high), extent, framed)


def level_difference(axes: Axes, found: Disagreement, extent: Extent, **framed: Any) -> QuadMesh:
    """Draw where an image is stronger than all of the other nearby, with unmatched objects."""
    limits = (-LEVEL_DB, LEVEL_DB)
    drawn = _mesh(axes, found, found.level_db, UNMATCHED_SCALE, limits, extent, framed)
    rings: list[tuple[Any, Any]] = [(one, "solid") for one in found.missing]
    rings += [(one, (0, (1.5, 1.5))) for one in found.surplus]
    for one, style in rings:
        x, y = (extent.unit.per_m * value for value in one.position_m[:2])
        # A scatter, since a marker of a line cannot have a dashed edge.
        axes.scatter(
            [x], [y], s=RING_PT**2, facecolors="none", edgecolors="black", linewidths=1.0,
            linestyles=[style], clip_on=False, zorder=3,
        )  # fmt: skip
    return drawn


def _mesh(
    axes: Axes,
    image: DepthMap | Disagreement,
    values: np.ndarray,
    scale: Colormap,
    limits: tuple[float, float],
    extent: Extent,
    framed: Mapping[str, Any],
) -> QuadMesh:
    """Draw values by the colours of a scale; where there are none is its background."""
    frame(axes, extent, **framed)
    axes.set_facecolor(scale.get_bad())
    # A mesh, not an image: it takes uneven steps and smooths nothing. Rasterised, because one path
    # per pixel makes PDF and SVG files enormous.
    return axes.pcolormesh(
        *pixel_edges(image, extent.unit), np.ma.masked_invalid(values), cmap=scale,
        vmin=limits[0], vmax=limits[1], shading="flat", rasterized=True,
    )  # fmt: skip


def frame(
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


def add_bar(
    panels: Sequence[Axes], drawn: Any, name: str = BELOW_MAXIMUM, extend: str = "min"
) -> None:
    """Add a colour bar beside some panels."""
    bar: Any = panels[0].figure.colorbar(
        drawn, ax=list(panels), extend=extend, extendfrac=0.06, fraction=0.06, pad=0.02, aspect=25
    )
    bar.locator = MaxNLocator(5, steps=[1, 2, 5, 10])
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    bar.outline.set_linewidth(0.6)
    bar.set_label(name, fontsize=LABEL_PT, labelpad=3)
