"""What is read of a recording in the confined process: the dictionary of a frame, and images."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.confined.process import file_bytes, forbid_opening
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_FRAME_BYTES, MAX_PNG_BYTES, MAX_TIME_STAMPS
from clradar.files.pickles import ARRAYS, PickledArray, UnsafePickle, load

EXPECTED = "a recorded frame (a .npy file with a pickled dictionary)"

PNG = "a PNG image of 16-bit grey"

_CUT = re.compile(r"expected (\d+) bytes in .*, but only (\d+) remain")  # as pickletools says it
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def npy_header(path: Path, stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape and dtype of an `.npy` stream."""
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        fail(path, "an .npy header of version 1.0 or 2.0", f"version {version[0]}.{version[1]}")
    shape, _, dtype = _HEADERS[version](stream)
    if any(type(n) is not int or n < 0 for n in shape):
        fail(path, "an .npy header with sizes from 0", clean(shape))
    return shape, dtype


def is_plain(path: Path) -> bool:
    """Whether a file holds an array of numbers or text, and no pickled object."""
    with reading(path, "an .npy file"), open(path, "rb") as file:
        forbid_opening()
        return npy_header(path, file)[1] != np.dtype(object)


def read_dictionary(path: Path, only: str | None = None) -> dict[str, Any]:
    """Return the frame's dictionary, or of `only` one key: its arrays, and plain values.

    Plain are numbers, texts and lists of numbers; other values are None.
    """
    content = file_bytes(path, EXPECTED, MAX_FRAME_BYTES)
    with reading(path, EXPECTED):
        stream = io.BytesIO(content)
        shape, dtype = npy_header(path, stream)
        if dtype != np.dtype(object) or shape != ():
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
        chosen = {k: v for k, v in items if isinstance(k, str) and only in (None, k)}
        arrays = {k: v.value for k, v in chosen.items() if k in ("xr", "fvec") and _is_array(v)}
        return {key: arrays.get(key, _plain(value)) for key, value in chosen.items()}


def _is_array(value: Any) -> bool:
    return isinstance(value, PickledArray) and isinstance(value.value, np.ndarray)


def _plain(value: Any) -> Any:
    """Return a number, a text or a list of numbers as JSON knows it; None for anything else."""
    if _is_array(value):
        array = value.value
        if array.size > MAX_TIME_STAMPS or array.dtype.kind not in "iufbU":
            return None
        value = array.ravel().tolist() if array.ndim else array[()].item()
    if isinstance(value, list | tuple):
        if len(value) > MAX_TIME_STAMPS:
            return None
        items = [_plain(item) for item in value]
        while len(items) == 1 and isinstance(items[0], list):
            items = items[0]
        return items if all(isinstance(item, int | float) for item in items) else None
    return value if is_scalar(value) else None


def is_scalar(value: Any) -> bool:
    """Whether a value is a text or a number that a frame's dictionary can hold."""
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, str) or (isinstance(value, int) and abs(value) < 2**64)


def pixels(path: Path, most_pixels: int) -> np.ndarray:
    """Return the image, in the confined process."""
    from PIL import Image, PngImagePlugin

    content = file_bytes(path, PNG, MAX_PNG_BYTES)
    with reading(path, PNG):
        Image.MAX_IMAGE_PIXELS = None  # compared here; Pillow would warn of large ones
        with PngImagePlugin.PngImageFile(io.BytesIO(content)) as image:
            width, height = image.size
            if not 0 < width * height <= most_pixels:
                fail(path, f"an image of at most {most_pixels} pixels", f"{width} x {height}")
            if image.mode not in ("I;16", "I") or image.info.get("interlace"):
                form = "interlaced, " if image.info.get("interlace") else ""
                fail(path, PNG, f"{form}one of the mode {image.mode}")
            image.verify()  # decoding alone does not compare the checksums of pixels
        with PngImagePlugin.PngImageFile(io.BytesIO(content)) as image:
            image.load()  # or Pillow 10.0 loads modules in numpy's call to say what is wrong
            found = np.array(image)
        if found.shape != (height, width):
            fail(path, f"{height} rows of {width} pixels", f"an array of shape {found.shape}")
        return found.astype(np.uint16, copy=False)  # older versions of Pillow give int32
