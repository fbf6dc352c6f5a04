"""Failures of rig files: those of `clradar.files`, as `RigError`."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NoReturn

from clradar.errors import RigError
from clradar.files import failures
from clradar.files.failures import clean
from clradar.files.limits import MAX_RIG_BYTES


def fail(path: Path, expected: str, got: object) -> NoReturn:
    """Raise the `RigError` that names the file, what was expected and what was found."""
    failures.fail(path, expected, clean(got), error=RigError)


def reading(path: Path, expected: str) -> AbstractContextManager[None]:
    """Turn whatever a damaged file makes a parser raise into one `RigError`."""
    return failures.reading(path, expected, error=RigError)


def file_bytes(path: Path, expected: str) -> bytes:
    """Return the content of a regular file of at most `MAX_RIG_BYTES`."""
    return failures.read_bytes(path, expected, MAX_RIG_BYTES, error=RigError)


def index(path: Path, what: str, value: Any, count: int) -> int:
    """Return `value` if it is a whole number in [0, count)."""
    if type(value) is not int or not 0 <= value < count:
        fail(path, f"{what}: a whole number in [0, {count})", repr(value))
    return value
