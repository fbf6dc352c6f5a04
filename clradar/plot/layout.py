"""Figures of panels of one size, laid out by matplotlib, and what their axes are labelled with."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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
GAP, MARGIN, BAR_ROOM, LABELS = 0.11, 0.1, 0.85, 0.6
ROW_WIDTH, PANEL_WIDTH = 7.6, 1.0
SINGLE_PANEL_WIDTH, MULTIPLE_PANEL_WIDTH = 2.5, 2.1
PANEL_ASPECTS = (0.4, 2.5)
MOST_HEIGHT = 3.4
LEAST_IMAGE, LEAST_ROW = 1.1, 1.4  # for ticks and the name of a colour bar


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
        edges = [pixel_edges(image, unit) for image in images]
        x, y = (
            (min(float(e[i][0]) for e in edges), max(float(e[i][-1]) for e in edges))
            for i in (0, 1)
        )
        return cls(x, y, unit)

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
        inner = (axis[1:] + axis[:-1]) / 2
        ends = axis[[0, -1]] + step * np.array([-0.5, 0.5])
        if len(axis) > 1:
            ends = 2 * axis[[0, -1]] - inner[[0, -1]]
        edges.append(np.concatenate([ends[:1], inner, ends[1:]]))
    return edges[0], edges[1]


def panel_size(width: float, aspect: float) -> tuple[float, float]:
    """Return the width and height of a panel, inches: as near to `width` as the limits allow."""
    height = min(max(width, PANEL_WIDTH) * aspect, MOST_HEIGHT)
    return max(height / aspect, PANEL_WIDTH), height


def new_figure(
    width: float, height: float, title: str | None = None, dpi: float | None = None
) -> Figure:
    """Return an empty figure of a size in inches, laid out by matplotlib, with a plain title."""
    from matplotlib.figure import Figure

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
    below: float = 0.0,
    dpi: float | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows of panels of a size in inches, to be laid out by `settled`.

    There is room for `bars` colour bars side by side, labels to the left of some columns, and
    `below` inches below all.
    """
    width = columns * (size[0] + GAP) + labels * LABELS + bars * BAR_ROOM
    low = size[1] < LEAST_IMAGE  # rows are higher than images; `settled` takes what is too much
    height = rows * (LEAST_ROW if low else size[1] + 1.0) + below + 1.0
    figure = new_figure(width, height, title, dpi)
    figure.set_layout_engine(
        "constrained" if low else "compressed",
        w_pad=GAP / 4, h_pad=GAP / 4, wspace=0.0, hspace=0.0,
        rect=(0.0, below / height, 1.0, 1.0 - below / height),
    )  # fmt: skip
    return figure, figure.subplots(rows, columns, squeeze=False).tolist()


def settled(figure: Figure) -> Figure:
    """Lay a figure out: its axes then have their places, whatever its resolution.

    It loses what is free above and below them and the title.
    """
    from matplotlib.transforms import Bbox

    engine: Any = figure.get_layout_engine()
    engine.execute(figure)
    figure.set_layout_engine("none")
    height, below = figure.get_figheight(), engine.get()["rect"][1] * figure.get_figheight()
    to_inches = figure.dpi_scale_trans.inverted().transform_bbox
    drawn = to_inches(Bbox.union([a.get_tightbbox() or a.bbox for a in figure.axes]))
    titles = sum(GAP + to_inches(text.get_window_extent()).height for text in figure.texts)
    bottom, top = drawn.y0 - below - MARGIN / 4, height - drawn.y1 - titles - MARGIN / 4
    places = [axes.get_position().bounds for axes in figure.axes]
    figure.set_figheight(height - bottom - top)
    share = height / figure.get_figheight()
    for text in figure.texts:
        text.set(y=1.0 - MARGIN / 4 / figure.get_figheight(), va="top")
    for axes, (x0, y0, width, part) in zip(figure.axes, places, strict=True):
        axes.set_position((x0, (y0 - bottom / height) * share, width, part * share))
    return figure


def text_height(lines: int, size_pt: float) -> float:
    """Return the height of some lines of text, inches."""
    return lines * size_pt * LINE_SPACING / POINTS_PER_INCH


def wrapped(text: object, width: float, size_pt: float, most: int = 3) -> list[str]:
    """Break lines of text into at most `most` of a width in inches; more ends in an ellipsis."""
    letters = max(8, int(width * POINTS_PER_INCH / (LETTER_EM * size_pt)))
    wrapper = textwrap.TextWrapper(letters, max_lines=most, placeholder="…")
    return [line for part in str(text).split("\n") for line in wrapper.wrap(printable(part))][:most]


def printable(text: object) -> str:
    """Return text on one line, with escapes for what cannot be printed, such as in files' names."""
    line = " ".join(str(text).split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


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
