"""Folders of work that can be resumed: one writer at a time, no remains of a killed one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clradar.errors import OutputError
from clradar.files.failures import shown

LOCK = ".lock"

TEMPORARY = ".*.tmp"
"""Names of what is being written (`clradar.files.atomic`)."""


def remove_temporaries(folder: Path) -> None:
    """Remove what a killed process was writing."""
    for path in folder.glob(TEMPORARY):
        with suppress(OSError):
            path.unlink()


@contextmanager
def held(folder: Path, work: str) -> Iterator[None]:
    """Make the folder, and keep other processes from working in it while the block runs.

    Parameters
    ----------
    folder : Path
    work : str
        What is going on in it, for the message: "sweep".

    Raises
    ------
    OutputError
        Another process holds it, it is a file, or it cannot be written.
    """
    import fcntl

    try:
        if os.path.lexists(folder) and not folder.is_dir():
            raise OutputError(f"{shown(folder)}: expected a folder's name, got a file")
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / LOCK, "ab")  # noqa: SIM115 - the block below closes it
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(folder)}: cannot be written: {error}") from error
    with lock:
        try:
            # The system lets go of it when the process ends, however it ends.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise OutputError(f"{shown(folder)}: another {work} is writing into it") from error
        yield
