"""Figures of one image, of rows of them, and of a measured one beside simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clradar.compare.images import Disagreement, depth_map_of, disagreement
from clradar.compare.metrics import METRIC_TABLE, Metrics, compare
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.plot import drawing
from clradar.plot.views import FRONT, VIEWS, projected, rcs_image, view_of

NAMES_WIDTH = 1.5  # of the names of metrics, inches
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
    extent = drawing.Extent.around([shown])
    level = "Radar cross section" if dbsm else "Amplitude"
    names = [f"{level}, maximum over depth", "Depth"]
    axis_m = getattr(image.grid, f"{seen.along}_m") if isinstance(image, Volume) else np.empty(0)
    if len(axis_m) == 1:
        place = drawing.typeset(f"{extent.unit.per_m * float(axis_m[0]):g}")
        names = [f"{level} at {seen.along} = {place} {extent.unit.name}"]
    elif seen is not FRONT:
        names = [f"{level}, maximum over {seen.along}", f"{seen.along} of the maximum"]
    size = drawing.panel_size(drawing.SINGLE_PANEL_WIDTH, extent.aspect)
    n = len(names)
    figure, (panels,) = drawing.new_panels(1, n, size, title, bars=n, labels=n)
    frames: list[dict[str, Any]] = [{"title": name, "view": seen} for name in names]
    top_db = drawing.peak_dbsm(shown) if dbsm else None
    drawn = drawing.amplitude(panels[0], shown, extent, top_db, **frames[0])
    drawing.add_bar(panels[:1], drawn, drawing.CROSS_SECTION if dbsm else drawing.BELOW_MAXIMUM)
    if n == 2:
        limits_mm = drawing.depth_limits_mm([shown])
        depth = drawing.depth(panels[1], shown, extent, limits_mm, **frames[1])
        drawing.depth_bar(panels[1:], depth, [shown], seen)
    return drawing.settled(figure)


def _three_views(
    image: Volume | DepthMap, title: str | None, dynamic_range_db: float, *, dbsm: bool
) -> Figure:
    """Draw the maximum of a volume along z, y and x, all below the same maximum at one scale."""
    if not isinstance(image, Volume):
        raise CompareError("view: expected a volume to draw from all sides, got a depth map")
    depth_map_of(image, dynamic_range_db, "image")  # whose error says what cannot be drawn
    shown = {name: projected(image, VIEWS[name], dynamic_range_db, "image") for name in VIEWS}
    unit = drawing.Extent.around(list(shown.values())).unit
    extents = [drawing.Extent.around([one], unit) for one in shown.values()]
    spans = [[float(np.ptp(ends)) for ends in (extent.x, extent.y)] for extent in extents]
    widest, highest = (max(span[i] for span in spans) for i in (0, 1))
    size = drawing.panel_size(0.8 * drawing.SINGLE_PANEL_WIDTH, highest / widest)
    figure, (panels,) = drawing.new_panels(1, 3, size, title, labels=3)
    top_db = max(drawing.peak_dbsm(one) for one in shown.values()) if dbsm else None
    for panel, (name, one), extent in zip(panels, shown.items(), extents, strict=True):
        # One scale in all: the limits of the smaller ones are widened around their middle.
        x, y = (
            (min(ends) - (whole - np.ptp(ends)) / 2, max(ends) + (whole - np.ptp(ends)) / 2)
            for ends, whole in ((extent.x, widest), (extent.y, highest))
        )
        frame = {"title": f"maximum over {VIEWS[name].along}", "view": VIEWS[name]}
        drawn = drawing.amplitude(panel, one, drawing.Extent(x, y, unit), top_db, **frame)
    drawing.add_bar(panels, drawn, drawing.CROSS_SECTION if dbsm else drawing.BELOW_MAXIMUM)
    return drawing.settled(figure)


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
    width = max(drawing.ROW_WIDTH / columns - drawing.LABELS, drawing.PANEL_WIDTH)
    size, dpi = (width, width), drawing.DPI / 2
    figure, drawn_in = drawing.new_panels(rows, columns, size, title, labels=columns, dpi=dpi)
    drawn: Any = None
    for row, ones, all_axes in zip(panels, shown, drawn_in, strict=True):
        for axes, (label, _), one in zip(all_axes, row, ones, strict=False):
            if one is None:
                axes.set(xticks=[], yticks=[], box_aspect=1.0, anchor="S")
            else:
                drawn = drawing.amplitude(axes, one, drawing.Extent.around([one]))
            drawing.title_panel(axes, label, width + drawing.LABELS / 2, drawing.TICK_PT)
        for axes in all_axes[len(ones) :]:
            axes.remove()
    drawing.add_bar(list(figure.axes), drawn)
    return drawing.settled(figure)


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
    wanted, got = len(simulated) * [dynamic_range_db], [own.dynamic_range_db for own in metrics]
    if got and got != wanted:
        raise CompareError(
            f"comparison_figure: expected metrics of all simulated images, at {wanted} dB, got "
            f"{got} dB"
        )
    unmatched = [disagreement(shown[0], one) for one in (shown[1:] if differences else ())]
    labels = [measured_label, *(label for label, _ in simulated)]
    extent, columns = drawing.Extent.around(shown), len(labels)
    width = min(drawing.ROW_WIDTH / columns - drawing.GAP, drawing.MULTIPLE_PANEL_WIDTH)
    size = drawing.panel_size(width, extent.aspect)
    notes = []
    if metrics or unmatched:
        text = f"{NOTE} {_unmatched_note(unmatched)}"
        notes = drawing.wrapped(text, columns * size[0] + 1.0, drawing.CAPTION_PT, most=12)
    lines = (len(METRIC_TABLE) if metrics else 0) + len(notes)
    figure, panels = drawing.new_panels(3 if unmatched else 2, columns, size)
    limits_mm = drawing.depth_limits_mm(shown)
    for i, image in enumerate(shown):
        frame: dict[str, Any] = {"y_labels": i == 0, "margin": 0.1}
        amplitude = drawing.amplitude(panels[0][i], image, extent, x_labels=False, **frame)
        frame["x_labels"] = not (unmatched and i)
        depth = drawing.depth(panels[1][i], image, extent, limits_mm, **frame)
        drawing.title_panel(panels[0][i], labels[i], size[0], drawing.TITLE_PT)
    if unmatched:
        panels[2].pop(0).remove()
        for axes, one in zip(panels[2], unmatched, strict=True):
            difference = drawing.level_difference(axes, one, extent, y_labels=False, margin=0.1)
    drawing.add_bar(panels[0], amplitude)
    drawing.depth_bar(panels[1], depth, shown)
    if unmatched:
        drawing.add_bar(panels[2], difference, UNMATCHED, "both")
    drawing.settled(figure, drawing.text_height(lines) + drawing.MARGIN * bool(lines))
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
    lines = len(table) + len(notes)

    def write(x: float, row: int, text: str, ha: str) -> None:
        # Line by line: those of one text are not evenly spaced, and would not align.
        top = drawing.text_height(lines - row - 1 / drawing.LINE_SPACING)
        figure.text(
            x, top / figure.get_figheight(), text,
            fontsize=drawing.CAPTION_PT, ha=ha, va="baseline", parse_math=False,
        )  # fmt: skip

    for row, one in enumerate(table):
        write(max(boxes[0].x1, NAMES_WIDTH / figure.get_figwidth()), row, one.name, "right")
        for box, values in zip(boxes[1:], metrics, strict=True):
            write((box.x0 + box.x1) / 2, row, drawing.typeset(one.text(values)), "center")
    for row, line in enumerate(notes, len(table)):
        write(0.01, row, line, "left")
