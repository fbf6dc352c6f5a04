"""Figures of one image, of rows of them, and of a measured one beside simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clradar.compare import METRIC_TABLE, Disagreement, Metrics, compare, depth_map_of, disagreement
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.plot.panels import (
    CAPTION_PT,
    DPI,
    GAP,
    LABELS,
    MARGIN,
    MULTIPLE_PANEL_WIDTH,
    PANEL_WIDTH,
    POINTS_PER_INCH,
    ROW_WIDTH,
    SINGLE_PANEL_WIDTH,
    TICK_PT,
    TITLE_PT,
    Extent,
    add_bar,
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    draw_amplitude,
    draw_depth,
    draw_level_difference,
    new_panels,
    panel_size,
    peak_dbsm,
    settled,
    text_height,
    typeset,
    wrapped,
)
from clradar.plot.views import FRONT, VIEWS, projected, rcs_image, view_of

NAMES_WIDTH = 1.5
"""Of the names of metrics, inches."""

UNMATCHED = "unmatched by (dB)"

NOTE = (
    "x increases to the left, as the radar sees it; levels are below each image's own maximum; "
    "depth is from the plane z = 0 of the antennas."
)


def image_figure(
    image: Volume | DepthMap,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    view: str | None = None,
    dbsm: bool = False,
) -> Figure:
    """Draw the amplitude and the depth of one image side by side, each with its colour bar.

    Pixels more than `dynamic_range_db` below the maximum are background. `view` names the axes of
    the figure, "xy", "xz" or "yz"; the volume is projected along the third. Default: along an axis
    that is thin, an eighth of either other extent at most, else "xy", the radar's view. "all":
    amplitude from all three sides. `dbsm` draws the radar cross section that a voxel reads instead
    of the level. A single slice has no depth. What cannot be drawn, as a line of voxels, is a
    `CompareError`.
    """
    if dbsm:
        image = rcs_image(image)
    flat = isinstance(image, Volume) and min(image.grid.counts) == 1
    if view == "all" and not flat:
        return _three_views(image, title, dynamic_range_db, dbsm=dbsm)
    seen = view_of(image, None if view == "all" else view)
    shown = projected(image, seen, dynamic_range_db, "image")
    if isinstance(image, Volume) and sum(count > 1 for count in image.grid.counts) < 2:
        counts = " x ".join(map(str, image.grid.counts))
        raise CompareError(f"image: expected a plane of voxels, or more, to draw, got {counts}")
    extent = Extent.around([shown])
    level = "Radar cross section" if dbsm else "Amplitude"
    names = [f"{level}, maximum over depth", "Depth"]
    axis_m = getattr(image.grid, f"{seen.along}_m") if isinstance(image, Volume) else np.empty(0)
    if len(axis_m) == 1:
        place = typeset(f"{extent.unit.per_m * float(axis_m[0]):g}")
        names = [f"{level} at {seen.along} = {place} {extent.unit.name}"]
    elif seen is not FRONT:
        names = [f"{level}, maximum over {seen.along}", f"{seen.along} of the maximum"]
    size = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    n = len(names)
    figure, (panels,) = new_panels(1, n, size, title, bars=n, labels=n)
    frames: list[dict[str, Any]] = [{"title": name, "view": seen} for name in names]
    top_db = peak_dbsm(shown) if dbsm else None
    drawn = draw_amplitude(panels[0], shown, extent, top_db, **frames[0])
    amplitude_bar(panels[:1], drawn, dbsm=dbsm)
    if n == 2:
        depth = draw_depth(panels[1], shown, extent, depth_limits_mm([shown]), **frames[1])
        depth_bar(panels[1:], depth, [shown], seen)
    return settled(figure)


def _three_views(
    image: Volume | DepthMap, title: str | None, dynamic_range_db: float, *, dbsm: bool
) -> Figure:
    """Draw the maximum of a volume along z, y and x, all below the same maximum at one scale."""
    if not isinstance(image, Volume):
        raise CompareError("view: expected a volume to draw from all sides, got a depth map")
    depth_map_of(image, dynamic_range_db, "image")  # whose error says what cannot be drawn
    shown = {name: projected(image, VIEWS[name], dynamic_range_db, "image") for name in VIEWS}
    unit = Extent.around(list(shown.values())).unit
    extents = [Extent.around([one], unit) for one in shown.values()]
    spans = [[float(np.ptp(ends)) for ends in (extent.x, extent.y)] for extent in extents]
    widest, highest = (max(span[i] for span in spans) for i in (0, 1))
    size = panel_size(0.8 * SINGLE_PANEL_WIDTH, highest / widest)
    figure, (panels,) = new_panels(1, 3, size, title, labels=3)
    top_db = max(peak_dbsm(one) for one in shown.values()) if dbsm else None
    for panel, (name, one), extent in zip(panels, shown.items(), extents, strict=True):
        # One scale in all: the limits of the smaller ones are widened around their middle.
        x, y = (
            (min(ends) - (whole - np.ptp(ends)) / 2, max(ends) + (whole - np.ptp(ends)) / 2)
            for ends, whole in ((extent.x, widest), (extent.y, highest))
        )
        frame = {"title": f"maximum over {VIEWS[name].along}", "view": VIEWS[name]}
        drawn = draw_amplitude(panel, one, Extent(x, y, unit), top_db, **frame)
    amplitude_bar(panels, drawn, dbsm=dbsm)
    return settled(figure)


def panels_figure(
    panels: Sequence[Sequence[tuple[str, DepthMap | None]]],
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw the amplitudes of several images in rows, each relative to its own maximum.

    `panels` has rows of (label, image), from top to bottom; a panel stays empty without an image.
    Each panel has its own axes; then comes the colour bar.
    """
    shown = [
        [
            depth_map_of(image, dynamic_range_db, f"image '{label}'")
            if image is not None and image.amplitude.any()
            else None
            for label, image in row
        ]
        for row in panels
    ]
    if not any(one for row in shown for one in row):
        raise CompareError("panels_figure: expected at least one image that is not zero, got none")
    rows, columns = len(panels), max(map(len, panels))
    width = max(ROW_WIDTH / columns - LABELS, PANEL_WIDTH)
    titles = [[wrapped(label, width + LABELS / 2, TICK_PT) for label, _ in row] for row in panels]
    size = (width, width)
    figure, drawn_in = new_panels(rows, columns, size, title, labels=columns, dpi=DPI / 2)
    drawn: Any = None
    for lines, ones, all_axes in zip(titles, shown, drawn_in, strict=True):
        for axes, name, one in zip(all_axes, lines, ones, strict=False):
            if one is None:
                axes.set(xticks=[], yticks=[], box_aspect=1.0, anchor="S")
            else:
                drawn = draw_amplitude(axes, one, Extent.around([one]))
            axes.set_title("\n".join(name), fontsize=TICK_PT, pad=3, parse_math=False)
        for axes in all_axes[len(ones) :]:
            axes.remove()
    amplitude_bar(list(figure.axes), drawn)
    return settled(figure)


