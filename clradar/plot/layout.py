"""Figures of panels of one size, laid out by matplotlib, and what their axes are labelled with."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clradar.compare import Disagreement
from clradar.model import DepthMap
from clradar.model.length_unit import LengthUnit, unit_for

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 300
"""Resolution of bitmaps: the narrowest panel has more dots than the usual image has pixels."""

TITLE_PT, LABEL_PT, TICK_PT, CAPTION_PT = 9.0, 8.0, 7.0, 7.0
LINE_SPACING = 1.5
POINTS_PER_INCH = 72.0

LETTER_EM = 0.66
"""A generous mean width for the letters of a sans-serif font, in em."""

# Inches.
GAP, MARGIN, BAR_ROOM, LABELS = 0.11, 0.1, 0.85, 0.55
ROW_WIDTH, PANEL_WIDTH = 7.6, 1.0
SINGLE_PANEL_WIDTH, MULTIPLE_PANEL_WIDTH = 2.5, 2.1
PANEL_ASPECTS = (0.4, 2.5)
PANEL_HEIGHTS = (1.3, 3.4)  # at least as high as the name of a colour bar is long
TICK_DISTANCE = 0.32


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
        x, y = zip(*(pixel_edges(image, unit) for image in images), strict=True)
        return cls(
            (min(float(e[0]) for e in x), max(float(e[-1]) for e in x)),
            (min(float(e[0]) for e in y), max(float(e[-1]) for e in y)),
            unit,
        )

    @property
    def aspect(self) -> float:
        """Height over width of a panel; limited, so that a thin image does not fill its panel."""
        ratio = (self.y[1] - self.y[0]) / (self.x[1] - self.x[0])
        return float(np.clip(ratio, *PANEL_ASPECTS))


def pixel_edges(image: DepthMap | Disagreement, unit: LengthUnit) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders between pixels along x and y, one more than pixels."""
    axes = (unit.per_m * image.x_m, unit.per_m * image.y_m)
    steps = [float(np.diff(a).min()) for a in axes if len(a) > 1]
    # A single row or column has no spacing of its own: as wide as the other axis' pixels, or 1 mm.
    step = min(steps, default=1e-3 * unit.per_m)
    edges = []
    for axis in axes:
        if len(axis) == 1:
            edges.append(axis[0] + step * np.array([-0.5, 0.5]))
            continue
        inner = (axis[1:] + axis[:-1]) / 2
        edges.append(np.concatenate([[2 * axis[0] - inner[0]], inner, [2 * axis[-1] - inner[-1]]]))
    return edges[0], edges[1]


def panel_size(width: float, aspect: float) -> tuple[float, float]:
    """Return the width and height of a panel, inches: as near to `width` as the limits allow."""
    width = max(width, PANEL_WIDTH)
    height = float(np.clip(width * aspect, *PANEL_HEIGHTS))
    # Only a high image is made narrower: a low one keeps its width in a panel higher than itself.
    return max(min(width, height / aspect), PANEL_WIDTH), height


def new_figure(width: float, height: float, dpi: float | None = None) -> Figure:
    """Return an empty figure of a size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=dpi or DPI, facecolor="white")


def new_panels(
    rows: int,
    columns: int,
    size: tuple[float, float],
    title: str | None = None,
    *,
    bars: int = 1,
    heads: int = 1,
    labels: tuple[int, int] = (1, 1),
    below: float = 0.0,
    dpi: float | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows of panels, to be laid out by `settled`.

    Parameters
    ----------
    rows, columns : int
    size : pair of floats, inches
        Width and height of a panel.
    title : str, optional
        Plain text above all panels, broken into lines.
    bars : int
        Colour bars side by side.
    heads : int
        Lines of text above a panel.
    labels : pair of int
        Rows that have labels below them, and columns that have them to their left.
    below : float, inches
        Left free below all panels.
    """
    width = columns * (size[0] + GAP) + labels[1] * LABELS + bars * BAR_ROOM
    lines = wrapped(title or "", width - BAR_ROOM, TITLE_PT)
    heads_h = heads * text_height(1, LABEL_PT)
    height = rows * (size[1] + GAP) + labels[0] * LABELS + heads_h + 2 * MARGIN + below
    height += text_height(len(lines), TITLE_PT)
    figure = new_figure(width, height, dpi)
    figure.set_layout_engine(
        "constrained", w_pad=GAP / 4, h_pad=GAP / 4, wspace=0.0, hspace=0.0,
        rect=(0.0, below / height, 1.0, 1.0 - below / height),
    )  # fmt: skip
    if lines:
        figure.suptitle(
            "\n".join(lines), fontsize=TITLE_PT, fontweight="bold", parse_math=False,
        )  # fmt: skip
    return figure, figure.subplots(rows, columns, squeeze=False).tolist()


