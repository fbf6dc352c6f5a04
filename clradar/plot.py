"""Figures of images and of comparisons, drawn as the radar sees the scene.

Everything is built on `matplotlib.figure.Figure`: no pyplot, no open windows, no state between
calls. Layouts are computed in inches, so that nothing overlaps whatever the number of columns.
"""

from __future__ import annotations

import io
import math
import os
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from clradar.compare import Metrics, clipped_db, compare, depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError, OutputError
from clradar.files.atomic import replacing
from clradar.model import DepthMap, Volume

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".svg")
"""The kinds of file that `save_figure` writes."""

AMPLITUDE_BACKGROUND = "#262626"
"""Drawn where the amplitude is below the dynamic range: neutral, and no colour of the scale."""

DEPTH_BACKGROUND = "#d9d9d9"
"""Drawn where there is no depth: neutral, and no colour of the scale."""

DEPTH_PERCENTILES = (1.0, 99.0)
"""The depths that the colour scale spans; a few stray pixels must not flatten the rest."""

DPI = 300
"""Of bitmaps: the narrowest panel still has more dots than the usual image has pixels."""

TITLE_PT, LABEL_PT, TICK_PT, CAPTION_PT = 9.0, 8.0, 7.0, 7.0
LINE_SPACING = 1.5
POINTS_PER_INCH = 72.0

# Inches.
LEFT, GAP, TOP, BOTTOM = 0.62, 0.11, 0.10, 0.44
BAR_GAP, BAR_WIDTH, BAR_LABELS = 0.12, 0.11, 0.58
ROW_WIDTH, PANEL_WIDTH = 9.5, 1.0
SINGLE_PANEL_WIDTH, MULTIPLE_PANEL_WIDTH = 2.9, 2.1
PANEL_ASPECTS = (0.4, 2.5)
PANEL_HEIGHTS = (1.0, 3.4)  # at least as high as the name of a colour bar is long
TICK_DISTANCE = 0.32

CAPTION_NAMES = (
    "overlap",
    "dB correlation",
    "SSIM",
    "mask IoU",
    "depth RMSE (mm)",
    "Chamfer sim. to meas. (mm)",
)


