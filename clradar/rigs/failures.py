"""Failures of rig files: those of `clradar.files`, as `RigError`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NoReturn

from clradar.errors import RigError
from clradar.files import failures
from clradar.files.limits import MAX_MESH_BYTES

reading = partial(failures.reading, error=RigError)
file_bytes = partial(failures.read_bytes, limit=MAX_MESH_BYTES, error=RigError)


def fail(path: Path, expected: str, got: object) -> NoReturn:
    """Raise the `RigError` that names the file, what was expected and what was found."""
    failures.fail(path, expected, failures.clean(got), error=RigError)
