"""The page around the content: style, script, and the policy that allows nothing else."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template
from typing import Any

import numpy as np

from clradar.plot.panels import amplitude_colours
from clradar.report.tables import escaped, script_json

SCRIPTS = ("shared.js", "viewer.js", "figure.js", "slices.js")
"""One script in this order."""

PANEL_PX = 150
"""Least width of a panel of the figure; on a narrower screen the figure scrolls in its frame.
Slices need more: two panels are side by side."""


def filled(
    title: str,
    notes: Sequence[str],
    colours: Sequence[str],
    data: Mapping[str, Any],
    *,
    dynamic_range_db: float,
    **parts: str,
) -> str:
    """Return the page."""
    script = "".join(map(_part, SCRIPTS))
    style = _part("page.css") + _own_style(colours)
    return Template(_part("page.html")).substitute(
        parts,
        title=escaped(title),
        style=style,
        style_hash=_policy_hash(style),
        script=script,
        script_hash=_policy_hash(script),
        notes="".join(f'<p class="note">{_paragraph(note)}</p>' for note in notes),
        dynamic_range=f"{dynamic_range_db:g}",
        view_data=script_json({**data, **_colour_scales()}),
    )


def details(summary: str, content: str) -> str:
    """Return a folded section; `summary` is text, `content` is HTML."""
    return f"<details><summary>{escaped(summary)}</summary>{content}</details>"


def _part(name: str) -> str:
    return (resources.files("clradar") / "report" / name).read_text(encoding="utf-8")


def _policy_hash(content: str) -> str:
    """Return the name of an inline script or style in a content security policy."""
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def _own_style(colours: Sequence[str]) -> str:
    """Return the style that depends on the images: the policy forbids style attributes."""
    swatches = "".join(f".cloud-{i}{{background:{c}}}\n" for i, c in enumerate(colours))
    least = max(len(colours), 2) * PANEL_PX
    widths = f".figure img,.columns{{min-width:{least}px}}#slices{{min-width:{1.6 * least:g}px}}"
    return f"@media screen{{{widths}}}\n{swatches}"


def _colour_scales() -> dict[str, str]:
    """The colours of levels and depths as in the figure, 256 times 3 bytes."""
    import matplotlib

    scales = {
        "level_colours": amplitude_colours(),
        "depth_colours": matplotlib.colormaps["viridis_r"](np.linspace(0.0, 1.0, 256)),
    }
    return {
        name: base64.b64encode(np.round(255 * scale[:, :3]).astype(np.uint8).tobytes()).decode()
        for name, scale in scales.items()
    }


def _paragraph(note: str) -> str:
    return "<br>".join(escaped(line) for line in note.splitlines())
