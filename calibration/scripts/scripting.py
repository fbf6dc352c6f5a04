"""What the scripts share: their arguments, and errors on one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import clradar
from clradar.errors import ClradarError
from clradar.files.atomic import refuse_existing

# Where the object is: x, y and z in metres, 2 mm voxels. Half a resolution cell is enough here.
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 2e-3)


def _new(path: Path) -> Path:
    refuse_existing(path, force=False)
    return path


Recorded = Annotated[Path, typer.Argument(help="Recorded or simulated capture.")]
Mesh = Annotated[Path, typer.Argument(help="Mesh of the object.")]
Unit = Annotated[str, typer.Option(help="Unit of the mesh file: m, cm or mm.")]
Output = Annotated[Path, typer.Option("-o", "--output", callback=_new, help="New file.")]


def run(main: Callable[..., Any]) -> None:
    """Run a script whose arguments are those of `main`; a clear error ends it on one line."""
    try:
        typer.run(main)
    except ClradarError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: error: {error}")
