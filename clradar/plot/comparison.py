"""Figures of a measured image beside simulated ones, and of where two images disagree."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clradar.compare import Metrics, compare, depth_map_of, disagreement
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.plot.differences import (
    depth_difference_bar,
    draw_depth_difference,
    draw_level_difference,
    level_difference_bar,
)
from clradar.plot.layout import (
    BAR_GAP,
    BAR_LABELS,
    BAR_WIDTH,
    BOTTOM,
    CAPTION_PT,
    GAP,
    LABEL_PT,
    LEFT,
    LETTER_EM,
    MULTIPLE_PANEL_WIDTH,
    POINTS_PER_INCH,
    ROW_WIDTH,
    SINGLE_PANEL_WIDTH,
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
from clradar.plot.panels import (
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    draw_amplitude,
    draw_depth,
    draw_frame,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CAPTION = (
    ("overlap", "overlap", 1.0, 2),
    ("dB correlation", "db_correlation", 1.0, 2),
    ("SSIM", "ssim", 1.0, 2),
    ("mask IoU", "mask_iou", 1.0, 2),
    ("depth RMSE (mm)", "depth_rmse_m", 1e3, 1),
    ("Chamfer sim. to meas. (mm)", "chamfer_simulated_to_measured_m", 1e3, 1),
)
"""Metrics below an image: name, field of `Metrics`, scale and digits."""

LEGEND = (
    "Where they disagree",
    "orange: stronger in the measurement",
    "ring: missing object",
    "blue: stronger in the simulation",
    "dotted ring: in the simulation alone",
)
"""Beside the row of differences, as far as there is room."""


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
    page = _Page.of(Extent.around(shown), labels, rows=3 if found else 2, caption=bool(metrics))
    unit = page.extent.unit
    above, below = page.row(0), page.row(1)
    differ = page.row(2, first=1) if found else []
    limits_mm = depth_limits_mm(shown)
    for i, image in enumerate(shown):
        amplitude = draw_amplitude(above[i], image, unit)
        depth = draw_depth(below[i], image, unit, limits_mm)
        page.frame(above[i], x_labels=False, y_labels=i == 0)
        page.frame(below[i], x_labels=not (found and i), y_labels=i == 0)
        # parse_math: a label can be a file's name with a literal dollar sign.
        title = "\n".join(page.titles[i])
        above[i].set_title(title, fontsize=TITLE_PT, pad=4, parse_math=False)
    for i, (axes, one) in enumerate(zip(differ, found, strict=True)):
        difference = draw_level_difference(axes, one, unit)
        page.frame(axes, x_labels=True, y_labels=i == 0)
    bars = page.bars()
    amplitude_bar(bars[0], amplitude, dynamic_range_db)
    depth_bar(bars[1], depth, limits_mm, shown)
    if found:
        level_difference_bar(bars[2], difference)
        _write_legend(page)
    _write_caption(page, metrics)
    return page.figure


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
    panel_w, panel_h = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    bar = BAR_GAP + BAR_WIDTH + BAR_LABELS
    width = 2 * (LEFT + panel_w + bar)
    lines = wrapped(title or "", width - LEFT - bar, TITLE_PT)
    height = BOTTOM + panel_h + text_height(1, LABEL_PT) + 2 * TOP
    figure = new_figure(width, height + text_height(len(lines), TITLE_PT))
    lefts = (LEFT, LEFT + panel_w + bar + LEFT)
    axes = [add_axes(figure, left, BOTTOM, panel_w, panel_h) for left in lefts]
    bars = [add_axes(figure, at + panel_w + BAR_GAP, BOTTOM, BAR_WIDTH, panel_h) for at in lefts]
    level_difference_bar(bars[0], draw_level_difference(axes[0], found, extent.unit))
    depth_difference_bar(bars[1], draw_depth_difference(axes[1], found, extent.unit))
    names = ("Level, measured over simulated", "Depth, simulated minus measured")
    for panel, name in zip(axes, names, strict=True):
        draw_frame(panel, extent, panel_w, panel_h, x_labels=True, y_labels=True, margin=0.0)
        panel.set_title(name, fontsize=LABEL_PT, pad=4)
    for row, line in enumerate(reversed(lines)):
        top = height - TOP + text_height(row + 1, TITLE_PT)
        middle = (lefts[0] + lefts[1] + panel_w) / 2
        add_text(figure, middle, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure


@dataclass(frozen=True, slots=True)
class _Page:
    """Columns of panels of one size, with a colour bar for each row and room for captions."""

    figure: Figure
    extent: Extent
    titles: list[list[str]]
    panel_w: float
    panel_h: float
    rows: int
    caption_h: float

    @classmethod
    def of(cls, extent: Extent, labels: Sequence[str], *, rows: int, caption: bool) -> _Page:
        columns = len(labels)
        panel_w, panel_h = panel_size(
            min(ROW_WIDTH / columns - GAP, MULTIPLE_PANEL_WIDTH), extent.aspect
        )
        titles = [wrapped(label, panel_w, TITLE_PT) for label in labels]
        title_h = text_height(max(map(len, titles)), TITLE_PT)
        caption_h = text_height(len(CAPTION), CAPTION_PT) + TOP if caption else 0.0
        width = LEFT + columns * (panel_w + GAP) - GAP + BAR_GAP + BAR_WIDTH + BAR_LABELS
        height = caption_h + BOTTOM + rows * (panel_h + GAP) - GAP + title_h + 2 * TOP
        figure = new_figure(width, height)
        return cls(figure, extent, titles, panel_w, panel_h, rows, caption_h)

    def left(self, column: int) -> float:
        return LEFT + column * (self.panel_w + GAP)

    def bottom(self, row: int) -> float:
        """Return the lower edge of a row, counted from above."""
        return self.caption_h + BOTTOM + (self.rows - 1 - row) * (self.panel_h + GAP)

    def row(self, row: int, first: int = 0) -> list[Axes]:
        """Return the panels of a row from the column `first` on."""
        return [
            add_axes(self.figure, self.left(i), self.bottom(row), self.panel_w, self.panel_h)
            for i in range(first, len(self.titles))
        ]

    def frame(self, axes: Axes, *, x_labels: bool, y_labels: bool) -> None:
        draw_frame(
            axes, self.extent, self.panel_w, self.panel_h,
            x_labels=x_labels, y_labels=y_labels, margin=0.12,
        )  # fmt: skip

    def bars(self) -> list[Axes]:
        left = self.left(len(self.titles)) - GAP + BAR_GAP
        return [
            add_axes(self.figure, left, self.bottom(row), BAR_WIDTH, self.panel_h)
            for row in range(self.rows)
        ]


def _write_legend(page: _Page) -> None:
    """Explain the row of differences in the place that its first column leaves."""
    letters = int((page.panel_w - 0.1) * POINTS_PER_INCH / (LETTER_EM * CAPTION_PT))
    top = page.bottom(2) + page.panel_h - BOTTOM
    for i, text in enumerate(LEGEND):
        for line in textwrap.wrap(text, max(letters, 12)):
            add_text(
                page.figure, page.left(0) - LEFT + 0.1, top, line, size=CAPTION_PT, ha="left",
                bold=i == 0,
            )  # fmt: skip
            top -= text_height(1, CAPTION_PT)
            if top < page.caption_h + text_height(1, CAPTION_PT):
                return


def _write_caption(page: _Page, metrics: Sequence[Metrics]) -> None:
    # Row by row: lines of one multi-line text are not evenly spaced and would not align.
    for row, (name, field, scale, digits) in enumerate(CAPTION if metrics else ()):
        top = page.caption_h - text_height(row, CAPTION_PT)
        add_text(page.figure, page.left(0) + page.panel_w, top, name, size=CAPTION_PT, ha="right")
        for column, values in enumerate(metrics, 1):
            value = scale * getattr(values, field)
            text = "n/a" if math.isnan(value) else typeset(f"{value:.{digits}f}")
            middle = page.left(column) + page.panel_w / 2
            add_text(page.figure, middle, top, text, size=CAPTION_PT, ha="center")


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
