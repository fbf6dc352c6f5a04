"""Opening what was written in the system's program for it: ``--open``."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import typer

from clradar.cli.console import print_line
from clradar.cli.options.values import wrong_usage


def require_picture(wanted: bool, options: str, *paths: Path | None) -> None:
    """Raise where --open comes without any of the options that write a picture or a page."""
    if wanted and not any(paths):
        raise wrong_usage("--open", f"expected {options} with it: there is nothing to open")


def open_written(wanted: bool, *paths: Path | None) -> None:
    """Open the last of some files that were written; a line says where it is if that fails.

    None: a file that was not requested.
    """
    path = next((path for path in reversed(paths) if path is not None), None)
    if not wanted or path is None:
        return
    if not _has_display():
        print_line(f"{path}: not opened, since there is no display here")
        return
    try:
        _launch(path.absolute())
    except OSError as error:
        print_line(f"{path}: not opened: {error.strerror or error}")


def _has_display() -> bool:
    # Without one xdg-open starts a browser for terminals, which takes this one over.
    named = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in named)


def _launch(path: Path) -> None:
    """Start the program and do not wait for it."""
    if sys.platform in ("darwin", "win32"):
        if typer.launch(str(path)):
            raise OSError("the system knows no program for it")
        return
    # Not by typer: what a viewer prints would be among our results, and keep a pipe open.
    quiet = subprocess.DEVNULL
    subprocess.Popen(
        ["xdg-open", str(path)], stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )
