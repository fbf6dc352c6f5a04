"""Writing figures reproducibly: the same figure gives the same bytes."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from clradar.errors import OutputError
from clradar.files.atomic import replacing
from clradar.plot.layout import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}
"""None drops what would differ from run to run (dates) or from version to version (software)."""

SUFFIXES = tuple(METADATA)
"""The kinds of file that `save_figure` writes."""


def save_figure(figure: Figure, path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write a figure as .png, .pdf or .svg, whole or not at all; the same figure, the same bytes.

    An existing file is replaced with `force` alone.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise OutputError(
            f"{target}: expected a name that ends in {', '.join(SUFFIXES)}, got '{target.suffix}'"
        )
    with replacing(target, force=force) as temporary, open(temporary, "xb") as stream:
        _render(figure, stream, suffix, figure.dpi)
    return target


def png_bytes(figure: Figure, *, dpi: float = DPI) -> bytes:
    """A figure as a PNG with `dpi` dots per inch; the same figure, the same bytes."""
    stream = io.BytesIO()
    _render(figure, stream, ".png", dpi)
    return stream.getvalue()


def _render(figure: Figure, stream: BinaryIO, suffix: str, dpi: float) -> None:
    import matplotlib

    # SVG ids are random without a salt, and a user's settings must not crop the page.
    settings = {"svg.hashsalt": "clradar", "savefig.bbox": None, "savefig.transparent": False}
    with matplotlib.rc_context(settings):
        figure.savefig(stream, format=suffix[1:], dpi=dpi, metadata=METADATA[suffix])
