"""One form for all failures of files: the file's name, what was expected, what was found."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from clradar.errors import ClradarError, MeasurementError, quoted
from clradar.files.limits import MAX_HOLES_BYTES, MAX_MESSAGE_CHARACTERS


def fail(
    path: str | os.PathLike[str],
    expected: str,
    got: str,
    *,
    error: type[ClradarError] = MeasurementError,
    cause: BaseException | None = None,
) -> NoReturn:
    """Raise the error that names the file, what was expected and what was found."""
    raise error(f"{shown(path)}: expected {expected}, got {quoted(got, sys.maxsize)}") from cause


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path as it can be printed: undecodable bytes and line breaks are escaped."""
    return clean(os.fspath(path))


def clean(text: object, times: int = 1) -> str:
    """Return a message of another program on one printable line of bounded length."""
    return quoted(text, times * MAX_MESSAGE_CHARACTERS)


@contextmanager
def reading(
    path: str | os.PathLike[str], expected: str, *, error: type[ClradarError] = MeasurementError
) -> Iterator[None]:
    """Turn whatever a damaged file makes a parser raise into one `error`."""
    try:
        yield
    except error:
        raise
    except ClradarError as cause:
        raise error(f"{shown(path)}: {clean(cause)}") from cause
    except OSError as cause:
        fail(path, expected, cause.strerror or clean(cause), error=error, cause=cause)
    except UnicodeDecodeError as cause:
        fail(path, expected, "bytes that are no UTF-8 text", error=error, cause=cause)
    except Exception as cause:
        fail(path, expected, f"{type(cause).__name__}: {clean(cause)}", error=error, cause=cause)


def regular_file_size(
    path: Path, expected: str, *, error: type[ClradarError] = MeasurementError
) -> int:
    """Return the size in bytes, or raise if `path` is no regular file: a pipe would block."""
    with reading(path, expected, error=error):
        try:
            status = os.stat(path)
        except FileNotFoundError:
            fail(path, expected, "nothing there (No such file or directory)", error=error)
        if stat.S_ISDIR(status.st_mode):
            fail(path, expected, "a folder", error=error)
        if not stat.S_ISREG(status.st_mode):
            fail(path, expected, "something that is no regular file", error=error)
        if status.st_size > MAX_HOLES_BYTES and _holes_bytes(path) > MAX_HOLES_BYTES:
            wanted = f"a file without holes of {MAX_HOLES_BYTES} bytes (cp --sparse=never)"
            fail(path, wanted, f"{status.st_size} bytes with more", error=error)
    return status.st_size


def _holes_bytes(path: Path) -> int:
    """Bytes of a file that take no space and read as zeros, at least while they are few.

    Not by the blocks that it takes: some file systems know them only seconds after it was written.
    """
    if sys.platform == "win32":
        return 0
    with open(path, "rb") as file:
        size, at, holes = os.fstat(file.fileno()).st_size, 0, 0
        while at < size and holes <= MAX_HOLES_BYTES:
            hole, at = file.seek(at, os.SEEK_HOLE), size
            with suppress(OSError):  # there is no data behind it
                at = file.seek(hole, os.SEEK_DATA)
            holes += at - hole
    return holes


def read_bytes(
    path: Path, expected: str, limit: int, *, error: type[ClradarError] = MeasurementError
) -> bytes:
    """Return the content of a regular file of at most `limit` bytes."""
    size = regular_file_size(path, expected, error=error)
    if size > limit:
        fail(path, f"{expected} of at most {limit} bytes", f"{size} bytes", error=error)
    with reading(path, expected, error=error), open(path, "rb") as file:
        content = file.read(size)  # a read of the limit would allocate as much
    if len(content) != size:
        got = f"{len(content)}: it changes while it is read"
        fail(path, f"{expected} of {size} bytes", got, error=error)
    return content
