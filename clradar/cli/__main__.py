"""The command line by ``python -m clradar.cli``."""

from clradar.__main__ import run

if __name__ == "__main__":
    run()
