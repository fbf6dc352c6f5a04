"""The header of an `.npy` file (numpy.lib.format, NEP 1), with its length bounded."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_NPY_HEADER_BYTES

NPY_MAGIC = b"\x93NUMPY"


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


def read_npy_header(
    path: Path, stream: _Stream
) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether it is in Fortran's order, dtype, and the header's length in bytes.

    Parameters
    ----------
    path : Path
        For messages.
    stream : object with read(n)
        At the start of the `.npy` content; left where the data starts.

    Raises
    ------
    MeasurementError
        Another version, or a header of unreasonable length.
    Exception
        Whatever numpy raises for a damaged header; the caller turns it into its own error.
    """
    start = stream.read(8)
    if len(start) != 8 or not start.startswith(NPY_MAGIC):
        fail(path, "the start of an .npy array", repr(start))
    version = (start[6], start[7])
    if version not in ((1, 0), (2, 0)):
        fail(path, "an .npy header of version 1.0 or 2.0", f"version {version[0]}.{version[1]}")
    width = 2 if version == (1, 0) else 4
    prefix = stream.read(width)
    length = int.from_bytes(prefix, "little")
    if len(prefix) != width or length > MAX_NPY_HEADER_BYTES:
        fail(path, f"an .npy header of at most {MAX_NPY_HEADER_BYTES} bytes", f"{length} bytes")
    text = io.BytesIO(prefix + stream.read(length))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a damaged header can be odd Python that still parses
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(text)
        else:
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(text)
    if any(not isinstance(n, int) or isinstance(n, bool) or n < 0 for n in shape):
        fail(path, "an .npy header with sizes from 0", clean(shape))
    return shape, bool(fortran), dtype, 8 + width + length
