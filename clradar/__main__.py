"""The command line by ``python -m clradar``."""

from clradar.cli import leave_current_folder, main


def run() -> None:
    """Run the command line, whatever files lie in the current folder."""
    leave_current_folder()
    main()


if __name__ == "__main__":
    run()
