"""PNG files of 16-bit grey, the only kind that a radar folder has."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from clradar.files.failures import fail, read_bytes, reading

MAX_PIXELS = 2**24
"""Largest image: 4096 x 4096."""

MAX_PNG_BYTES = 2 * MAX_PIXELS + 2**20
"""Largest file: the pixels as they are, and a little for the form."""

_MAGIC = b"\x89PNG\r\n\x1a\n"
_EXPECTED = "a PNG image of 16-bit grey"
_GREY = 0


def read_png16(path: Path) -> np.ndarray:
    """Return a 16-bit grey image.

    Parameters
    ----------
    path : Path
        Its header is held against `MAX_PIXELS` before anything is decompressed. Chunks other than
        the header and the pixels (texts, colour profiles, animations) are never looked at.

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
        if not content.startswith(_MAGIC):
            fail(path, _EXPECTED, "something else" if content else "an empty file")
        chunks = list(_chunks(path, content))
        if not chunks or chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13:
            fail(path, _EXPECTED, "no image header at its start")
        width, height, bits, kind, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
        if not 0 < width * height <= MAX_PIXELS:
            fail(path, f"an image of at most {MAX_PIXELS} pixels", f"{width} x {height}")
        if (bits, kind) != (16, _GREY) or interlaced:
            form = "interlaced, " if interlaced else ""
            fail(path, _EXPECTED, f"{form}{bits} bits of PNG colour type {kind}")
        data = zlib.decompressobj()
        need = height * (1 + 2 * width)
        raw = data.decompress(b"".join(body for name, body in chunks if name == b"IDAT"), need + 1)
        if len(raw) != need:
            found = "more" if len(raw) > need else f"{len(raw)}"
            fail(path, f"{need} bytes of pixels", found)
        with Image.open(io.BytesIO(_minimal(chunks[0][1], raw)), formats=["PNG"]) as image:
            pixels = np.array(image)
        if pixels.shape != (height, width):
            fail(path, f"{height} rows of {width} pixels", f"an array of shape {pixels.shape}")
        return pixels.astype(np.uint16)  # older versions of the decoder give int32


def write_png16(path: Path, pixels: np.ndarray) -> None:
    """Write a uint16 array, shape (rows, columns), row 0 first."""
    Image.fromarray(np.ascontiguousarray(pixels, dtype=np.uint16)).save(path, format="PNG")


def _chunks(path: Path, content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield name and body of each chunk up to the end of the image."""
    at = len(_MAGIC)
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        name = content[at + 4 : at + 8]
        end = at + 8 + length
        if end + 4 > len(content):
            break
        if zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            fail(path, "a PNG image with right checksums", f"a wrong one in chunk {name!r}")
        if name == b"IEND":
            return
        if name in (b"IHDR", b"IDAT"):
            yield name, content[at + 8 : end]
        at = end + 4
    fail(path, _EXPECTED, "a file that is cut short")


def _minimal(header: bytes, raw: bytes) -> bytes:
    """Return a PNG of this header and these filtered rows, and nothing else."""
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(raw, 0)), (b"IEND", b""))
    return _MAGIC + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in parts
    )
