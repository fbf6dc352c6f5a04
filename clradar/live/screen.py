"""What `clradar live` shows: the depth map as coloured blocks in a terminal, or lines in a pipe."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

import numpy as np

from clradar.errors import quoted
from clradar.live.inbox import Counts
from clradar.live.loop import Pace, Shown
from clradar.model import DepthMap

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

LINE_S = 1.0
"""Between two lines in a pipe."""

MOST_COLUMNS = 72
"""Blocks across: more take longer to draw than they are worth."""


class Screen(Protocol):
    """Shows frames, and the state while none comes."""

    def show(self, shown: Shown) -> None:
        """Draw a frame."""

    def waiting(self, pace: Pace, counts: Counts) -> None:
        """Say that no frame comes."""


def state_words(pace: Pace, counts: Counts) -> str:
    """Rate, latency, and what was dropped or bad, on one line."""
    words = [f"{pace.shown} shown"]
    if pace.rate_hz:
        words.append(f"{pace.rate_hz:.1f} frames/s")
    if pace.shown:
        words.append(f"latency {1e3 * pace.latency_s:.0f} ms (at most {1e3 * pace.worst_s:.0f})")
    words.append(f"{counts.dropped} dropped")
    if counts.bad:
        words.append(f"{counts.bad} bad, the last: {quoted(counts.reason)}")
    return ", ".join(words)


class Lines:
    """A line about once a second."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._said_s, self._last = say, -LINE_S, ""

    def show(self, shown: Shown) -> None:
        now_s = time.perf_counter()
        if now_s - self._said_s >= LINE_S:
            self._said_s = now_s
            self._say(f"{shown.label}: {state_words(shown.pace, shown.counts)}")

    def waiting(self, pace: Pace, counts: Counts) -> None:
        words = state_words(pace, counts)
        if words != self._last:
            self._last = words
            self._say(f"waiting: {words}")


class _Terminal:
    """Depth map and state, in place."""

    def __init__(self, words: str, draw: Callable[[RenderableType], None]) -> None:
        from rich.text import Text

        self._words, self._draw, self._text = words, draw, Text
        self._picture = Text("")

    def show(self, shown: Shown) -> None:
        from rich.console import Group

        state = f"{shown.label}: {state_words(shown.pace, shown.counts)}"
        self._picture = blocks(shown.image)
        self._draw(Group(self._picture, self._text(_depths(shown.image)), self._text(state)))

    def waiting(self, pace: Pace, counts: Counts) -> None:
        from rich.console import Group

        state = self._text(f"{self._words}; {state_words(pace, counts)}")
        self._draw(Group(self._picture, state))


@contextmanager
def screen(words: str, say: Callable[[str], None]) -> Iterator[Screen]:
    """Show on the terminal while the block runs; where stdout is none, by lines.

    Parameters
    ----------
    words : str
        What the source is.
    say : callable
        Prints a line.
    """
    if not sys.stdout.isatty():
        yield Lines(say)
        return
    from rich.live import Live

    with Live(auto_refresh=False) as live:
        yield _Terminal(words, lambda drawn: live.update(drawn, refresh=True))


def blocks(image: DepthMap, columns: int = MOST_COLUMNS) -> Text:
    """Return a depth map in the radar's view as half blocks, two rows of pixels per line."""
    from rich.style import Style
    from rich.text import Text

    pixels = _pixels(image, columns)
    styles: dict[tuple[int, ...], Style] = {}
    text = Text(no_wrap=True)
    for upper, lower in zip(pixels[::2], pixels[1::2], strict=True):
        for pair in np.concatenate([upper, lower], axis=1).tolist():
            key = tuple(pair)
            if key not in styles:
                top, bottom = ("rgb({},{},{})".format(*key[i : i + 3]) for i in (0, 3))
                styles[key] = Style.parse(f"{top} on {bottom}")
            text.append("▀", styles[key])
        text.append("\n")
    return text


LEVELS = 24
"""Colours of depth: few, so that neighbours share the codes of a terminal."""


def _pixels(image: DepthMap, columns: int) -> np.ndarray:
    """Return colours, shape (even, columns, 3), uint8: near is bright, black where nothing is."""
    height_m, width_m = (float(np.ptp(axis)) or 1e-3 for axis in (image.y_m, image.x_m))
    n_columns = min(columns, len(image.x_m))
    n_rows = 2 * max(1, round(n_columns * height_m / width_m / 2))
    rows, across = (
        (np.arange(n) * count) // n
        for n, count in zip((n_rows, n_columns), image.depth_m.shape, strict=True)
    )
    depth_m = image.depth_m[::-1, ::-1][rows[:, None], across]
    seen = ~np.isnan(depth_m)
    colours = np.zeros((*depth_m.shape, 3), np.uint8)
    if seen.any():
        near, far = np.percentile(depth_m[seen], (2, 98))
        share = np.clip((depth_m[seen] - near) / max(far - near, 1e-3), 0.0, 1.0)
        colours[seen] = _scale()[np.round(share * (LEVELS - 1)).astype(int)]
    return colours


def _scale() -> np.ndarray:
    """Yellow (near) to blue (far), as the figures have it, shape (LEVELS, 3)."""
    ends = np.array([[253, 231, 37], [53, 183, 121], [49, 104, 142], [68, 1, 84]], float)
    at = np.linspace(0, len(ends) - 1, LEVELS)
    return np.stack([np.interp(at, range(len(ends)), c) for c in ends.T], axis=1).astype(np.uint8)


def _depths(image: DepthMap) -> str:
    if not image.mask.any():
        return "nothing seen"
    near, far = 1e3 * np.nanmin(image.depth_m), 1e3 * np.nanmax(image.depth_m)
    return f"depth {near:.0f} mm (yellow) to {far:.0f} mm (violet), x to the left, y up"
