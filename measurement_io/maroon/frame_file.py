"""The dictionary that one recorded frame (`.npy`) holds, read in the confined process."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.confined.process import file_bytes, forbid_opening
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_FRAME_BYTES, MAX_TIME_STAMPS
from clradar.files.pickles import ARRAYS, PickledArray, UnsafePickle, load

EXPECTED = "a recorded frame (a .npy file with a pickled dictionary)"
NPY_MAGIC = b"\x93NUMPY"

_CUT = re.compile(r"expected (\d+) bytes in .*, but only (\d+) remain")
"""As pickletools says it."""

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def npy_header(path: Path, stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, whether it is in Fortran's order, and dtype of an `.npy` stream."""
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        fail(path, "an .npy header of version 1.0 or 2.0", f"version {version[0]}.{version[1]}")
    shape, fortran, dtype = _HEADERS[version](stream)
    if any(type(n) is not int or n < 0 for n in shape):
        fail(path, "an .npy header with sizes from 0", clean(shape))
    return shape, bool(fortran), dtype


def read_dictionary(path: Path, only: str | None = None) -> dict[str, Any]:
    """Return the frame's dictionary; {"plain": True} for an array of numbers or text.

    Of its values there are numbers, texts, lists of numbers, and arrays of numbers or text; with
    `only`, that of one key.
    """
    content = file_bytes(path, EXPECTED, MAX_FRAME_BYTES)
    with reading(path, EXPECTED):
        stream = io.BytesIO(content)
        shape, _, dtype = npy_header(path, stream)
        if dtype != np.dtype(object):
            return {"plain": True, "what": f"an array of {dtype} and shape {shape}"}
        if shape != ():
            expected = "a recorded frame (a pickled dictionary in a 0-d object array)"
            fail(path, expected, clean(f"an array of {dtype} and shape {shape}"))
        try:
            loaded = load(content, ARRAYS, "frame", stream.tell())
        except UnsafePickle as refusal:
            fail(path, EXPECTED, clean(refusal), cause=refusal)
        except ValueError as error:
            if cut := _CUT.search(str(error)):
                size = len(content) + int(cut[1]) - int(cut[2])
                fail(path, f"{size} bytes or more", f"{len(content)}: the file is truncated")
            raise
        if not isinstance(loaded, PickledArray) or not isinstance(loaded.value, list):
            fail(path, "a pickled 0-d object array", type(loaded).__name__)
        if loaded.shape != () or not isinstance(loaded.value[0], dict):
            fail(path, "a dictionary in a 0-d object array", f"shape {loaded.shape}")
        items = loaded.value[0].items()
        found = {k: _plain(v) for k, v in items if isinstance(k, str) and only in (None, k)}
        return {"plain": False, "frame": {key: v for key, v in found.items() if v is not None}}


def is_plain(path: Path) -> bool:
    """Whether a file holds an array of numbers or text, and no pickled object."""
    with reading(path, "an .npy file"), open(path, "rb") as file:
        forbid_opening()
        return npy_header(path, file)[2] != np.dtype(object)


def _plain(value: Any) -> Any:
    """Return what can be sent and means something; None for the rest."""
    if isinstance(value, PickledArray):
        return value.value if isinstance(value.value, np.ndarray) else None
    if isinstance(value, list | tuple):
        if len(value) > MAX_TIME_STAMPS:
            return None
        items = [_plain(item) for item in value]
        whole = all(isinstance(item, int | float | np.ndarray) for item in items)
        return items if whole else None
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return value if abs(value) < 2**64 else None
    return value if isinstance(value, float) and math.isfinite(value) else None
