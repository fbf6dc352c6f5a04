"""Global heaps of an HDF5 file (format specification, III.E), checked for chains without end.

The strings of attributes lie in global heap collections, chains of objects without a checksum.
HDF5 (2.0 and before) walks such a chain by adding each object's size; an object whose size leads
nowhere (one flipped bit is enough) keeps it busy for ever, and nothing can be caught. So the chains
are walked here first.
"""

from __future__ import annotations

import mmap
from pathlib import Path

from clradar.files.failures import fail

_SIGNATURE = b"GCOL\x01"
_HEADER = 16
_OBJECT_HEADER = 16
_TURN = 2**64


def check_heaps(path: Path) -> None:
    """Raise `MeasurementError` if a global heap collection of the file has no end.

    Assumes 8-byte lengths, which `hdf5_guard.check_sizes` makes sure of.
    """
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        at = content.find(_SIGNATURE)
        while at >= 0:
            size = int.from_bytes(content[at + 8 : at + 16], "little")
            # These bytes can turn up in data by chance; a size that fits hardly can. One that does
            # not fit makes HDF5 report an error by itself.
            if _HEADER < size <= len(content) - at and not _ends(content, at, size):
                fail(path, "strings in an HDF5 heap that ends", f"a damaged heap at byte {at}")
            at = content.find(_SIGNATURE, at + 1)


def _ends(content: mmap.mmap, start: int, size: int) -> bool:
    at, end = start + _HEADER, start + size
    while at + _OBJECT_HEADER <= end:
        index = int.from_bytes(content[at : at + 2], "little")
        length = int.from_bytes(content[at + 8 : at + 16], "little")
        # Object 0 is the free space, its length includes the header. Sums wrap as in C.
        step = length if index == 0 else (_OBJECT_HEADER + (length + 7) // 8 * 8) % _TURN
        if step == 0 or step > end - at:
            return False
        at += step
    return True
