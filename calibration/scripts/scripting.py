"""What the scripts of this folder share: how they run, and how they write text."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clradar.errors import ClradarError
from clradar.files.atomic import write_file


def run(main: Callable[..., Any]) -> None:
    """Run a script whose arguments are those of `main`; a clear error ends it on one line."""
    import typer

    try:
        typer.run(main)
    except ClradarError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: error: {error}")


def write_text(path: Path, text: str, *, force: bool) -> None:
    """Write a text file, whole or not at all."""
    write_file(path, text.encode("utf-8"), force=force)
