"""The command line: one thin module per subcommand, imported only when it is requested."""

from __future__ import annotations

from clradar.files.interrupts import ending_signals

TYPE_CHECKING = False  # as in `clradar`
if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; see `clradar.cli.launcher.main`."""
    # Signals first: what is imported below takes longer than a user may wait for.
    with ending_signals():
        from clradar.cli import launcher

        launcher.main(arguments)
