"""The command line: one thin module per subcommand, imported only when it is requested."""

from clradar.cli.launcher import main

__all__ = ["main"]
