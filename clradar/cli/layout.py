"""The option that names a layout, and what a command says where one is needed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from clradar.cli.output import print_text

LayoutOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--layout",
        metavar="LAB.toml",
        help="Which key and which axis of another program's file is what (docs/layouts.md). "
        "Without it the file's keys and a layout to begin with are printed.",
    ),
]


@contextmanager
def skeleton_if_needed() -> Iterator[None]:
    """Print the skeleton of a layout on stdout if the block fails for want of one."""
    from measurement_io import LayoutNeeded

    try:
        yield
    except LayoutNeeded as error:
        print_text(error.skeleton.rstrip("\n"))
        raise


def layout_files(layout: Path | None, meta: Mapping[str, Any]) -> list[Path]:
    """Return the layout and the antenna files that it names, which are inputs of a capture."""
    if layout is None:
        return []
    sides = (meta["layout"][name] for name in ("tx", "rx"))
    return [layout, *(Path(side["file"]) for side in sides if "file" in side)]
