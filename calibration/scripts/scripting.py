"""Shared functions of the scripts: options, one-line errors, output files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from clradar.errors import ClradarError
from clradar.files.atomic import refuse_existing
from clradar.files.json_file import write_json

__all__ = ["Force", "Recorded", "Unit", "refuse_existing", "run", "write_json"]

Recorded = Annotated[Path, typer.Argument(help="Recorded or simulated capture.")]
Force = Annotated[bool, typer.Option(help="Replace existing files.")]
Unit = Annotated[str, typer.Option(help="Unit of the mesh file: m, cm or mm.")]


def run(main: Callable[..., Any]) -> None:
    """Run a script whose arguments are those of `main`; a clear error ends it on one line."""
    try:
        typer.run(main)
    except ClradarError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: error: {error}")
