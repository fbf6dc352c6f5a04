"""Figures of a measured image beside simulated ones, and of where two images disagree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from clradar.compare import Disagreement, Metrics, compare, depth_map_of, disagreement
from clradar.compare.metric_table import METRIC_TABLE
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.plot.layout import (
    CAPTION_PT,
    GAP,
    LABEL_PT,
    MARGIN,
    MULTIPLE_PANEL_WIDTH,
    ROW_WIDTH,
    SINGLE_PANEL_WIDTH,
    TITLE_PT,
    Extent,
    add_text,
    new_panels,
    panel_size,
    settled,
    text_height,
    typeset,
    wrapped,
)
from clradar.plot.panels import (
    DEPTH_MM,
    LEVEL_DB,
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    difference_bar,
    draw_amplitude,
    draw_depth,
    draw_depth_difference,
    draw_frame,
    draw_level_difference,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NAMES_WIDTH = 1.5
"""Of the names of metrics, inches."""


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

    Parameters
    ----------
    measured : Volume or DepthMap
    simulated : sequence of (label, Volume or DepthMap)
        One column each, in this order. Labels are plain text; long ones are wrapped.
    metrics : sequence of Metrics, optional
        One for each simulated image, printed below it. None computes them with
        `clradar.compare`; an empty sequence omits them.
    measured_label : str
        Title of the first column.
    dynamic_range_db : float, decibel
        Pixels further below an image's own maximum are background.
    differences : bool
        Draw a third row: where the level of each simulated image disagrees with the measured one
        (`clradar.compare.disagreement`), with a ring around objects of one of them alone.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: the amplitudes from left to right, the depths, the differences, the
        colour bars of all amplitudes, of all depths, of all differences.

    Raises
    ------
    CompareError
        No simulated image; another number of metrics, or metrics at another dynamic range; the
        errors of `clradar.compare`.
    """
    if not simulated:
        raise CompareError("comparison_figure: expected at least one simulated image, got none")
    shown = [depth_map_of(measured, dynamic_range_db, "measured image")]
    for label, image in simulated:
        shown.append(depth_map_of(image, dynamic_range_db, f"simulated image '{label}'"))
    if metrics is None:
        metrics = [compare(shown[0], s, dynamic_range_db=dynamic_range_db) for s in shown[1:]]
    _check_metrics(metrics, len(simulated), dynamic_range_db)
    found = []
    if differences:
        found = [
            disagreement(shown[0], one, dynamic_range_db=dynamic_range_db) for one in shown[1:]
        ]
    labels = [measured_label, *(label for label, _ in simulated)]
    extent, columns = Extent.around(shown), len(labels)
    size = panel_size(min(ROW_WIDTH / columns - GAP, MULTIPLE_PANEL_WIDTH), extent.aspect)
    titles = [wrapped(label, size[0], TITLE_PT) for label in labels]
    notes = wrapped(_note(found), columns * size[0] + 1.0, CAPTION_PT, most=12) if found else []
    lines = len(METRIC_TABLE) if metrics else 0
    below = text_height(lines + len(notes), CAPTION_PT) + (MARGIN if lines + len(notes) else 0.0)
    rows = 3 if found else 2
    figure, panels = new_panels(
        rows, columns, size, heads=max(map(len, titles)) + 1, labels=(1, 1), below=below
    )
    limits_mm = depth_limits_mm(shown)
    for i, image in enumerate(shown):
        above, depths = panels[0][i], panels[1][i]
        amplitude = draw_amplitude(above, image, extent.unit)
        depth = draw_depth(depths, image, extent.unit, limits_mm)
        draw_frame(above, extent, size, x_labels=False, y_labels=i == 0, margin=0.12)
        draw_frame(depths, extent, size, x_labels=not (found and i), y_labels=i == 0, margin=0.12)
        # parse_math: a label can be a file's name with a literal dollar sign.
        above.set_title("\n".join(titles[i]), fontsize=TITLE_PT, pad=4, parse_math=False)
    if found:
        panels[2].pop(0).remove()
        for axes, one in zip(panels[2], found, strict=True):
            difference = draw_level_difference(axes, one, extent.unit)
            draw_frame(axes, extent, size, y_labels=False, margin=0.12)
    amplitude_bar(panels[0], amplitude, dynamic_range_db)
    depth_bar(panels[1], depth, limits_mm, shown)
    if found:
        difference_bar(panels[2], difference, LEVEL_DB, "unmatched by (dB)")
    settled(figure)
    _write_caption(figure, metrics, notes)
    return figure


