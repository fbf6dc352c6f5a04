"""The command line by ``python -m clradar.cli``."""

from clradar.cli import main

main()
