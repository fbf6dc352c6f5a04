"""One way to say what is wrong with a file: its name, what was expected, what was found."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from clradar.errors import ClradarError, MeasurementError

MAX_MESSAGE = 400
"""Characters of a foreign message that are passed on; a damaged file can make one of any length."""


def fail(path: str | os.PathLike[str], expected: str, got: str) -> NoReturn:
    """Raise the `MeasurementError` that names the file, what was expected and what was found."""
    raise MeasurementError(f"{shown(path)}: expected {expected}, got {got}")


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path as it can be printed: undecodable bytes and line breaks are escaped."""
    return clean(os.fspath(path))


def clean(text: object) -> str:
    """Return `text` on one printable line of bounded length."""
    line = " ".join(str(text).split())
    line = line.encode("utf-8", "backslashreplace").decode("utf-8")
    line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in line[: MAX_MESSAGE + 1])
    return line if len(line) <= MAX_MESSAGE else line[:MAX_MESSAGE] + "..."


@contextmanager
def reading(path: str | os.PathLike[str], expected: str) -> Iterator[None]:
    """Turn whatever a damaged file makes a parser raise into one `MeasurementError`.

    The libraries below raise OSError, KeyError, RuntimeError, ValueError, MemoryError and more,
    by which byte is wrong; a caller wants to catch one class.
    """
    try:
        yield
    except MeasurementError:
        raise
    except ClradarError as error:
        raise MeasurementError(f"{shown(path)}: {clean(error)}") from error
    except OSError as error:
        reason = error.strerror or clean(error)
        fail_from(error, path, expected, reason)
    except Exception as error:
        fail_from(error, path, expected, f"{type(error).__name__}: {clean(error)}")


def fail_from(
    error: BaseException, path: str | os.PathLike[str], expected: str, got: str
) -> NoReturn:
    raise MeasurementError(f"{shown(path)}: expected {expected}, got {got}") from error


def regular_file_size(path: Path, expected: str) -> int:
    """Return the size in bytes, or raise if `path` is no regular file.

    Opening a pipe or a terminal would wait for ever, so this is asked before every open.
    """
    with reading(path, expected):
        try:
            status = os.stat(path)
        except FileNotFoundError:
            fail(path, "a file or a folder", "nothing there (No such file or directory)")
    if stat.S_ISDIR(status.st_mode):
        fail(path, expected, "a folder")
    if not stat.S_ISREG(status.st_mode):
        fail(path, expected, "something that is no regular file")
    return status.st_size


def read_bytes(path: Path, expected: str, limit: int) -> bytes:
    """Return the content of a regular file of at most `limit` bytes."""
    size = regular_file_size(path, expected)
    if size > limit:
        fail(path, f"{expected} of at most {limit} bytes", f"{size} bytes")
    with reading(path, expected), open(path, "rb") as file:
        content = file.read(size)  # a read of the limit would allocate as much
    if len(content) != size:
        fail(path, f"{expected} of {size} bytes", f"{len(content)}: it changes while it is read")
    return content
