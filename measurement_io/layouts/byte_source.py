"""Arrays out of streams that may end early, lie about their size, or inflate without end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_ARRAY_BYTES

_BLOCK_BYTES = 2**22


class ByteSource:
    """A stream of at most `size` bytes; reading further is a `MeasurementError`.

    Parameters
    ----------
    path : Path
        The file, for messages.
    place : str
        What the stream holds, for messages.
    stream : object with read(n)
    size : int
        Bytes that may be read.
    seekable : bool
        Whether what is skipped need not be read. False for what is compressed.
    """

    __slots__ = ("_path", "_place", "_seekable", "_stream", "left", "position")

    def __init__(
        self, path: Path, place: str, stream: Any, size: int, *, seekable: bool = False
    ) -> None:
        self._path, self._place, self._stream = path, place, stream
        self._seekable = seekable
        self.left = size
        self.position = 0

    def read(self, count: int) -> bytes:
        """Return exactly `count` bytes."""
        self._take(count)
        parts, missing = [], count
        while missing:
            part = self._stream.read(missing)
            if not part:
                self._ended(count, count - missing)
            parts.append(part)
            missing -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def skip(self, count: int) -> None:
        """Pass over `count` bytes; of a compressed stream they are inflated and dropped."""
        self._take(count)
        if self._seekable:
            self._stream.seek(count, 1)
            return
        missing = count
        while missing:
            part = self._stream.read(min(missing, _BLOCK_BYTES))
            if not part:
                self._ended(count, count - missing)
            missing -= len(part)

    def _take(self, count: int) -> None:
        if count > self.left:
            self._ended(count, self.left)
        self.left -= count
        self.position += count

    def _ended(self, want: int, have: int) -> None:
        fail(self._path, f"{want} bytes more in {clean(self._place)}", f"{have}: it is cut short")


def kept_shape(shape: tuple[int, ...], pick: Mapping[int, int]) -> tuple[int, ...]:
    """Return the shape that is left when one index is picked from some axes."""
    return tuple(n for axis, n in enumerate(shape) if axis not in pick)


def check_size(
    path: Path, place: str, shape: tuple[int, ...], itemsize: int, pick: Mapping[int, int]
) -> None:
    """Raise `MeasurementError` if what is kept of an array is too large to be read."""
    for axis, index in pick.items():
        if not 0 <= index < shape[axis]:
            fail(
                path,
                f"{clean(place)} to have an index {index} on axis {axis} (from 0)",
                f"shape {shape}",
            )
    nbytes = math.prod(kept_shape(shape, pick)) * itemsize
    if nbytes > MAX_ARRAY_BYTES:
        fail(path, f"{clean(place)} to take at most {MAX_ARRAY_BYTES} bytes", f"{nbytes} bytes")


def read_array(
    source: ByteSource,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    pick: Mapping[int, int],
    *,
    fortran: bool,
) -> np.ndarray:
    """Return an array from a stream, block by block, without the axes that are picked from.

    Parameters
    ----------
    source : ByteSource
        Left behind the array's last byte, so that checksums are checked.
    dtype : dtype
    shape : tuple of int
    pick : mapping of int to int
        Axis and the one index that is kept of it. The rest is never held.
    fortran : bool
        Whether the first index runs fastest.
    """
    if fortran:
        last = len(shape) - 1
        turned = {last - axis: index for axis, index in pick.items()}
        return read_array(source, dtype, shape[::-1], turned, fortran=False).transpose()
    if len(shape) > 1 and shape[0] == 1:
        inner = {axis - 1: index for axis, index in pick.items() if axis}
        found = read_array(source, dtype, shape[1:], inner, fortran=False)
        return found if 0 in pick else found[np.newaxis]
    if not shape:
        return np.frombuffer(source.read(dtype.itemsize), dtype).reshape(())
    rows, row_shape = shape[0], shape[1:]
    row_bytes = math.prod(row_shape) * dtype.itemsize
    if rows * row_bytes == 0:
        return np.empty(kept_shape(shape, pick), dtype)
    at_once = max(1, _BLOCK_BYTES // row_bytes)
    inner_pick = tuple(pick.get(axis, slice(None)) for axis in range(1, len(shape)))
    every_row = (slice(None), *inner_pick)
    result = np.empty(kept_shape(shape, pick), dtype)
    wanted = pick.get(0)
    if wanted is not None:
        source.skip(wanted * row_bytes)
        row = np.frombuffer(source.read(row_bytes), dtype).reshape(row_shape)
        result[...] = row[inner_pick]
        source.skip((rows - wanted - 1) * row_bytes)
        return result
    for start in range(0, rows, at_once):
        count = min(at_once, rows - start)
        block = np.frombuffer(source.read(count * row_bytes), dtype).reshape(count, *row_shape)
        result[start : start + count] = block[every_row]
    return result