def settled(figure: Figure) -> Figure:
    """Lay a figure out, once: its axes then have their places, whatever its resolution."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:  # where they are drawn, not the larger places that they were given
        axes.set_position(axes.get_position())
    return figure


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a position in inches from the lower left corner."""
    total_w, total_h = figure.get_size_inches()
    return figure.add_axes((left / total_w, bottom / total_h, width / total_w, height / total_h))


def add_text(figure: Figure, x: float, top: float, text: str, ha: str) -> None:
    """Write a line of a caption, `top` inches above the lower edge, at a share of the width."""
    baseline = (top - CAPTION_PT / POINTS_PER_INCH) / figure.get_figheight()
    # Texts of one height then share a baseline, with and without brackets.
    figure.text(x, baseline, text, fontsize=CAPTION_PT, ha=ha, va="baseline", parse_math=False)


def text_height(lines: int, size_pt: float) -> float:
    """Return the height of some lines of text, inches."""
    return lines * size_pt * LINE_SPACING / POINTS_PER_INCH


def wrapped(text: str, width: float, size_pt: float, most: int = 3) -> list[str]:
    """Break text into at most `most` lines of a width in inches; more ends in an ellipsis."""
    letters = max(8, int(width * POINTS_PER_INCH / (LETTER_EM * size_pt)))
    return textwrap.wrap(printable(text), letters, max_lines=most, placeholder="…")


def printable(text: object) -> str:
    """Return text on one line, with escapes for what cannot be printed.

    A label can be a file's name, with control characters, undecodable bytes (lone surrogates, which
    fonts refuse) and marks that reverse the direction of writing.
    """
    line = " ".join(str(text).split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def round_ticks(low: float, high: float, most: float, margin: float = 0.0) -> list[float]:
    """Return at most `most` (and at least one) round numbers, away from the ends by `margin`.

    `margin` is a fraction of the span: labels of neighbouring panels must not touch.
    """
    span = high - low
    most = max(1, int(most))
    # The smallest power of ten in the list gives more ticks than fit any panel.
    decade = math.floor(math.log10(span)) - 1
    for exponent in range(decade, decade + 4):
        for factor in (1, 2, 2.5, 5):
            step = factor * 10.0**exponent
            first = math.ceil((low + margin * span) / step - 1e-9)
            last = math.floor((high - margin * span) / step + 1e-9)
            if first <= last <= first + most - 1:
                return [round(i * step, 9) for i in range(first, last + 1)]
    return [round((low + high) / 2, 6)]


def axis_ticks(low: float, high: float, inches: float, margin: float) -> list[float]:
    """Return round numbers whose labels fit side by side along an axis of a length in inches."""
    ticks = round_ticks(low, high, inches / TICK_DISTANCE, margin)
    while len(ticks) > 1:
        letters = 1 + max(len(f"{tick:g}") for tick in ticks)
        widest = max(TICK_DISTANCE, letters * LETTER_EM * TICK_PT / POINTS_PER_INCH)
        if (ticks[1] - ticks[0]) / (high - low) * inches >= widest:
            break
        ticks = round_ticks(low, high, len(ticks) - 1, margin)
    return ticks


def typeset(number: str) -> str:
    """Return a number with a true minus sign."""
    return number.replace("-", "\N{MINUS SIGN}")
