"""Points with properties in PLY files, read block by block."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from clradar.files.failures import clean, fail, reading, regular_file_size
from clradar.files.limits import (
    MAX_PLY_HEADER_BYTES,
    MAX_PLY_LINE_BYTES,
    MAX_PLY_PROPERTIES,
    MAX_PLY_TEXT_BYTES,
)

BLOCK_POINTS = 2**16
_EXPECTED = "a PLY file of points"
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """The points of a PLY file, by its header.

    Attributes
    ----------
    count : int
        Number of points.
    dtype : structured numpy dtype
        Their properties, in the byte order of the file.
    text : bool
        Whether the points are text.
    offset : int
        Where the points start, bytes.
    """

    count: int
    dtype: np.dtype[np.void]
    text: bool
    offset: int

    @property
    def names(self) -> tuple[str, ...]:
        """The properties, in the order of the file."""
        return self.dtype.names or ()


def read_ply_header(path: Path, max_points: int) -> PlyHeader:
    """Return the header of a PLY file whose first element is its points.

    Raises
    ------
    MeasurementError
        Missing, another kind of file, more than `max_points`, or too short for its points.
    """
    size = regular_file_size(path, _EXPECTED)
    with reading(path, _EXPECTED), open(path, "rb") as file:
        start = file.read(MAX_PLY_HEADER_BYTES)
        if not re.match(rb"ply\r?\n", start):
            fail(path, _EXPECTED, "something else" if start else "an empty file")
        end = re.search(rb"\nend_header\r?\n", start)
        if end is None:
            fail(path, f"a header that ends within {MAX_PLY_HEADER_BYTES} bytes", "none")
        lines = start[: end.start()].decode("ascii", "replace").splitlines()[1:]
        header = _parsed(path, lines, end.end())
    if header.count > max_points:
        fail(path, f"at most {max_points} points", f"{header.count}")
    if header.text and size > MAX_PLY_TEXT_BYTES:
        fail(path, f"at most {MAX_PLY_TEXT_BYTES} bytes where points are text", f"{size}")
    # The shortest text of a property is one digit and what separates it from the next.
    least = 2 * len(header.names) - 1 if header.text else header.dtype.itemsize
    if header.count * least > size - header.offset:
        fail(path, f"{header.count} points", f"a file of {size} bytes, which is too short for them")
    return header


def ply_blocks(path: Path, header: PlyHeader) -> Iterator[np.ndarray]:
    """Yield the points of a PLY file in structured arrays of at most `BLOCK_POINTS`.

    Raises
    ------
    MeasurementError
        Cut short, or text that is no such number.
    """
    with reading(path, _EXPECTED), open(path, "rb") as file:
        file.seek(header.offset)
        for first in range(0, header.count, BLOCK_POINTS):
            n = min(BLOCK_POINTS, header.count - first)
            if header.text:
                yield _text_block(path, file, header, n)
                continue
            raw = file.read(n * header.dtype.itemsize)
            if len(raw) != n * header.dtype.itemsize:
                fail(path, f"{header.count} points", "a file that is cut short")
            yield np.frombuffer(raw, header.dtype)


def write_ply(
    path: Path, count: int, properties: Sequence[tuple[str, str]], blocks: Iterable[np.ndarray]
) -> None:
    """Write points as binary little-endian PLY.

    Parameters
    ----------
    path : Path
        Must not exist.
    count : int
        Points in all blocks together.
    properties : sequence of (name, type)
        Types as PLY names them: "double", "uchar".
    blocks : iterable of structured ndarray
        Of `ply_dtype(properties)`.
    """
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property {kind} {name}" for name, kind in properties]
    with open(path, "xb") as file:
        file.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
        for block in blocks:
            file.write(block.tobytes())


def ply_dtype(properties: Sequence[tuple[str, str]], order: str = "<") -> np.dtype[np.void]:
    """Return the packed structured dtype of points with these properties."""
    return np.dtype([(name, order + _TYPES[kind]) for name, kind in properties])


def require_properties(path: Path, header: PlyHeader, **kinds: str) -> None:
    """Raise `MeasurementError` unless the points have these properties.

    Parameters
    ----------
    **kinds : str
        Name, and what it has to be: "float" (or double), or "8-bit" (unsigned).
    """
    for name, kind in kinds.items():
        if name not in header.names:
            fail(path, f"a property '{name}' of its points", clean(", ".join(header.names))[:80])
        found = header.dtype[name]
        if (found.kind != "f") if kind == "float" else (found != np.uint8):
            fail(path, f"'{name}' of type {kind}", f"{found}")


def _parsed(path: Path, lines: list[str], offset: int) -> PlyHeader:
    order = None
    count = None
    properties: list[tuple[str, str]] = []
    for line in lines:
        words = line.split()
        scalar = len(words) == 3 and words[0] == "property" and words[1] in _TYPES
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and order is None and len(words) == 3 and words[1] in _ORDERS:
            order = words[1]
        elif words[0] == "element" and len(words) == 3:
            if count is not None:
                break  # what follows the points is of no use here
            if words[1] != "vertex" or not re.fullmatch("[0-9]{1,12}", words[2]):
                fail(path, "an element 'vertex' first", f"'{clean(line)[:60]}'")
            count = int(words[2])
        elif scalar and count is not None:
            properties.append((words[2], words[1]))
        else:
            fail(path, "a PLY header of scalar properties", f"the line '{clean(line)[:60]}'")
    if order is None or count is None or not 0 < len(properties) <= MAX_PLY_PROPERTIES:
        fail(path, "format, points and their properties in the header", "a header without")
    if len({name for name, _ in properties}) < len(properties):
        fail(path, "different names of properties", "one that is there twice")
    return PlyHeader(count, ply_dtype(properties, _ORDERS[order]), order == "ascii", offset)


def _text_block(path: Path, file: BinaryIO, header: PlyHeader, n: int) -> np.ndarray:
    rows = []
    for _ in range(n):
        words = file.readline(MAX_PLY_LINE_BYTES).split()
        if len(words) != len(header.names):
            fail(path, f"{len(header.names)} numbers in the line of each point", f"{len(words)}")
        rows.append(words)
    values = np.array(rows, dtype=np.float64)
    block = np.empty(n, header.dtype)
    for i, name in enumerate(header.names):
        column = values[:, i]
        kind = header.dtype[name]
        if kind.kind in "iu":
            limits = np.iinfo(kind)
            whole = (column == np.floor(column)) & (column >= limits.min) & (column <= limits.max)
            if not whole.all():
                fail(path, f"whole numbers of type {kind} as '{name}'", "something else")
        with np.errstate(over="ignore"):  # infinite ones are the caller's to refuse
            block[name] = column
    return block
