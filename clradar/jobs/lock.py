"""Folders of work: one writer at a time, and no remains of a killed one."""

from __future__ import annotations

import errno
import multiprocessing
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.errors import OutputError, warn
from clradar.files.atomic import writing
from clradar.files.failures import shown

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK = ".lock"

SCRATCH = "clradar-scratch-"
"""Names of scratch folders that have their lock, and of the semaphores of their process."""

WAIT_S = 0.2  # for a lock whose holder removes it at this moment
NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
"""What file systems without locks say: Lustre and NFS by some of their options."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for the time of the block; those of processes that were killed are removed, too."""
    for left in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*"):
        with suppress(OSError):
            if os.access(left / LOCK, os.W_OK) and (lock := locked(left / LOCK, wait_s=0)):
                for semaphore in Path("/dev/shm").glob(f"sem.{left.name}-*"):
                    semaphore.unlink(missing_ok=True)
                shutil.rmtree(left, ignore_errors=True)
                unlock(lock)
    folder = Path(tempfile.mkdtemp(prefix="clradar-"))
    lock = locked(folder / LOCK)
    if sys.platform != "win32":  # where no folder with an open file can get another name
        folder = folder.rename(folder.with_name(folder.name.replace("clradar-", SCRATCH)))
    names = vars(multiprocessing.current_process())["_config"]
    before = names["semprefix"]
    if sys.platform == "linux":  # macOS allows for 30 characters
        names["semprefix"] = f"/{folder.name}"
    try:
        yield folder
    finally:
        names["semprefix"] = before
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            lock.release()
        shutil.rmtree(folder, ignore_errors=True)  # Windows removes no open file


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder where there is none; one that stays empty is removed again."""
    missing = not os.path.isdir(folder)
    if missing and os.path.lexists(folder):
        raise OutputError(f"{shown(folder)}: expected a folder's name, got a file")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if missing:
            with suppress(OSError):  # it holds something
                folder.rmdir()


@contextmanager
def held(folder: Path, work: str) -> Iterator[None]:
    """Make a folder, and keep other processes out of it; `work` is for the message: "sweep"."""
    with made_folder(folder):
        with writing(folder):
            lock = locked(folder / LOCK)
        if lock is None:
            holder = ""
            with suppress(OSError, ValueError):
                process, machine = (folder / LOCK).read_text("utf-8").split("\n")[:2]
                if process.isdecimal() and machine:
                    holder = f": process {process} of {machine}; if that is gone, remove "
                    holder += f"'{shown(folder / LOCK)}'"
            raise OutputError(f"{shown(folder)}: another {work} is writing into it{holder}")
        try:
            yield
        except KeyboardInterrupt as interruption:
            if any(entry.name != LOCK for entry in folder.iterdir()):
                interruption.args = (f"the same command resumes {shown(folder)}",)
            raise
        finally:
            unlock(lock)


def locked(path: Path, wait_s: float = WAIT_S) -> BaseFileLock | None:
    """Lock a file, which is made; None if another process has it. Locks end with their processes.

    The file that stands for one is removed by filelock once its process of this machine is gone.
    """
    from filelock import FileLock, SoftFileLock, Timeout

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for kind in (FileLock, SoftFileLock):
            lock = kind(path, timeout=wait_s, poll_interval=0.01, thread_local=False)
            try:
                lock.acquire()
                break
            except Timeout:
                return None
            except OSError as error:
                if kind is SoftFileLock or error.errno not in NO_LOCKS:
                    raise
    if isinstance(lock, SoftFileLock):
        warn(
            f"{shown(path.parent)}: its file system has no locks; the file '{path.name}' stands "
            "for one, and is to be removed by hand where a machine is lost while it writes there"
        )
    return lock


def unlock(lock: BaseFileLock) -> None:
    """Remove the file of a lock, and let go of it; Windows removes no open file."""
    steps = [lambda: Path(lock.lock_file).unlink(missing_ok=True), lock.release]
    for step in steps if sys.platform != "win32" else reversed(steps):
        with suppress(OSError):
            step()