def _note(found: Sequence[Disagreement]) -> str:
    """Explain the row of differences, as far as it shows something."""
    parts = [
        "Lowest row: grey where both match; else by how many dB the measurement (orange) or the "
        "simulation (blue) is stronger than all of the other within 6 mm, and 10 mm in depth"
    ]
    if any(one.missing for one in found):
        parts.append("ring: object missing from the simulation")
    if any(one.surplus for one in found):
        parts.append("dotted ring: object in the simulation alone")
    return "; ".join(parts) + "."


def disagreement_figure(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    transform: np.ndarray | None = None,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw where a simulated image disagrees with a measured one: in level, and in depth.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
    transform : array_like, shape (4, 4), optional
        Moves the simulated depth points first. After ``found = align(measured, simulated)`` pass
        ``found.transform``; after ``found = register(measured, mesh)`` pass ``found.volume`` as the
        simulated image, without a transform.
    title : str, optional
        Plain text above both panels.
    dynamic_range_db : float, decibel
        Pixels further below an image's own maximum are background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: difference of level, difference of depth, and their colour bars. Orange
        is stronger, or nearer, in the measurement, blue in the simulation; a ring surrounds an
        object that is missing from the simulation, a dotted one an object in the simulation alone.

    Raises
    ------
    CompareError, ModelError
        As `clradar.compare.disagreement`.
    """
    found = disagreement(measured, simulated, transform, dynamic_range_db=dynamic_range_db)
    extent = Extent.around([found])
    size = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    figure, ((level, depth),) = new_panels(1, 2, size, title, bars=2, labels=(1, 2))
    levels = draw_level_difference(level, found, extent.unit)
    depths = draw_depth_difference(depth, found, extent.unit)
    names = ("Level, measured over simulated", "Depth, simulated minus measured")
    for panel, name in zip((level, depth), names, strict=True):
        draw_frame(panel, extent, size)
        panel.set_title(name, fontsize=LABEL_PT, pad=4)
    difference_bar([level], levels, LEVEL_DB, "unmatched by (dB)")
    difference_bar([depth], depths, DEPTH_MM, "depth difference (mm)")
    return settled(figure)


def _write_caption(figure: Figure, metrics: Sequence[Metrics], notes: Sequence[str]) -> None:
    """Write the metrics below the columns that they belong to, and notes below them."""
    boxes = [axes.get_position() for axes in figure.axes[: len(metrics) + 1]]
    lines = len(METRIC_TABLE) if metrics else 0
    total = text_height(lines + len(notes), CAPTION_PT)
    names = max(boxes[0].x1, NAMES_WIDTH / figure.get_figwidth())
    # Row by row: lines of one multi-line text are not evenly spaced and would not align.
    for row, one in enumerate(METRIC_TABLE if metrics else ()):
        top = total - text_height(row, CAPTION_PT)
        add_text(figure, names, top, one.name, "right")
        for box, values in zip(boxes[1:], metrics, strict=True):
            value = one.scale * getattr(values, one.field)
            text = "n/a" if math.isnan(value) else typeset(f"{value:.{one.digits}f}")
            add_text(figure, (box.x0 + box.x1) / 2, top, text, "center")
    for row, line in enumerate(notes):
        add_text(figure, 0.01, total - text_height(lines + row, CAPTION_PT), line, "left")


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
