"""Writing figures reproducibly: the same figure gives the same bytes."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.errors import OutputError
from clradar.files.atomic import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}
"""None drops what would differ from run to run (dates) or from version to version (software)."""

SUFFIXES = tuple(METADATA)  # the kinds of file that `save_figure` writes


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
    write_file(target, figure_bytes(figure, suffix=suffix), force=force)
    return target


def figure_bytes(figure: Figure, *, dpi: float | None = None, suffix: str = ".png") -> bytes:
    """The content of a file, with `dpi` dots per inch or those of the figure."""
    import matplotlib

    stream = io.BytesIO()
    # SVG ids are random without a salt, and a user's settings must not crop the page.
    settings = {"svg.hashsalt": "clradar", "savefig.bbox": None, "savefig.transparent": False}
    with matplotlib.rc_context(settings):
        figure.savefig(stream, format=suffix[1:], dpi=dpi or figure.dpi, metadata=METADATA[suffix])
    return stream.getvalue()
