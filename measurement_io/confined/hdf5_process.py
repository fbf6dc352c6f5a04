"""Read each HDF5 file in a confined process: the HDF5 library is not safe on damaged files."""

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
    function: Callable[..., Any], path: Path, *arguments: Any, most_bytes: int | None = None
) -> Any:
    """Call `function(path, *arguments)` in a confined process and return its result.

    Parameters
    ----------
    function : callable
        As of `clradar.files.confined.process.run`; opens the file with `hdf5_guard.opened`.
    path : Path
    *arguments
        What JSON can hold.
    most_bytes : int, optional
        Most bytes of arrays that may come back; eight times the file's size if not given.

    Raises
    ------
    MeasurementError
        What the function raises, or that the process died: of the file, or of its limits.
    """
    size = regular_file_size(path, EXPECTED)
    inflated = 0 if most_bytes is None else most_bytes
    reader = process.Reader(
        expected=EXPECTED,
        library="the HDF5 library",
        cpu_s=CPU_LIMIT_S * (1 + size // CPU_LIMIT_BYTES + inflated // CPU_LIMIT_INFLATED_BYTES),
        memory_bytes=MEMORY_BYTES + 2 * (size if most_bytes is None else most_bytes),
        most_bytes=8 * size if most_bytes is None else most_bytes,
        modules=("h5py",),
    )
    return process.run(reader, function, path, *arguments)
