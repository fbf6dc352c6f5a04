"""One way to say what is wrong with a rig's file: its name, what was expected, what was found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from clradar.errors import ClradarError, RigError

MAX_FILE_BYTES = 2**29
"""A hand of a million vertices needs a tenth of it; scans carry large pictures, too."""

_SHOWN = 200


def fail(path: Path, expected: str, got: object) -> NoReturn:
    """Raise the `RigError` that names the file, what was expected and what was found."""
    raise RigError(f"{clean(path)}: expected {expected}, got {clean(got)}")


def clean(text: object) -> str:
    """Return text of a file on one printable line of bounded length."""
    line = " ".join(str(text).split()).encode("utf-8", "backslashreplace").decode("utf-8")
    line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in line[: _SHOWN + 1])
    return line if len(line) <= _SHOWN else line[:_SHOWN] + "..."


@contextmanager
def reading(path: Path, expected: str) -> Iterator[None]:
    """Turn whatever a damaged file makes a parser raise into one `RigError`."""
    try:
        yield
    except RigError:
        raise
    except ClradarError as error:
        raise RigError(f"{clean(path)}: {error}") from error
    except OSError as error:
        raise RigError(
            f"{clean(path)}: expected {expected}, got {error.strerror or clean(error)}"
        ) from error
    except Exception as error:  # the parsers below raise what the wrong byte makes them raise
        raise RigError(
            f"{clean(path)}: expected {expected}, got {type(error).__name__}: {clean(error)}"
        ) from error


def file_bytes(path: Path, expected: str, limit: int = MAX_FILE_BYTES) -> bytes:
    """Return the content of a regular file of at most `limit` bytes."""
    with reading(path, expected):
        if not path.is_file():  # a pipe would be waited for for ever
            found = "something that is no regular file" if path.exists() else "nothing there"
            fail(path, expected, found)
        size = path.stat().st_size
        if size > limit:
            fail(path, f"{expected} of at most {limit} bytes", f"{size} bytes")
        return path.read_bytes()


def index(path: Path, what: str, value: Any, count: int) -> int:
    """Return `value` if it is a whole number in [0, count)."""
    if type(value) is not int or not 0 <= value < count:
        fail(path, f"{what}: a whole number in [0, {count})", repr(value))
    return value
