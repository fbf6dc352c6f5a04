"""Pixels and curves as SVG with axes, units and a colour bar, for the panel."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

WIDTH = 310.0
"""Of a drawing, in its own units, which are about pixels in a panel of the default width."""

LEFT, RIGHT, TOP, BOTTOM = 46.0, 50.0, 18.0, 32.0

HEIGHTS = 50.0, 260.0
"""Least and most of the part with the pixels; a taller one is drawn narrower."""

MARK_COLOUR = "#35d0e0"

BAR_GAP, BAR_WIDTH = 8.0, 9.0

TICKS = 4
"""About as many along an axis."""

CLICKED = (
    'cursor="crosshair" onclick="const box = this.getBoundingClientRect(); fetch(\'/click/{}/\' + '
    "(event.clientX - box.left) / box.width + '/' + (event.clientY - box.top) / box.height)\""
)
"""Of an image: viser has no clicks on what is in the panel, so the page asks the server."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A name with its unit, and the values at the left or lower and at the right or upper edge."""

    name: str
    first: float
    last: float

    def share(self, value: float) -> float:
        """Return where a value is, from 0 at the first edge to 1 at the last."""
        return (value - self.first) / (self.last - self.first)

    def ticks(self) -> list[float]:
        """Return round values within the axis, ascending."""
        low, high = sorted((self.first, self.last))
        step = 10.0 ** math.floor(math.log10((high - low) / TICKS))
        step *= min((1, 2, 5, 10), key=lambda k: abs((high - low) / (k * step) - TICKS))
        first = math.ceil(low / step - 1e-6)
        count = math.floor(high / step + 1e-6) - first + 1
        return [round((first + i) * step, 9) for i in range(count)]


@dataclass(frozen=True, slots=True, eq=False)
class Bar:
    """A colour bar: its axis, and colours from the first value on, shape (n, 3), uint8."""

    axis: Axis
    colours: np.ndarray


def framed(
    title: str,
    pixels: np.ndarray,
    across: Axis,
    up: Axis,
    bar: Bar | None = None,
    *,
    marked: tuple[float, float] | None = None,
    square: bool = True,
    clicked: str = "",
) -> str:
    """Return an image with axes as SVG.

    Parameters
    ----------
    title : str
    pixels : ndarray, shape (n_rows, n_columns, 3), uint8
        The first row is the upper one.
    across, up : Axis
        Their ends are those of the image, half a pixel beyond the centres.
    bar : Bar or None
    marked : pair of floats or None
        A place along the axes that lines cross at.
    square : bool
        The axes have the same unit and scale.
    clicked : str
        A click on the image is told under this name, see `clradar.view.local_server.Clicks`.
    """
    width = WIDTH - LEFT - RIGHT
    height = 0.75 * width
    if square:
        ratio = abs(up.last - up.first) / abs(across.last - across.first)
        height = max(HEIGHTS[0], ratio * width)
        if height > HEIGHTS[1]:
            width, height = max(40.0, width * HEIGHTS[1] / height), HEIGHTS[1]
    image = _image(pixels, LEFT, TOP, width, height, clicked and CLICKED.format(clicked))
    parts = [image, _frame(title, across, up, width, height)]
    if marked is not None:
        x = LEFT + width * across.share(marked[0])
        y = TOP + height * (1 - up.share(marked[1]))
        for ends in ((x, TOP, x, TOP + height), (LEFT, y, LEFT + width, y)):
            parts.append(
                _line(*ends, f'stroke="{MARK_COLOUR}" stroke-width="0.7" pointer-events="none"')
            )
    if bar is not None:
        parts.append(_bar(bar, LEFT + width + BAR_GAP, height))
    return _svg(parts, height)


def curves(title: str, across: Axis, up: Axis, places: np.ndarray, values: np.ndarray) -> str:
    """Return a curve with axes as SVG; `places` and `values` are of shape (n,)."""
    width, height = WIDTH - LEFT - 12.0, 90.0
    x = LEFT + width * (places - across.first) / (across.last - across.first)
    y = TOP + height * (1 - np.clip((values - up.first) / (up.last - up.first), 0.0, 1.0))
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="#35a0e0" stroke-width="1.2"/>'
    return _svg([_frame(title, across, up, width, height), line], height)


def spanning(name: str, values: np.ndarray) -> Axis:
    """Return an axis that has all finite values, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    margin = 0.05 * (high - low) or 1.0
    return Axis(name, low - margin, high + margin)


def _svg(parts: Sequence[str], height: float) -> str:
    box = f"0 0 {WIDTH:g} {TOP + height + BOTTOM:.1f}"
    style = "display:block;width:100%;font:10px sans-serif;fill:currentColor"
    return f'<svg viewBox="{box}" style="{style}">{"".join(parts)}</svg>'


def _image(
    pixels: np.ndarray, x: float, y: float, width: float, height: float, more: str = ""
) -> str:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, "PNG", compress_level=1)
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return (
        f'<image x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" '
        f'preserveAspectRatio="none" style="image-rendering:pixelated" {more} '
        f'href="data:image/png;base64,{data}"/>'
    )


def _frame(title: str, across: Axis, up: Axis, width: float, height: float) -> str:
    right, bottom = LEFT + width, TOP + height
    parts = [
        _text(LEFT, TOP - 6, title, "start", 'font-weight="bold"'),
        f'<rect x="{LEFT}" y="{TOP}" width="{width:.1f}" height="{height:.1f}" fill="none" '
        'stroke="currentColor" stroke-width="0.6" pointer-events="none"/>',
        _text((LEFT + right) / 2, bottom + 26, across.name),
        f'<g transform="translate(10 {TOP + height / 2:.1f}) rotate(-90)">',
        f"{_text(0, 0, up.name)}</g>",
    ]
    for value in across.ticks():
        x = LEFT + width * across.share(value)
        parts += [_line(x, bottom, x, bottom + 3), _text(x, bottom + 13, f"{value:g}")]
    for value in up.ticks():
        y = bottom - height * up.share(value)
        parts += [_line(LEFT - 3, y, LEFT, y), _text(LEFT - 5, y + 3.5, f"{value:g}", "end")]
    return "".join(parts)


def _bar(bar: Bar, x: float, height: float) -> str:
    parts = [_image(bar.colours[::-1, None], x, TOP, BAR_WIDTH, height)]
    for value in bar.axis.ticks():
        y = TOP + height * (1 - bar.axis.share(value))
        end = x + BAR_WIDTH
        parts += [_line(end, y, end + 3, y), _text(end + 5, y + 3.5, f"{value:g}", "start")]
    parts.append(_text(x - 4, TOP - 6, bar.axis.name, "start"))
    return "".join(parts)


def _line(x: float, y: float, to_x: float, to_y: float, look: str = "") -> str:
    look = look or 'stroke="currentColor" stroke-width="0.6"'
    return f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{to_x:.1f}" y2="{to_y:.1f}" {look}/>'


def _text(x: float, y: float, words: str, anchor: str = "middle", look: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {look}>{escape(words)}</text>'
