"""Folders of work that can be resumed: one writer at a time, no remains of a killed one."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from clradar.errors import OutputError
from clradar.files.failures import shown
from clradar.files.interrupts import postponed

LOCK = ".lock"

TEMPORARY = ".*.tmp"
"""Names of what is being written (`clradar.files.atomic`)."""


def remove_temporaries(folder: Path) -> None:
    """Remove what a killed process was writing."""
    for path in folder.glob(TEMPORARY):
        with suppress(OSError):
            path.unlink()


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for the time of the block, which goes with it, interrupted or not."""
    folder = TemporaryDirectory(prefix="clradar-", ignore_cleanup_errors=True)
    try:
        yield Path(folder.name)
    finally:
        with postponed():
            folder.cleanup()


@contextmanager
def held(folder: Path, work: str) -> Iterator[None]:
    """Make the folder, and keep other processes from working in it while the block runs.

    The lock is there only meanwhile; a folder that was made and stays empty is removed again. A
    `KeyboardInterrupt` gets the words that the work there is to be resumed.

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
    try:
        if os.path.lexists(folder) and not folder.is_dir():
            raise OutputError(f"{shown(folder)}: expected a folder's name, got a file")
        missing = not folder.is_dir()
        folder.mkdir(parents=True, exist_ok=True)
        lock = locked(folder / LOCK)
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(folder)}: cannot be written: {error}") from error
    if lock is None:
        raise OutputError(f"{shown(folder)}: another {work} is writing into it")
    try:
        yield
    except KeyboardInterrupt as interruption:
        if any(entry.name != LOCK for entry in folder.iterdir()):
            interruption.args = (f"the same command resumes {shown(folder)}",)
        raise
    finally:
        if sys.platform == "win32":  # where no open file can be removed: of another one, neither
            lock.close()
        with suppress(OSError):
            (folder / LOCK).unlink()
        lock.close()
        if missing:
            with suppress(OSError):  # it holds something
                folder.rmdir()


def locked(path: Path) -> IO[bytes] | None:
    """Open the file and lock it; None if another process has it."""
    while True:
        lock = open(path, "ab")  # noqa: SIM115 - closed by the caller
        try:
            # The system lets go of it when the process ends, however it ends.
            _take(lock)
        except OSError:
            lock.close()
            return None
        # The one who had it removes it: then the name is free, or of another file.
        if path.exists() and os.path.samestat(os.fstat(lock.fileno()), path.stat()):
            return lock
        lock.close()


def _take(lock: IO[bytes]) -> None:
    """Lock the open file; OSError if another process has."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
