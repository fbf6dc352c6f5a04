"""PNG images of 16-bit grey, the only kind that a radar folder has; read in a confined process."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from clradar.files.confined.process import file_bytes
from clradar.files.failures import fail, reading
from clradar.files.limits import MAX_IMAGE_PIXELS, MAX_PNG_BYTES
from measurement_io.confined.reading import run

_EXPECTED = "a PNG image of 16-bit grey"
_PIL = ("PIL.Image", "PIL.PngImagePlugin")


def read_png16(path: Path) -> np.ndarray:
    """Return a 16-bit grey image, shape (rows, columns), uint16; row 0 is the first of the file."""
    most = 2 * MAX_IMAGE_PIXELS
    found: np.ndarray = run(
        pixels, path, MAX_IMAGE_PIXELS, most_bytes=most, expected=_EXPECTED, library="Pillow",
        modules=_PIL,
    )  # fmt: skip
    return found


def pixels(path: Path, most_pixels: int) -> np.ndarray:
    """Return the image, in the confined process."""
    from PIL import Image, PngImagePlugin

    content = file_bytes(path, _EXPECTED, MAX_PNG_BYTES)
    if not content:
        fail(path, _EXPECTED, "an empty file")
    with reading(path, _EXPECTED):
        if not content.startswith(b"\x89PNG\r\n\x1a\n"):
            fail(path, _EXPECTED, "something else")
        # Sizes are compared here; Pillow would warn of large ones.
        Image.MAX_IMAGE_PIXELS = None
        with PngImagePlugin.PngImageFile(io.BytesIO(content)) as image:
            width, height = image.size
            if not 0 < width * height <= most_pixels:
                fail(path, f"an image of at most {most_pixels} pixels", f"{width} x {height}")
            if image.mode not in ("I;16", "I") or image.info.get("interlace"):
                form = "interlaced, " if image.info.get("interlace") else ""
                fail(path, _EXPECTED, f"{form}one of the mode {image.mode}")
            image.verify()  # decoding alone does not compare the checksums of pixels
        with PngImagePlugin.PngImageFile(io.BytesIO(content)) as image:
            found = np.array(image)
        if found.shape != (height, width):
            fail(path, f"{height} rows of {width} pixels", f"an array of shape {found.shape}")
        return found.astype(np.uint16, copy=False)  # older versions of Pillow give int32
