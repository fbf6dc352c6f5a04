"""Failures of rig files: those of `clradar.files`, as `RigError`."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import NoReturn

from clradar.errors import RigError
from clradar.files import failures
from clradar.files.failures import clean
from clradar.files.limits import MAX_MESH_BYTES


def fail(path: Path, expected: str, got: object) -> NoReturn:
    """Raise the `RigError` that names the file, what was expected and what was found."""
    failures.fail(path, expected, clean(got), error=RigError)


def reading(path: Path, expected: str) -> AbstractContextManager[None]:
    """Turn whatever a damaged file makes a parser raise into one `RigError`."""
    return failures.reading(path, expected, error=RigError)


def file_bytes(path: Path, expected: str) -> bytes:
    """Return the content of a regular file of at most `MAX_MESH_BYTES`."""
    return failures.read_bytes(path, expected, MAX_MESH_BYTES, error=RigError)
