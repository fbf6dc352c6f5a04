"""Records as HTML, for notebooks: a small picture and a table of facts."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape

import numpy as np

LARGEST = 160
"""Pixels of a picture; a larger image is shown by the maximum of blocks."""

DOTS = 240
"""Width and height that a picture fills in the page."""

FLOOR_DB = -30.0
"""Of a picture, below its maximum."""


def page_of(name: str, facts: Mapping[str, str], picture: np.ndarray, caption: str) -> str:
    """Return a figure and a table; there is no script in it, and all text is escaped.

    Parameters
    ----------
    name : str
        Of the record's class.
    facts : mapping
    picture : ndarray, shape (rows, columns), uint8
        Grey levels, the first row on top.
    caption : str
    """
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(key)}</th>"
        f"<td style='text-align:left'>{escape(value)}</td></tr>"
        for key, value in facts.items()
    )
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "PNG")
    content = base64.b64encode(stream.getvalue()).decode("ascii")
    scale = DOTS / max(picture.shape)
    height, width = (max(1, round(scale * n)) for n in picture.shape)
    return (
        f"<div><strong>{escape(name)}</strong>"
        f"<table><tr><td><img alt='{escape(caption)}' width='{width}' height='{height}' "
        f"style='image-rendering:pixelated' src='data:image/png;base64,{content}'></td>"
        f"<td style='vertical-align:top'><table>{rows}</table></td></tr></table>"
        f"<small>{escape(caption)}</small></div>"
    )


def level_picture(amplitude: np.ndarray) -> np.ndarray:
    """Return grey levels, uint8, of an amplitude (rows, columns): 0 at `FLOOR_DB`, 255 at its
    maximum."""
    small = _small(np.asarray(amplitude, np.float64), np.fmax)
    largest = small.max()
    if not 0 < largest < np.inf:
        return np.zeros(small.shape, np.uint8)
    with np.errstate(divide="ignore"):
        level_db = 20 * np.log10(small / largest)
    return np.round(255 * np.clip(1 - level_db / FLOOR_DB, 0, 1)).astype(np.uint8)


def depth_picture(depth_m: np.ndarray) -> np.ndarray:
    """Return grey levels, uint8, of depths (rows, columns): near is 255, far 64, NaN 0."""
    small = _small(depth_m, np.fmin)
    seen = ~np.isnan(small)
    if not seen.any():
        return np.zeros(small.shape, np.uint8)
    near, far = small[seen].min(), small[seen].max()
    share = (far - small) / (far - near) if far > near else np.ones(small.shape)
    return np.where(seen, np.round(64 + 191 * np.where(seen, share, 0)), 0).astype(np.uint8)


def _small(image: np.ndarray, reduce: np.ufunc) -> np.ndarray:
    """Return an image of at most `LARGEST` pixels a side, each reduced from a block."""
    for axis in (0, 1):
        step = -(-image.shape[axis] // LARGEST)
        starts = np.arange(0, image.shape[axis], step)
        image = reduce.reduceat(image, starts, axis=axis)
    return image


def as_seen(image: np.ndarray) -> np.ndarray:
    """Return an image [y, x] as rows from the top: y upwards, x as the radar sees it."""
    return image[::-1, ::-1]


def extent_text(name: str, values_m: np.ndarray) -> str:
    """Return the ends of an axis in millimetres."""
    low, high = 1e3 * values_m[0], 1e3 * values_m[-1]
    return f"{low:.6g} to {high:.6g} mm, {len(values_m)} {name}"


def meta_facts(meta: Mapping[str, object]) -> dict[str, str]:
    """Return the provenance in one line of at most 200 characters."""
    text = ", ".join(f"{key}: {value}" for key, value in meta.items())
    return {"meta": text if len(text) <= 200 else text[:197] + "..."} if text else {}
