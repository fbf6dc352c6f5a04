"""Write a file whole or not at all."""

from __future__ import annotations

import errno
import os
import platform
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from clradar.errors import ClradarError, OutputError
from clradar.files.failures import clean, shown


@contextmanager
def replacing(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary name in the target's folder; on success sync it and rename it to `path`."""
    target = Path(path)
    refuse_existing(target, force=force)
    temporary = _temporary(target)
    with writing(target, RuntimeError):  # which h5py raises at times of a full disk
        try:
            yield temporary
            _sync(temporary)
            _put(temporary, target, force=force)
            _sync(target.parent)
        finally:
            with suppress(OSError):
                temporary.unlink()


@contextmanager
def writing(target: Path, other: type[Exception] = ValueError) -> Iterator[None]:
    """Turn errors of the system, and `other` ones, as of bad names, into one of the target."""
    try:
        yield
    except ClradarError:
        raise
    except (OSError, other) as error:
        reason = getattr(error, "strerror", None) or clean(error)
        raise OutputError(f"{shown(target)}: cannot be written: {reason}") from error


def _put(temporary: Path, target: Path, *, force: bool) -> None:
    """Give the file its name; without `force` in one step that fails where the name is taken."""
    refuse_existing(target, force=force)
    if not force:
        with suppress(OSError):  # the name is taken, or the file system has no hard links
            os.link(temporary, target)
            return
        refuse_existing(target, force=force)
    os.replace(temporary, target)


def require_space(temporary: Path, size_bytes: int) -> None:
    """Raise `OSError` unless a file of this size can be written under a name that is free.

    For HDF5, which cannot close a file that the disk has no space for, and says so in many lines.
    """
    if sys.platform == "linux" and _reserved(temporary, size_bytes):
        return
    if size_bytes > shutil.disk_usage(temporary.parent).free:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _reserved(temporary: Path, size_bytes: int) -> bool:
    """Whether the file system has reserved the space, and let go of it; not all of them do.

    Not by `os.posix_fallocate`: where the file system cannot, such as NFS 3, that writes it all.
    """
    import ctypes

    system = ctypes.CDLL(None, use_errno=True)
    reserve = system.fallocate64 if hasattr(system, "fallocate64") else system.fallocate
    reserve.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)
    try:
        with open(temporary, "xb") as file:
            if reserve(file.fileno(), 0, 0, size_bytes) == 0:
                return True
            number = ctypes.get_errno()
            if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise OSError(number, os.strerror(number))
            return False
    finally:
        temporary.unlink(missing_ok=True)


_MACHINE = sha256(platform.node().encode()).hexdigest()[:6]


def _temporary(target: Path) -> Path:
    """A free name beside the target, which tells whose it is."""
    owner = f"{_MACHINE}-{os.getpid()}-{secrets.token_hex(4)}"
    return target.with_name(f".{target.name[:40]}.{owner}.tmp")


def remove_left(targets: Iterable[Path]) -> None:
    """Remove what processes of this machine that were killed had half written of these names."""
    if sys.platform == "win32":  # which cannot be asked whether a process is alive
        return
    ours = {(target.parent, f".{target.name[:40]}") for target in targets}
    for folder in {folder for folder, _ in ours}:
        for path in folder.glob(".*.tmp"):
            start, _, owner = path.name.rpartition(f".{_MACHINE}-")
            process, _, _ = owner.partition("-")
            if (folder, start) in ours and process.isdecimal() and not _is_alive(int(process)):
                _remove(path)


def remove_temporaries(folder: Path) -> None:
    """Remove what was half written in a folder that no other process writes into."""
    for path in folder.glob(".*.tmp"):
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        pass
    return True


def write_file(path: str | os.PathLike[str], content: bytes, *, force: bool = False) -> None:
    """Write a small file whole or not at all; see `replacing`."""
    with replacing(path, force=force) as temporary, open(temporary, "xb") as file:
        file.write(content)


def refuse_existing(target: Path, *, force: bool) -> None:
    """Raise `OutputError` unless `target` may be written."""
    name = shown(target)
    if "\0" in str(target):  # HDF5 would cut the name there and write another file
        raise OutputError(f"{name}: no file can have such a name")
    with writing(target):
        if not target.parent.is_dir():
            raise OutputError(f"{name}: expected an existing folder, got '{shown(target.parent)}'")
        if target.exists() and not target.is_file():  # a device or a pipe must not be replaced
            got = "a folder" if target.is_dir() else "something that is no regular file"
            raise OutputError(f"{name}: expected a file's name, got {got}")
        if os.path.lexists(target) and not force:
            raise OutputError(f"{name}: exists already; --force or force=True replaces it")


def _sync(path: Path) -> None:
    # A folder is synced too: the new name is part of the folder, not of the file. Windows opens no
    # folders, and syncs only files that were opened for writing.
    folder = path.is_dir()
    if folder and not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder beside `path`, for the caller to fill and to move from."""
    target = Path(path).absolute()
    temporary = _temporary(target)
    with writing(target):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.mkdir()
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def move_folder(source: Path, target: Path) -> None:
    """Rename a folder to a name that is free or that of an empty folder, and sync its parent."""
    with suppress(OSError):  # Windows renames to free names only
        os.rmdir(target)
    os.rename(source, target)
    _sync(target.parent)


def swap_folder(source: Path, target: Path, aside: Path) -> None:
    """Rename `source` to `target` where a folder may be, which then is `aside`.

    No two folders can be exchanged in one step, so a kill between the two renames leaves `target`
    missing and its content under `aside`; it never leaves a mixture of both.
    """
    try:
        if os.path.lexists(target):
            os.rename(target, aside)
        move_folder(source, target)
    except BaseException:  # an interruption, too, must not cost what was there
        if os.path.lexists(aside) and not os.path.lexists(target):
            os.rename(aside, target)
        raise
