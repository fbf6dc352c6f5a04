"""Figures of a measured image beside simulated ones, and of where two images disagree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clradar.compare import METRIC_TABLE, Disagreement, Metrics, compare, depth_map_of, disagreement
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.plot.layout import (
    CAPTION_PT,
    GAP,
    MARGIN,
    MULTIPLE_PANEL_WIDTH,
    POINTS_PER_INCH,
    ROW_WIDTH,
    TITLE_PT,
    Extent,
    new_panels,
    panel_size,
    settled,
    text_height,
    typeset,
    wrapped,
)
from clradar.plot.panels import (
    add_bar,
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    draw_amplitude,
    draw_depth,
    draw_frame,
    draw_level_difference,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES_WIDTH = 1.5
"""Of the names of metrics, inches."""

UNMATCHED = "unmatched by (dB)"

NOTE = (
    "x increases to the left, as the radar sees it; levels are below each image's own maximum; "
    "depth is from the plane z = 0 of the antennas."
)


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
    below = text_height(lines, CAPTION_PT) + (MARGIN if lines else 0.0)
    figure, panels = new_panels(3 if unmatched else 2, columns, size, below=below)
    limits_mm = depth_limits_mm(shown)
    for i, image in enumerate(shown):
        above, depths = panels[0][i], panels[1][i]
        amplitude = draw_amplitude(above, image, extent.unit)
        depth = draw_depth(depths, image, extent.unit, limits_mm)
        draw_frame(above, extent, x_labels=False, y_labels=i == 0, margin=0.1)
        draw_frame(depths, extent, x_labels=not (unmatched and i), y_labels=i == 0, margin=0.1)
        above.set_title("\n".join(titles[i]), fontsize=TITLE_PT, pad=4, parse_math=False)
    if unmatched:
        panels[2].pop(0).remove()
        for axes, one in zip(panels[2], unmatched, strict=True):
            difference = draw_level_difference(axes, one, extent.unit)
            draw_frame(axes, extent, y_labels=False, margin=0.1)
    amplitude_bar(panels[0], amplitude)
    depth_bar(panels[1], depth, shown)
    if unmatched:
        add_bar(panels[2], difference, UNMATCHED)
    settled(figure)
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
