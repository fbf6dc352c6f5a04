"""Open a container file of the kind that its content shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

from clradar.files.failures import fail, reading, regular_file_size
from measurement_io.confined.hdf5_guard import HDF5_MAGIC
from measurement_io.layouts.container import Container
from measurement_io.layouts.hdf5_container import opened_hdf5
from measurement_io.layouts.mat5_container import HEADER_BYTES, mat5_order, opened_mat5
from measurement_io.layouts.numpy_containers import opened_npy, opened_npz
from measurement_io.npy_header import NPY_MAGIC, read_npy_header

EXPECTED = "an HDF5, MATLAB (v5 or v7.3), .npz or plain .npy file"
_HDF5_OFFSETS = (0, 512, 1024, 2048, 4096)
"""Where HDF5 may begin: a program can put a block of its own before it, as MATLAB does."""


def opener_of(path: Path) -> Callable[[Path], AbstractContextManager[Container]] | None:
    """Return the function that opens a file as a container, None for a file of no such kind.

    Raises
    ------
    MeasurementError
        Missing, unreadable, no regular file.
    """
    regular_file_size(path, EXPECTED)
    with reading(path, EXPECTED), open(path, "rb") as file:
        start = file.read(_HDF5_OFFSETS[-1] + len(HDF5_MAGIC))
    if any(start[at : at + len(HDF5_MAGIC)] == HDF5_MAGIC for at in _HDF5_OFFSETS):
        return opened_hdf5
    if start.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return opened_npz
    if start.startswith(NPY_MAGIC):
        return opened_npy
    if mat5_order(start[:HEADER_BYTES]) is not None:
        return opened_mat5
    return None


@contextmanager
def open_container(path: Path) -> Iterator[Container]:
    """Open a file; whatever happens inside ends in a `MeasurementError`."""
    opener = opener_of(path)
    if opener is None:
        fail(path, EXPECTED, "something else")
    with reading(path, EXPECTED), opener(path) as container:
        yield container


def is_plain_array(path: Path) -> bool:
    """Whether an `.npy` file holds an array of numbers or text, and no pickled object."""
    with reading(path, "an .npy file"), open(path, "rb") as file:
        dtype = read_npy_header(path, file)[2]
    return dtype != np.dtype(object)
