"""The command line: one thin module per subcommand, imported only when it is requested."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from clradar.files.interrupts import ending_signals

TYPE_CHECKING = False  # that of typing takes half the time until Ctrl-C is heard
if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

ROOT = str(Path(__file__).resolve().parents[2])  # the folder that clradar is installed in


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; see `clradar.cli.app.main`."""
    # Signals first: what is imported below takes longer than a user may wait for.
    with ending_signals():
        from clradar.cli import app

        app.main(arguments)


def leave_current_folder() -> None:
    """Take the current folder off Python's path, where ``python -m`` puts it first.

    A command reads files there and imports none. Where clradar itself lies in it, it stays.
    """
    try:
        first, here = os.path.realpath(sys.path[0]), os.path.realpath(os.curdir)
    except FileNotFoundError:  # the current folder was removed
        return
    if first == here and first != ROOT:
        del sys.path[0]