def comparison_figure(
    measured: Volume | DepthMap,
    simulated: Sequence[tuple[str, Volume | DepthMap]],
    *,
    metrics: Sequence[Metrics] | None = None,
    measured_label: str = "Measurement",
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    differences: bool = False,
) -> Figure:
    """Draw a measured image and simulated ones in a row, amplitude above depth.

    `simulated` has (label, image), one column each; background is as in `image_figure`. `metrics`
    has one for each of them, printed below it: None computes them by `clradar.compare`, an empty
    sequence omits them. `differences` draws a third row, the difference of levels, with a ring
    around objects of one image alone. The axes of the figure are amplitudes from left to right,
    depths, differences, and the colour bars of each.
    """
    for one in checks.several("comparison_figure: simulated", simulated):
        if not isinstance(one, tuple | list) or len(one) != 2:
            checks.fail("comparison_figure: simulated", "pairs (label, image)", type(one).__name__)
    if not simulated:
        raise CompareError("comparison_figure: expected at least one simulated image, got none")
    shown = [depth_map_of(measured, dynamic_range_db, "measured image")]
    for label, image in simulated:
        shown.append(depth_map_of(image, dynamic_range_db, f"simulated image '{label}'"))
    if metrics is None:
        metrics = [compare(shown[0], s, dynamic_range_db=dynamic_range_db) for s in shown[1:]]
    _check_metrics(metrics, len(simulated), dynamic_range_db)
    unmatched = [
        disagreement(shown[0], one, dynamic_range_db=dynamic_range_db)
        for one in (shown[1:] if differences else ())
    ]
    labels = [measured_label, *(label for label, _ in simulated)]
    extent, columns = Extent.around(shown), len(labels)
    size = panel_size(min(ROW_WIDTH / columns - GAP, MULTIPLE_PANEL_WIDTH), extent.aspect)
    titles = [wrapped(label, size[0], TITLE_PT) for label in labels]
    notes = []
    if metrics or unmatched:
        text = f"{NOTE} {_unmatched_note(unmatched)}"
        notes = wrapped(text, columns * size[0] + 1.0, CAPTION_PT, most=12)
    lines = (len(METRIC_TABLE) if metrics else 0) + len(notes)
    figure, panels = new_panels(3 if unmatched else 2, columns, size)
    limits_mm = depth_limits_mm(shown)
    for i, image in enumerate(shown):
        frame: dict[str, Any] = {"y_labels": i == 0, "margin": 0.1}
        amplitude = draw_amplitude(panels[0][i], image, extent, x_labels=False, **frame)
        frame["x_labels"] = not (unmatched and i)
        depth = draw_depth(panels[1][i], image, extent, limits_mm, **frame)
        title = "\n".join(titles[i])
        panels[0][i].set_title(title, fontsize=TITLE_PT, pad=4, parse_math=False)
    if unmatched:
        panels[2].pop(0).remove()
        for axes, one in zip(panels[2], unmatched, strict=True):
            difference = draw_level_difference(axes, one, extent, y_labels=False, margin=0.1)
    amplitude_bar(panels[0], amplitude)
    depth_bar(panels[1], depth, shown)
    if unmatched:
        add_bar(panels[2], difference, UNMATCHED)
    settled(figure, text_height(lines, CAPTION_PT) + (MARGIN if lines else 0.0))
    _write_caption(figure, metrics, notes)
    return figure


def _unmatched_note(found: Sequence[Disagreement]) -> str:
    """Explain the row of differences, as far as it shows something."""
    if not found:
        return ""
    parts = [
        "Lowest row: grey where both match; else by how many dB the measurement (orange) or the "
        "simulation (blue) is stronger than all of the other within 6 mm, and 10 mm in depth"
    ]
    if any(one.missing for one in found):
        parts.append("ring: object missing from the simulation")
    if any(one.surplus for one in found):
        parts.append("dotted ring: object in the simulation alone")
    return "; ".join(parts) + "."


def _write_caption(figure: Figure, metrics: Sequence[Metrics], notes: Sequence[str]) -> None:
    """Write the metrics below the columns that they belong to, and notes below them."""
    boxes = [axes.get_position() for axes in figure.axes[: len(metrics) + 1]]
    table = METRIC_TABLE if metrics else ()
    total = text_height(len(table) + len(notes), CAPTION_PT)

    def write(x: float, row: int, text: str, ha: str) -> None:
        # Line by line: those of one text are not evenly spaced, and would not align.
        top = total - text_height(row, CAPTION_PT) - CAPTION_PT / POINTS_PER_INCH
        figure.text(
            x, top / figure.get_figheight(), text,
            fontsize=CAPTION_PT, ha=ha, va="baseline", parse_math=False,
        )  # fmt: skip

    for row, one in enumerate(table):
        write(max(boxes[0].x1, NAMES_WIDTH / figure.get_figwidth()), row, one.name, "right")
        for box, values in zip(boxes[1:], metrics, strict=True):
            write((box.x0 + box.x1) / 2, row, typeset(one.text(values)), "center")
    for row, line in enumerate(notes, len(table)):
        write(0.01, row, line, "left")


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
