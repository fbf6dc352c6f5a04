"""Read the dictionary that one recorded frame (`.npy`) holds."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import clean, fail, read_bytes, reading
from clradar.files.limits import MAX_FRAME_BYTES
from clradar.files.safe_pickle import ARRAYS, PickledArray, UnsafePickle, load
from measurement_io.npy_header import read_npy_header

_CUT = re.compile(r"expected (\d+) bytes in .*, but only (\d+) remain")
"""As pickletools says it."""

_EXPECTED = "a recorded frame (a .npy file with a pickled dictionary)"


def read_frame_dictionary(path: Path) -> dict[str, Any]:
    """Return the frame's dictionary without running anything that the file names.

    Parameters
    ----------
    path : Path
        A `.npy` file that holds one pickled dictionary as a 0-d object array.

    Returns
    -------
    dict
        String keys only. Arrays are read-only `numpy.ndarray` over the file's bytes; arrays of
        anything but numbers and text are left out.

    Raises
    ------
    MeasurementError
        Missing, unreadable, damaged, another kind of file, or a pickle that asks for more.
    """
    content = read_bytes(path, _EXPECTED, MAX_FRAME_BYTES)
    with reading(path, _EXPECTED):
        offset = _check_header(path, content)
        try:
            loaded = load(content, ARRAYS, "frame", offset)
        except UnsafePickle as refusal:
            fail(path, _EXPECTED, clean(refusal), cause=refusal)
        except ValueError as error:
            if cut := _CUT.search(str(error)):
                size = len(content) + int(cut[1]) - int(cut[2])
                fail(path, f"{size} bytes or more", f"{len(content)}: the file is truncated")
            raise
        if not isinstance(loaded, PickledArray) or not isinstance(loaded.value, list):
            fail(path, "a pickled 0-d object array", type(loaded).__name__)
        if loaded.shape != () or not isinstance(loaded.value[0], dict):
            fail(path, "a dictionary in a 0-d object array", f"shape {loaded.shape}")
        return _readable(loaded.value[0])


def _check_header(path: Path, content: bytes) -> int:
    """Check that the file is a 0-d object array and return where its pickle starts."""
    shape, _, dtype, offset = read_npy_header(path, io.BytesIO(content))
    if dtype != np.dtype(object) or shape != ():
        fail(
            path,
            "a recorded frame (a pickled dictionary in a 0-d object array)",
            clean(f"an array of {dtype} and shape {shape}"),
        )
    return offset


def _readable(raw: dict[Any, Any]) -> dict[str, Any]:
    frame: dict[str, Any] = {}
    for key, value in raw.items():
        if not isinstance(key, str):
            continue
        if isinstance(value, PickledArray):
            if not isinstance(value.value, np.ndarray):
                continue
            value = value.value
        frame[key] = value
    return frame