def image_figure(
    image: Volume | DepthMap,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw the amplitude and the depth of one image side by side.

    Parameters
    ----------
    image : Volume or DepthMap
    title : str, optional
        Plain text above both panels.
    dynamic_range_db : float, decibel
        What is further below the maximum is background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: amplitude, depth, colour bar of the amplitude, colour bar of the depth.

    Raises
    ------
    CompareError
        Not an image, zero everywhere, without any depth, or a depth map that was cut at a smaller
        dynamic range.
    """
    from matplotlib.figure import Figure

    shown = depth_map_of(image, dynamic_range_db, "image")
    extent = _Extent.around([shown])
    panel_w, panel_h = _panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    lines = _wrapped(title or "", 2 * panel_w, TITLE_PT)
    bar = BAR_GAP + BAR_WIDTH + BAR_LABELS
    width = LEFT + panel_w + bar + LEFT + panel_w + bar
    height = BOTTOM + panel_h + _height(1, LABEL_PT) + _height(len(lines), TITLE_PT) + 2 * TOP
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")

    lefts = (LEFT, LEFT + panel_w + bar + LEFT)
    axes = [_axes(figure, left, BOTTOM, panel_w, panel_h) for left in lefts]
    amplitude = _draw_amplitude(axes[0], shown)
    limits_mm = depth_limits_mm([shown])
    depth = _draw_depth(axes[1], shown, limits_mm)
    for panel, name in zip(axes, ("Amplitude, maximum over depth", "Depth"), strict=True):
        _frame(panel, extent, panel_w, panel_h, x_labels=True, y_labels=True, margin=0.0)
        panel.set_title(name, fontsize=LABEL_PT, pad=4)
    bars = [_axes(figure, at + panel_w + BAR_GAP, BOTTOM, BAR_WIDTH, panel_h) for at in lefts]
    _amplitude_bar(bars[0], amplitude, dynamic_range_db)
    _depth_bar(bars[1], depth, limits_mm, [shown])
    middle = (lefts[0] + lefts[1] + panel_w) / 2
    for row, line in enumerate(lines):
        top = height - TOP - _height(row, TITLE_PT)
        _text(figure, middle, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure


def comparison_figure(
    measured: Volume | DepthMap,
    simulated: Sequence[tuple[str, Volume | DepthMap]],
    *,
    metrics: Sequence[Metrics] | None = None,
    measured_label: str = "Measurement",
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw a measured image and simulated ones in a row, amplitude above depth.

    Parameters
    ----------
    measured : Volume or DepthMap
    simulated : sequence of (label, Volume or DepthMap)
        One column each, in this order. Labels are plain text; long ones are wrapped.
    metrics : sequence of Metrics, optional
        One for each simulated image, printed below it. None computes them with
        `clradar.compare.compare`; an empty sequence leaves them out.
    measured_label : str
        Title of the first column.
    dynamic_range_db : float, decibel
        What is further below an image's own maximum is background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: the amplitudes from left to right, the depths, the colour bar of all
        amplitudes, the colour bar of all depths.

    Raises
    ------
    CompareError
        No simulated image, metrics of another number or another dynamic range, or what
        `clradar.compare.compare` refuses.
    """
    from matplotlib.figure import Figure

    if not simulated:
        raise CompareError("comparison_figure: expected at least one simulated image, got none")
    shown = [depth_map_of(measured, dynamic_range_db, "measured image")]
    for label, image in simulated:
        shown.append(depth_map_of(image, dynamic_range_db, f"simulated image '{label}'"))
    if metrics is None:
        metrics = [compare(shown[0], s, dynamic_range_db=dynamic_range_db) for s in shown[1:]]
    _check_metrics(metrics, len(simulated), dynamic_range_db)

    extent = _Extent.around(shown)
    columns = len(shown)
    panel_w, panel_h = _panel_size(
        min(ROW_WIDTH / columns - GAP, MULTIPLE_PANEL_WIDTH), extent.aspect
    )
    titles = [_wrapped(t, panel_w, TITLE_PT) for t in (measured_label, *(s[0] for s in simulated))]
    title_h = _height(max(map(len, titles)), TITLE_PT)
    caption_h = _height(len(CAPTION_NAMES), CAPTION_PT) + TOP if metrics else 0.0
    bar_left = LEFT + columns * (panel_w + GAP) - GAP + BAR_GAP
    width = bar_left + BAR_WIDTH + BAR_LABELS
    lower = caption_h + BOTTOM
    upper = lower + panel_h + GAP
    height = upper + panel_h + title_h + 2 * TOP
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")

    lefts = [LEFT + i * (panel_w + GAP) for i in range(columns)]
    above = [_axes(figure, left, upper, panel_w, panel_h) for left in lefts]
    below = [_axes(figure, left, lower, panel_w, panel_h) for left in lefts]
    limits_mm = depth_limits_mm(shown)
    for i, image in enumerate(shown):
        amplitude = _draw_amplitude(above[i], image)
        depth = _draw_depth(below[i], image, limits_mm)
        _frame(above[i], extent, panel_w, panel_h, x_labels=False, y_labels=i == 0, margin=0.12)
        _frame(below[i], extent, panel_w, panel_h, x_labels=True, y_labels=i == 0, margin=0.12)
        # parse_math: a label can be a file's name, and a dollar sign in it is one.
        above[i].set_title("\n".join(titles[i]), fontsize=TITLE_PT, pad=4, parse_math=False)
    _amplitude_bar(_axes(figure, bar_left, upper, BAR_WIDTH, panel_h), amplitude, dynamic_range_db)
    _depth_bar(_axes(figure, bar_left, lower, BAR_WIDTH, panel_h), depth, limits_mm, shown)
    # Row by row: the lines of one text are not evenly spaced, those of two would not line up.
    for row, name in enumerate(CAPTION_NAMES if metrics else ()):
        top = caption_h - _height(row, CAPTION_PT)
        _text(figure, lefts[0] + panel_w, top, name, size=CAPTION_PT, ha="right")
        for left, values in zip(lefts[1:], metrics, strict=True):
            value = _caption_values(values)[row]
            _text(figure, left + panel_w / 2, top, value, size=CAPTION_PT, ha="center")
    return figure


def panels_figure(
    panels: Sequence[Sequence[tuple[str, DepthMap | None]]],
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw the amplitudes of several images in rows, each relative to its own maximum.

    Parameters
    ----------
    panels : sequence of rows of (label, DepthMap or None)
        From top to bottom and left to right. Labels are plain text. Each panel has axes of its own;
        one without an image, or of an image that is zero, stays empty.
    title : str, optional
        Plain text above all panels.
    dynamic_range_db : float, decibel
        What is further below an image's maximum is background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in the order of the panels, then the colour bar.

    Raises
    ------
    CompareError
        No image at all that is not zero.
    """
    from matplotlib.figure import Figure

    shown = [
        depth_map_of(image, dynamic_range_db, f"image '{label}'")
        for row in panels
        for label, image in row
        if image is not None and image.amplitude.any()
    ]
    if not shown:
        raise CompareError("panels_figure: expected at least one image that is not zero, got none")
    columns = max(map(len, panels))
    width = max(ROW_WIDTH / columns - LEFT, PANEL_WIDTH)
    line_h = _height(3, TICK_PT)
    row_h = BOTTOM + width + line_h
    bar_left = columns * (LEFT + width) + BAR_GAP
    lines = _wrapped(title or "", bar_left, TITLE_PT)
    height = len(panels) * row_h + _height(len(lines), TITLE_PT) + TOP
    figure = Figure(
        figsize=(bar_left + BAR_WIDTH + BAR_LABELS, height), dpi=DPI / 2, facecolor="white"
    )
    drawn: Any = None
    for i, row in enumerate(panels):
        bottom = (len(panels) - 1 - i) * row_h + BOTTOM
        for j, (label, image) in enumerate(row):
            axes = _axes(figure, LEFT + j * (LEFT + width), bottom, width, width)
            lettering = "\n".join(_wrapped(label, width + LEFT / 2, TICK_PT))
            axes.set_title(lettering, fontsize=TICK_PT, pad=3, parse_math=False)
            if image is None or not image.amplitude.any():
                axes.set_xticks([])
                axes.set_yticks([])
                continue
            one = depth_map_of(image, dynamic_range_db, f"image '{label}'")
            drawn = _draw_amplitude(axes, one)
            _frame(
                axes, _Extent.around([one]), width, width,
                x_labels=True, y_labels=True, margin=0.05,
            )  # fmt: skip
    bar_height = min(2 * row_h, len(panels) * row_h) - BOTTOM - line_h
    bar = _axes(figure, bar_left, BOTTOM, BAR_WIDTH, bar_height)
    _amplitude_bar(bar, drawn, dynamic_range_db)
    for at, line in enumerate(lines):
        top = height - TOP / 2 - _height(at, TITLE_PT)
        _text(figure, bar_left / 2, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure


def save_figure(figure: Figure, path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write a figure whole or not at all; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : str or path
        Ends in .png, .pdf or .svg, in a folder that exists.
    force : bool
        Replace a file that is there already.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    OutputError
        The file exists and `force` is False, the folder does not exist, the suffix is another, or
        the system refuses to write. What was at `path` before is then untouched.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise OutputError(
            f"{target}: expected a name that ends in {', '.join(SUFFIXES)}, got '{target.suffix}'"
        )
    with replacing(target, force=force) as temporary, open(temporary, "xb") as stream:
        _render(figure, stream, suffix, figure.dpi)
    return target


def png_bytes(figure: Figure, *, dpi: float = DPI) -> bytes:
    """Return a figure as a PNG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    dpi : float
        Dots per inch.
    """
    stream = io.BytesIO()
    _render(figure, stream, ".png", dpi)
    return stream.getvalue()


def _render(figure: Figure, stream: BinaryIO, suffix: str, dpi: float) -> None:
    import matplotlib

    # None drops what would differ from run to run (dates) or from version to version (software).
    metadata: dict[str, dict[str, None]] = {
        ".png": {"Software": None},
        ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        ".svg": {"Date": None, "Creator": None},
    }
    # SVG ids are random without a salt, and a user's settings must not crop the page.
    settings = {"svg.hashsalt": "clradar", "savefig.bbox": None, "savefig.transparent": False}
    with matplotlib.rc_context(settings):
        figure.savefig(stream, format=suffix[1:], dpi=dpi, metadata=metadata[suffix])


def printable(text: object) -> str:
    """Return text on one line, with escapes for what cannot be printed.

    A label can be a file's name, which can hold control characters, bytes that are no text (lone
    surrogates: fonts refuse them), and marks that turn the direction of writing.
    """
    line = " ".join(str(text).split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def _check_metrics(metrics: Sequence[Metrics], count: int, dynamic_range_db: float) -> None:
    if metrics and len(metrics) != count:
        raise CompareError(
            f"comparison_figure: expected metrics for {count} simulated images, got {len(metrics)}"
        )
    for values in metrics:
        if values.dynamic_range_db != dynamic_range_db:
            raise CompareError(
                f"comparison_figure: expected metrics at {dynamic_range_db:g} dB, got metrics at "
                f"{values.dynamic_range_db:g} dB"
            )


def _caption_values(metrics: Metrics) -> list[str]:
    """Return one short text per name in CAPTION_NAMES."""
    rows = (
        (metrics.overlap, 1.0, 2),
        (metrics.db_correlation, 1.0, 2),
        (metrics.ssim, 1.0, 2),
        (metrics.mask_iou, 1.0, 2),
        (metrics.depth_rmse_m, 1e3, 1),
        (metrics.chamfer_simulated_to_measured_m, 1e3, 1),
    )
    return [
        "n/a" if math.isnan(value) else _signed(f"{scale * value:.{digits}f}")
        for value, scale, digits in rows
    ]


@dataclass(frozen=True, slots=True)
class _Extent:
    """The region that every panel of a figure shows, millimetres."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]

    @classmethod
    def around(cls, images: Sequence[DepthMap]) -> _Extent:
        x, y = zip(*(_edges_mm(image) for image in images), strict=True)
        return cls(
            (min(float(e[0]) for e in x), max(float(e[-1]) for e in x)),
            (min(float(e[0]) for e in y), max(float(e[-1]) for e in y)),
        )

    @property
    def aspect(self) -> float:
        """Height over width of a panel; a thin image does not fill its panel."""
        ratio = (self.y_mm[1] - self.y_mm[0]) / (self.x_mm[1] - self.x_mm[0])
        return float(np.clip(ratio, *PANEL_ASPECTS))


def _edges_mm(image: DepthMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders between pixels along x and y, one more than pixels, millimetres."""
    axes_mm = (1e3 * image.x_m, 1e3 * image.y_m)
    steps = [float(np.diff(a).min()) for a in axes_mm if len(a) > 1]
    # A single row or column has no spacing of its own: as wide as the other axis' pixels, or 1 mm.
    step = min(steps, default=1.0)
    edges = []
    for axis in axes_mm:
        if len(axis) == 1:
            edges.append(axis[0] + step * np.array([-0.5, 0.5]))
            continue
        inner = (axis[1:] + axis[:-1]) / 2
        edges.append(np.concatenate([[2 * axis[0] - inner[0]], inner, [2 * axis[-1] - inner[-1]]]))
    return edges[0], edges[1]


def _panel_size(width: float, aspect: float) -> tuple[float, float]:
    """Return the width and height of a panel, inches: as near to `width` as the limits allow."""
    width = max(width, PANEL_WIDTH)
    height = float(np.clip(width * aspect, *PANEL_HEIGHTS))
    # Only a high image is made narrower: a low one keeps its width in a panel higher than itself.
    return max(min(width, height / aspect), PANEL_WIDTH), height


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place given in inches from the lower left corner."""
    total_w, total_h = figure.get_size_inches()
    return figure.add_axes((left / total_w, bottom / total_h, width / total_w, height / total_h))


def _text(
    figure: Figure, x: float, top: float, text: str, *, size: float, ha: str, bold: bool = False
) -> None:
    """Write text whose first line starts `top` inches above the lower edge of the figure."""
    total_w, total_h = figure.get_size_inches()
    figure.text(
        x / total_w,
        (top - size / POINTS_PER_INCH) / total_h,
        text,
        fontsize=size,
        fontweight="bold" if bold else "normal",
        ha=ha,
        # Texts of the same height then share a baseline, with brackets or without.
        va="baseline",
        parse_math=False,
    )


def _height(lines: int, size_pt: float) -> float:
    """Return the height of some lines of text, inches."""
    return lines * size_pt * LINE_SPACING / POINTS_PER_INCH


def _wrapped(text: str, width: float, size_pt: float) -> list[str]:
    """Break text into at most three lines for a width in inches; more ends in an ellipsis."""
    # 0.66 em is a generous mean width for the letters of a sans-serif font.
    letters = max(8, int(width * POINTS_PER_INCH / (0.66 * size_pt)))
    return textwrap.wrap(printable(text), letters, max_lines=3, placeholder="…")


def _draw_amplitude(axes: Axes, image: DepthMap) -> Any:
    import matplotlib
    from matplotlib.colors import ListedColormap

    # The lower end of the scale is nearly black: left out, so that weak is not mistaken for none.
    colours = matplotlib.colormaps["inferno"](np.linspace(0.2, 1.0, 256))
    scale = ListedColormap(colours).with_extremes(
        bad=AMPLITUDE_BACKGROUND, under=AMPLITUDE_BACKGROUND
    )
    level_db = clipped_db(image)
    level_db[level_db <= -image.dynamic_range_db] = np.nan
    limits = (-image.dynamic_range_db, 0.0)
    return _draw(axes, image, level_db, scale, limits, AMPLITUDE_BACKGROUND)


def _draw_depth(axes: Axes, image: DepthMap, limits_mm: tuple[float, float]) -> Any:
    import matplotlib

    scale = matplotlib.colormaps["viridis_r"].with_extremes(bad=DEPTH_BACKGROUND)
    return _draw(axes, image, 1e3 * image.depth_m, scale, limits_mm, DEPTH_BACKGROUND)


def _draw(
    axes: Axes,
    image: DepthMap,
    values: np.ndarray,
    scale: Any,
    limits: tuple[float, float],
    background: str,
) -> Any:
    axes.set_facecolor(background)
    x_mm, y_mm = _edges_mm(image)
    # A mesh and not an image: pixels keep their place on an axis with uneven steps, and nothing is
    # smoothed. Rasterised, because one path per pixel makes PDF and SVG files enormous.
    return axes.pcolormesh(
        x_mm,
        y_mm,
        np.ma.masked_invalid(values),
        cmap=scale,
        vmin=limits[0],
        vmax=limits[1],
        shading="flat",
        rasterized=True,
    )


def _frame(
    axes: Axes,
    extent: _Extent,
    width: float,
    height: float,
    *,
    x_labels: bool,
    y_labels: bool,
    margin: float,
) -> None:
    """Set limits, ticks and labels; x increases to the left, as the radar sees the scene."""
    x_low, x_high = extent.x_mm
    y_low, y_high = extent.y_mm
    axes.set_xlim(x_high, x_low)
    axes.set_ylim(y_low, y_high)
    axes.set_aspect("equal", adjustable="box", anchor="C")
    axes.grid(visible=False)
    # An image much thinner than its panel leaves room for fewer ticks than the panel has.
    inches_per_mm = min(width / (x_high - x_low), height / (y_high - y_low))
    x_ticks = _ticks(x_low, x_high, (x_high - x_low) * inches_per_mm / TICK_DISTANCE, margin)
    y_ticks = _ticks(y_low, y_high, (y_high - y_low) * inches_per_mm / TICK_DISTANCE, margin)
    axes.set_xticks(x_ticks, [_signed(f"{t:g}") if x_labels else "" for t in x_ticks])
    axes.set_yticks(y_ticks, [_signed(f"{t:g}") if y_labels else "" for t in y_ticks])
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    if x_labels:
        axes.set_xlabel("x (mm)", fontsize=LABEL_PT, labelpad=2)
    if y_labels:
        axes.set_ylabel("y (mm)", fontsize=LABEL_PT, labelpad=1)


def _ticks(low: float, high: float, most: float, margin: float = 0.0) -> list[float]:
    """Return at most `most` (and at least one) round numbers, away from the ends by `margin`.

    `margin` is a share of the span: the labels of neighbouring panels must not run together.
    """
    span = high - low
    most = max(1, int(most))
    # The smallest power of ten in the list gives more ticks than any panel has room for.
    decade = math.floor(math.log10(span)) - 1
    for exponent in range(decade, decade + 4):
        for factor in (1, 2, 5):
            step = factor * 10.0**exponent
            first = math.ceil((low + margin * span) / step - 1e-9)
            last = math.floor((high - margin * span) / step + 1e-9)
            if first <= last <= first + most - 1:
                return [round(i * step, 9) for i in range(first, last + 1)]
    return [round((low + high) / 2, 6)]


def _signed(number: str) -> str:
    return number.replace("-", "\N{MINUS SIGN}")


def depth_limits_mm(images: Sequence[DepthMap]) -> tuple[float, float]:
    """Return the depths that the colour scale of these images spans, whole millimetres."""
    depths_mm = np.concatenate([1e3 * image.depth_m[image.mask] for image in images])
    # Rounded first: 0.3 m is 299.999999… mm.
    low, high = np.round(np.percentile(depths_mm, DEPTH_PERCENTILES), 6)
    low, high = math.floor(low), math.ceil(high)
    if high - low < 2:
        low, high = low - 1, high + 1
    return float(low), float(high)


def _amplitude_bar(axes: Axes, drawn: Any, dynamic_range_db: float) -> None:
    bar = axes.figure.colorbar(drawn, cax=axes, extend="min", extendfrac=0.06)
    _bar_labels(bar, (-dynamic_range_db, 0.0), "amplitude (dB)")


def _depth_bar(
    axes: Axes, drawn: Any, limits_mm: tuple[float, float], images: Sequence[DepthMap]
) -> None:
    low = min(1e3 * float(np.nanmin(image.depth_m)) for image in images) < limits_mm[0] - 1e-6
    high = max(1e3 * float(np.nanmax(image.depth_m)) for image in images) > limits_mm[1] + 1e-6
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[(low, high)]
    bar = axes.figure.colorbar(drawn, cax=axes, extend=extend, extendfrac=0.06)
    _bar_labels(bar, limits_mm, "depth z (mm)")


def _bar_labels(bar: Any, limits: tuple[float, float], name: str) -> None:
    ticks = _ticks(*limits, 5)
    bar.set_ticks(ticks, labels=[_signed(f"{t:g}") for t in ticks])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    bar.outline.set_linewidth(0.6)
    bar.set_label(name, fontsize=LABEL_PT, labelpad=3)
