"""Read files of measurements in confined processes: readers are not safe on damaged files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from clradar.files.confined import process
from clradar.files.failures import regular_file_size
from clradar.files.limits import (
    CPU_LIMIT_BYTES,
    CPU_LIMIT_INFLATED_BYTES,
    CPU_LIMIT_S,
    MEMORY_BYTES,
)

EXPECTED = "a readable HDF5 file"


def run(
    function: Callable[..., Any],
    path: Path,
    *arguments: Any,
    most_bytes: int | None = None,
    expected: str = EXPECTED,
    modules: tuple[str, ...] = ("h5py",),
    mapped_bytes: int = 0,
    copies: int = 2,
    companion: process.Companion | None = None,
) -> Any:
    """Call `function(path, *arguments)` in a confined process and return its result.

    At most `most_bytes` of arrays come back, eight times the file's size if not given; `copies` of
    them, or of the file, may be in memory at a time, without the `mapped_bytes`, which take none.
    All else is as of `clradar.files.confined.process.run`.
    """
    size = regular_file_size(path, expected)
    inflated = 0 if most_bytes is None else most_bytes
    return process.run(
        function,
        path,
        *arguments,
        expected=expected,
        cpu_s=CPU_LIMIT_S * (1 + size // CPU_LIMIT_BYTES + inflated // CPU_LIMIT_INFLATED_BYTES),
        memory_bytes=MEMORY_BYTES + copies * (inflated or size) + mapped_bytes,
        most_bytes=8 * size if most_bytes is None else most_bytes,
        modules=modules,
        companion=companion,
    )
