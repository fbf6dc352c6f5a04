"""Figures: one image, a comparison of several, and rows of amplitude images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from clradar.compare import depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.plot.layout import (
    BAR_GAP,
    BAR_LABELS,
    BAR_WIDTH,
    BOTTOM,
    DPI,
    LABEL_PT,
    LEFT,
    PANEL_WIDTH,
    ROW_WIDTH,
    SINGLE_PANEL_WIDTH,
    TICK_PT,
    TITLE_PT,
    TOP,
    Extent,
    add_axes,
    add_text,
    new_figure,
    panel_size,
    text_height,
    typeset,
    wrapped,
)
from clradar.plot.lines import line_figure
from clradar.plot.panels import (
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    draw_amplitude,
    draw_depth,
    draw_frame,
    peak_dbsm,
)
from clradar.plot.three_views import three_views_figure
from clradar.plot.views import FRONT, projected, rcs_image, view_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def image_figure(
    image: Volume | DepthMap,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    view: str | None = None,
    dbsm: bool = False,
) -> Figure:
    """Draw the amplitude and the depth of one image side by side.

    Parameters
    ----------
    image : Volume or DepthMap
    title : str, optional
        Plain text above both panels.
    dynamic_range_db : float, decibel
        Pixels further below the maximum are background.
    view : "xy", "xz", "yz" or "all", optional
        The axes of the figure; the volume is projected along the third. Default: along the axis
        that is thin, an eighth of either other extent at most; else "xy", the radar's view. "all":
        amplitude from all three sides.
    dbsm : bool
        Draw the radar cross section that a voxel reads (`Volume.rcs_dbsm`), in place of the level
        relative to the maximum.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: amplitude, depth, colour bar of the amplitude, colour bar of the depth.
        A single slice has no depth: amplitude and its colour bar; all views have three amplitudes
        and their colour bar. A volume of a single line has one curve of amplitude over position,
        whatever the view.

    Raises
    ------
    CompareError
        Not an image, zero everywhere, without any depth, a single voxel, a depth map that was cut
        at a smaller dynamic range, or one with a view other than "xy".
    ModelError
        An unknown view; `dbsm` of an image that is not on an absolute scale.
    """
    if dbsm:
        image = rcs_image(image)
    flat = isinstance(image, Volume) and min(image.grid.counts) == 1
    if view == "all" and not flat:
        return three_views_figure(image, title, dynamic_range_db, dbsm=dbsm)
    view = None if view == "all" else view
    seen = view_of(image, view)
    shown = projected(image, seen, dynamic_range_db, "image")
    if isinstance(image, Volume) and sum(count > 1 for count in image.grid.counts) < 2:
        return line_figure(image, title, dynamic_range_db, dbsm=dbsm)
    top_db = peak_dbsm(shown) if dbsm else None
    slice_m = None
    if isinstance(image, Volume):
        axis_m = getattr(image.grid, f"{seen.along}_m")
        slice_m = float(axis_m[0]) if len(axis_m) == 1 else None
    level = "Radar cross section" if dbsm else "Amplitude"
    panels = [f"{level}, maximum over depth", "Depth"]
    extent = Extent.around([shown])
    if slice_m is not None:
        place = typeset(f"{extent.unit.per_m * slice_m:g}")
        panels = [f"{level} at {seen.along} = {place} {extent.unit.name}"]
    elif seen is not FRONT:
        panels = [f"{level}, maximum over {seen.along}", f"{seen.along} of the maximum"]
    panel_w, panel_h = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    bar = BAR_GAP + BAR_WIDTH + BAR_LABELS
    width = len(panels) * (LEFT + panel_w + bar)
    lines = wrapped(title or "", width - LEFT - bar, TITLE_PT)
    titles_h = text_height(1, LABEL_PT) + text_height(len(lines), TITLE_PT)
    height = BOTTOM + panel_h + titles_h + 2 * TOP
    figure = new_figure(width, height)

    lefts = [LEFT + i * (LEFT + panel_w + bar) for i in range(len(panels))]
    axes = [add_axes(figure, left, BOTTOM, panel_w, panel_h) for left in lefts]
    for panel, name in zip(axes, panels, strict=True):
        draw_frame(
            panel, extent, panel_w, panel_h, x_labels=True, y_labels=True, margin=0.0, view=seen
        )
        panel.set_title(name, fontsize=LABEL_PT, pad=4)
    bars = [add_axes(figure, at + panel_w + BAR_GAP, BOTTOM, BAR_WIDTH, panel_h) for at in lefts]
    drawn = draw_amplitude(axes[0], shown, extent.unit, top_db)
    amplitude_bar(bars[0], drawn, dynamic_range_db, top_db)
    if slice_m is None:
        limits_mm = depth_limits_mm([shown])
        depth = draw_depth(axes[1], shown, extent.unit, limits_mm)
        depth_bar(bars[1], depth, limits_mm, [shown], seen)
    for row, line in enumerate(lines):
        top = height - TOP - text_height(row, TITLE_PT)
        add_text(
            figure, (lefts[0] + lefts[-1] + panel_w) / 2, top, line,
            size=TITLE_PT, ha="center", bold=True,
        )  # fmt: skip
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
        From top to bottom and left to right. Labels are plain text. Each panel has its own axes; it
        stays empty without an image, or with an image that is zero.
    title : str, optional
        Plain text above all panels.
    dynamic_range_db : float, decibel
        Pixels further below an image's maximum are background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in the order of the panels, then the colour bar.

    Raises
    ------
    CompareError
        No image at all that is not zero.
    """
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
    line_h = text_height(3, TICK_PT)
    row_h = BOTTOM + width + line_h
    bar_left = columns * (LEFT + width) + BAR_GAP
    lines = wrapped(title or "", bar_left, TITLE_PT)
    height = len(panels) * row_h + text_height(len(lines), TITLE_PT) + TOP
    figure = new_figure(bar_left + BAR_WIDTH + BAR_LABELS, height, DPI / 2)
    drawn: Any = None
    for i, row in enumerate(panels):
        bottom = (len(panels) - 1 - i) * row_h + BOTTOM
        for j, (label, image) in enumerate(row):
            axes = add_axes(figure, LEFT + j * (LEFT + width), bottom, width, width)
            lettering = "\n".join(wrapped(label, width + LEFT / 2, TICK_PT))
            axes.set_title(lettering, fontsize=TICK_PT, pad=3, parse_math=False)
            if image is None or not image.amplitude.any():
                axes.set_xticks([])
                axes.set_yticks([])
                continue
            one = depth_map_of(image, dynamic_range_db, f"image '{label}'")
            extent = Extent.around([one])
            drawn = draw_amplitude(axes, one, extent.unit)
            draw_frame(axes, extent, width, width, x_labels=True, y_labels=True, margin=0.05)
    bar_height = min(2 * row_h, len(panels) * row_h) - BOTTOM - line_h
    bar = add_axes(figure, bar_left, BOTTOM, BAR_WIDTH, bar_height)
    amplitude_bar(bar, drawn, dynamic_range_db)
    for at, line in enumerate(lines):
        top = height - TOP / 2 - text_height(at, TITLE_PT)
        add_text(figure, bar_left / 2, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure
