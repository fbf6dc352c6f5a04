"""PNG images (ISO/IEC 15948) of 16-bit grey, the only kind that a radar folder has."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from clradar.files.failures import fail, read_bytes, reading
from clradar.files.limits import MAX_IMAGE_PIXELS, MAX_PNG_BYTES

_EXPECTED = "a PNG image of 16-bit grey"
_HEADER = struct.Struct(">8sI4sIIBBBBB")
_START = (b"\x89PNG\r\n\x1a\n", 13, b"IHDR")


def read_png16(path: Path) -> np.ndarray:
    """Return a 16-bit grey image.

    Pillow decodes it, after its header was compared with `MAX_IMAGE_PIXELS` and the checksums of
    all chunks were compared. Pillow itself bounds compressed text and colour profiles.

    Returns
    -------
    ndarray, shape (rows, columns), uint16
        Row 0 is the first of the file.

    Raises
    ------
    MeasurementError
        Missing, damaged, larger, or another kind of image.
    """
    content = read_bytes(path, _EXPECTED, MAX_PNG_BYTES)
    with reading(path, _EXPECTED):
        if len(content) < _HEADER.size:
            fail(path, _EXPECTED, "a file that is cut short" if content else "an empty file")
        *start, width, height, bits, kind, _, _, interlaced = _HEADER.unpack_from(content)
        if tuple(start) != _START:
            fail(path, _EXPECTED, "something else")
        if not 0 < width * height <= MAX_IMAGE_PIXELS:
            fail(path, f"an image of at most {MAX_IMAGE_PIXELS} pixels", f"{width} x {height}")
        if (bits, kind) != (16, 0) or interlaced:
            form = "interlaced, " if interlaced else ""
            fail(path, _EXPECTED, f"{form}{bits} bits of PNG colour type {kind}")
        with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
            image.verify()  # decoding alone does not compare the checksums of pixels
        with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
            pixels = np.array(image)
        if pixels.shape != (height, width):
            fail(path, f"{height} rows of {width} pixels", f"an array of shape {pixels.shape}")
        return pixels.astype(np.uint16, copy=False)  # older versions of Pillow give int32


def write_png16(path: Path, pixels: np.ndarray) -> None:
    """Write a uint16 array, shape (rows, columns), row 0 first."""
    Image.fromarray(np.ascontiguousarray(pixels, dtype=np.uint16)).save(path, format="PNG")
