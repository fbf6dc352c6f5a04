"""Page layout in inches, so that nothing overlaps whatever the number of panels."""

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
LEFT, GAP, TOP, BOTTOM = 0.62, 0.11, 0.10, 0.44
BAR_GAP, BAR_WIDTH, BAR_LABELS = 0.12, 0.11, 0.58
ROW_WIDTH, PANEL_WIDTH = 9.5, 1.0
SINGLE_PANEL_WIDTH, MULTIPLE_PANEL_WIDTH = 2.9, 2.1
PANEL_ASPECTS = (0.4, 2.5)
PANEL_HEIGHTS = (1.0, 3.4)  # at least as high as the name of a colour bar is long
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


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a position in inches from the lower left corner."""
    total_w, total_h = figure.get_size_inches()
    return figure.add_axes((left / total_w, bottom / total_h, width / total_w, height / total_h))


def add_text(
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
        # Texts of one height then share a baseline, with and without brackets.
        va="baseline",
        parse_math=False,
    )


def text_height(lines: int, size_pt: float) -> float:
    """Return the height of some lines of text, inches."""
    return lines * size_pt * LINE_SPACING / POINTS_PER_INCH


def wrapped(text: str, width: float, size_pt: float) -> list[str]:
    """Break text into at most three lines of a width in inches; more ends in an ellipsis."""
    letters = max(8, int(width * POINTS_PER_INCH / (LETTER_EM * size_pt)))
    return textwrap.wrap(printable(text), letters, max_lines=3, placeholder="…")


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
        for factor in (1, 2, 5):
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
