"""MATLAB v5 files (save -v6 and -v7): numeric arrays, text, and structs of them.

Format: MATLAB, "MAT-File Format" (The MathWorks, 2023). The elements are walked here instead of
being handed to `scipy.io.loadmat`, which believes the sizes that a file declares.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import (
    MAX_DIMENSIONS,
    MAX_INFLATED_BYTES,
    MAX_MAT5_FIELDS,
    MAX_MAT5_NAME_BYTES,
    MAX_NESTING,
    MAX_TEXT_CHARACTERS,
)
from measurement_io.layouts.byte_source import ByteSource, check_size, kept_shape, read_array
from measurement_io.layouts.container import Container, Key

HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_ELEMENT_DTYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_TEXT_DTYPES = {**_ELEMENT_DTYPES, 16: "u1", 17: "u2", 18: "u4"}
_CLASS_DTYPES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
_CELL, _STRUCT, _CHAR = 1, 2, 4
_OTHER_CLASSES = {
    1: "cell array", 3: "object", 5: "sparse array", 16: "function handle", 17: "object",
}  # fmt: skip
_COMPLEX_FLAG, _LOGICAL_FLAG = 0x0800, 0x0200
_INFLATE_BLOCK = 2**16


class _Inflated(io.RawIOBase):
    """The inflated bytes of one compressed element."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._left = file, size
        self._inflate = zlib.decompressobj()

    def readable(self) -> bool:
        return True

    def readinto(self, target: Any) -> int:
        while not self._inflate.eof:
            data = self._inflate.unconsumed_tail
            if not data:
                data = self._file.read(min(self._left, _INFLATE_BLOCK))
                self._left -= len(data)
                if not data:
                    return 0
            part = self._inflate.decompress(data, len(target))
            if part:
                target[: len(part)] = part
                return len(part)
        return 0

    @property
    def complete(self) -> bool:
        """Whether the end was reached, where the checksum is compared."""
        return self._inflate.eof


@dataclass(frozen=True, slots=True)
class _Wanted:
    """The key that is read, and what is kept of it."""

    key: Key
    pick: Mapping[int, int]


class Mat5Container(Container):
    """Variables, and the fields of structs as "struct/field"."""

    def __init__(self, path: Path, file: BinaryIO, order: Literal["<", ">"]) -> None:
        super().__init__(path, "a MATLAB v5 file", matlab=True)
        self._file = file
        self._order: Literal["<", ">"] = order
        self._size = path.stat().st_size
        # Where the variable is that holds a key: position of its tag.
        self._places: dict[str, int] = {}
        position = HEADER_BYTES
        budget = MAX_INFLATED_BYTES
        while position < self._size:
            walk = _Walk(self, position, budget, {})
            for key in walk.keys:
                self.add(key)
                self._places[key.name] = position
            position, budget = walk.end, walk.budget

    def _read(self, key: Key, pick: Mapping[int, int]) -> np.ndarray:
        found = self._found(key, pick)
        assert isinstance(found, np.ndarray)
        return found

    def _text(self, key: Key) -> str:
        found = self._found(key, {})
        assert isinstance(found, str)
        return found

    def _found(self, key: Key, pick: Mapping[int, int]) -> np.ndarray | str:
        wanted = {key.name: _Wanted(key, pick)}
        found = _Walk(self, self._places[key.name], MAX_INFLATED_BYTES, wanted).found
        if key.name not in found:
            fail(self.path, f"'{clean(key.name)[:80]}' where it was", "another variable")
        return found[key.name]

    def read_several(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the numbers of some small keys, each variable read once for all its fields.

        What cannot be read is left out, with the other fields of its variable.
        """
        by_place: dict[int, dict[str, _Wanted]] = {}
        for name in names:
            wanted = by_place.setdefault(self._places[name], {})
            wanted[name] = _Wanted(self.keys[name], {})
        found: dict[str, Any] = {}
        for position, wanted in by_place.items():
            with suppress(MeasurementError), reading(self.path, "readable numbers"):
                found |= _Walk(self, position, MAX_INFLATED_BYTES, wanted).found
        return found

    # What a walk needs to know of the file.
    @property
    def file(self) -> BinaryIO:
        return self._file

    @property
    def size(self) -> int:
        return self._size

    @property
    def order(self) -> Literal["<", ">"]:
        return self._order


class _Walk:
    """One pass through one variable of the file: lists its keys, and reads the requested ones."""

    def __init__(
        self,
        container: Mat5Container,
        position: int,
        budget: int,
        wanted: Mapping[str, _Wanted],
    ) -> None:
        self._path, self._order = container.path, container.order
        self._wanted = wanted
        self.keys: list[Key] = []
        self.found: dict[str, Any] = {}
        self.budget = budget
        file = container.file
        file.seek(position)
        place = f"the variable at byte {position}"
        source = ByteSource(self._path, place, file, container.size - position, seekable=True)
        kind, size, _ = self._tag(source, small=False)
        if size > source.left:
            fail(self._path, f"{size} bytes in {place}", f"{source.left}: it is cut short")
        # Compressed elements are not padded.
        self.end = position + 8 + (size if kind == _COMPRESSED else _padded(size))
        if kind == _MATRIX:
            inner = ByteSource(self._path, place, file, size, seekable=True)
            self._matrix(inner, size, "", 0)
        elif kind == _COMPRESSED:
            self._compressed(file, size, place)
        else:
            fail(self._path, f"{place} to be an array", f"an element of type {kind}")

    def _compressed(self, file: BinaryIO, size: int, place: str) -> None:
        raw = _Inflated(file, size)
        stream = io.BufferedReader(raw, _INFLATE_BLOCK)
        source = ByteSource(self._path, place, stream, self.budget)
        kind, inner_size, _ = self._tag(source, small=False)
        if kind != _MATRIX:
            fail(self._path, f"{place} to be an array", f"a compressed element of type {kind}")
        if inner_size > source.left:
            fail(
                self._path,
                f"variables that inflate to at most {MAX_INFLATED_BYTES} bytes",
                f"{inner_size} bytes more in {place}",
            )
        inner = ByteSource(self._path, place, stream, inner_size)
        plain = self._matrix(inner, inner_size, "", 0)
        if self._wanted or not plain:
            inner.skip(inner.left)
            # To the very end, where zlib compares its checksum.
            if stream.read(1) or not raw.complete:
                fail(self._path, f"{place} to end after its array", "more, or a missing end")
        self.budget -= inner.position

    def _matrix(self, source: ByteSource, size: int, name: str, depth: int) -> bool:
        """Walk the inside of one array element of `size` bytes.

        Returns
        -------
        bool
            True for an array that is only listed: its numbers have not been passed over.
        """
        if depth > MAX_NESTING:
            fail(self._path, f"structs nested at most {MAX_NESTING} deep", "more")
        if size == 0:  # MATLAB's short form of []
            self._list(Key(name, (0, 0), "empty", "other"))
            return False
        start = source.position
        flags = self._small(source, _UINT32, 8, "array flags")
        if len(flags) != 8:
            fail(self._path, "8 bytes of array flags", f"{len(flags)}")
        word = int(np.frombuffer(flags, f"{self._order}u4")[0])
        array_class = word & 0xFF
        if array_class == 17:  # opaque objects have no sizes
            own = self._small(source, _INT8, MAX_MAT5_NAME_BYTES, "a name").decode("latin1")
            self._list(Key(_join(name, own), (), "object", "other"))
            self._skip_rest(source, start, size)
            return False
        raw_shape = self._small(source, _INT32, 4 * MAX_DIMENSIONS, "sizes")
        shape = tuple(int(n) for n in np.frombuffer(raw_shape, f"{self._order}i4"))
        if len(shape) < 2 or min(shape) < 0:
            fail(self._path, "an array of at least two sizes from 0", f"sizes {shape}")
        own = self._small(source, _INT8, MAX_MAT5_NAME_BYTES, "a name").decode("latin1")
        name = _join(name, own) if depth == 0 else name
        if array_class == _STRUCT:
            self._struct(source, shape, name, depth)
        else:
            done = self._leaf(source, word, shape, name, depth)
            if not done:
                return True
        self._skip_rest(source, start, size)
        return False

    def _skip_rest(self, source: ByteSource, start: int, size: int) -> None:
        left = size - (source.position - start)
        if left < 0:
            fail(self._path, "elements that end inside their array", "one that does not")
        source.skip(left)

    def _leaf(
        self, source: ByteSource, word: int, shape: tuple[int, ...], name: str, depth: int
    ) -> bool:
        array_class, is_complex = word & 0xFF, bool(word & _COMPLEX_FLAG)
        if array_class == _CHAR:
            key = Key(name, shape, "text", "text" if min(shape) <= 1 else "other")
            if math.prod(shape) > MAX_TEXT_CHARACTERS:
                key = Key(name, shape, "long text", "other")
        elif array_class not in _CLASS_DTYPES:
            kind = _OTHER_CLASSES.get(array_class, f"class {array_class}")
            key = Key(name, shape, kind, "other")
        elif word & _LOGICAL_FLAG:
            key = Key(name, shape, "logical", "other")
        else:
            dtype = _CLASS_DTYPES[array_class]
            kind = str(np.result_type(dtype, "c8") if is_complex else np.dtype(dtype))
            key = Key(name, shape, kind, "numbers")
        self._list(key)
        wanted = self._wanted.get(name)
        if wanted is None:
            return depth > 0
        if wanted.key != key:
            fail(self._path, f"{wanted.key}", f"{key}")
        if key.content == "text":
            self.found[name] = self._characters(source, shape)
        else:
            self.found[name] = self._numbers(source, key, array_class, is_complex, wanted.pick)
        return True

    def _numbers(
        self,
        source: ByteSource,
        key: Key,
        array_class: int,
        is_complex: bool,
        pick: Mapping[int, int],
    ) -> np.ndarray:
        place = f"'{clean(key.name)[:80]}'"
        dtype = np.dtype(key.kind)
        check_size(self._path, place, key.shape, dtype.itemsize, pick)
        real = self._part(source, key.shape, pick, place)
        if not is_complex:
            return real.astype(dtype, copy=False)
        result = np.empty(kept_shape(key.shape, pick), dtype, order="F")
        result.real = real
        del real
        result.imag = self._part(source, key.shape, pick, place)
        return result

    def _part(
        self, source: ByteSource, shape: tuple[int, ...], pick: Mapping[int, int], place: str
    ) -> np.ndarray:
        """Return the real or the imaginary numbers of an array, in the type of the file."""
        kind, size, small = self._tag(source)
        if kind not in _ELEMENT_DTYPES:
            fail(self._path, f"numbers in {place}", f"an element of type {kind}")
        dtype = np.dtype(_ELEMENT_DTYPES[kind]).newbyteorder(self._order)
        want = math.prod(shape) * dtype.itemsize
        if size != want:
            fail(self._path, f"{want} bytes of {dtype} in {place} {shape}", f"{size}")
        if small is not None:
            source = ByteSource(self._path, place, io.BytesIO(small), size)
        array = read_array(source, dtype, shape, pick, fortran=True)
        if small is None:
            self._skip_padding(source, size)
        return array

    def _characters(self, source: ByteSource, shape: tuple[int, ...]) -> str:
        kind, size, small = self._tag(source)
        if kind not in _TEXT_DTYPES or size > 4 * MAX_TEXT_CHARACTERS:
            fail(self._path, "text", f"an element of type {kind} and {size} bytes")
        content = small if small is not None else source.read(size)
        if kind == 16:
            return content.decode("utf-8")
        codes = np.frombuffer(content, np.dtype(_TEXT_DTYPES[kind]).newbyteorder(self._order))
        return "".join(map(chr, codes.tolist()))

    def _struct(self, source: ByteSource, shape: tuple[int, ...], name: str, depth: int) -> None:
        count = math.prod(shape)
        if count != 1:
            self._list(Key(name, shape, "struct array (only a single struct is read)", "other"))
            return
        length_raw = self._small(source, _INT32, 4, "the length of field names")
        if len(length_raw) != 4:
            fail(self._path, "the length of field names in 4 bytes", f"{len(length_raw)}")
        length = int(np.frombuffer(length_raw, f"{self._order}i4")[0])
        raw = self._small(source, _INT8, MAX_MAT5_FIELDS * 64, "field names")
        if not 0 < length <= 4096 or len(raw) % length:
            fail(self._path, f"field names of {length} bytes each", f"{len(raw)} bytes")
        for start in range(0, len(raw), length):
            field = raw[start : start + length].split(b"\0")[0].decode("latin1")
            kind, size, _ = self._tag(source, small=False)
            if kind != _MATRIX:
                fail(self._path, f"an array in the field '{clean(field)[:80]}'", f"type {kind}")
            if size > source.left:
                fail(self._path, f"{size} bytes in '{clean(field)[:80]}'", f"{source.left}")
            before = source.position
            self._matrix(source, size, _join(name, field), depth + 1)
            self._skip_rest(source, before, size)

    def _list(self, key: Key) -> None:
        if key.name:  # a nameless variable is MATLAB's own workspace of function handles
            self.keys.append(key)

    def _tag(self, source: ByteSource, *, small: bool = True) -> tuple[int, int, bytes | None]:
        """Return type, size in bytes, and the content where it is in the tag itself."""
        raw = source.read(8)
        first, second = (int(n) for n in np.frombuffer(raw, f"{self._order}u4"))
        if first >> 16 == 0:
            return first, second, None
        kind, size = first & 0xFFFF, first >> 16
        if size > 4 or not small:
            fail(self._path, "the tag of an element", f"a short one of {size} bytes")
        return kind, size, raw[4 : 4 + size]

    def _small(self, source: ByteSource, want: int, limit: int, what: str) -> bytes:
        """Return the content of an element of type `want` that is held whole."""
        kind, size, small = self._tag(source)
        # Some writers give names as text and sizes as unsigned.
        same = {_INT8: (1, 2, 16), _INT32: (5, 6), _UINT32: (5, 6)}[want]
        if kind not in same or size > limit:
            fail(self._path, f"{what} of at most {limit} bytes", f"type {kind} of {size} bytes")
        if small is not None:
            return small
        content = source.read(size)
        self._skip_padding(source, size)
        return content

    def _skip_padding(self, source: ByteSource, size: int) -> None:
        # Some writers leave the padding out after the very last element.
        source.skip(min(_padded(size) - size, source.left))


def _padded(size: int) -> int:
    return (size + 7) // 8 * 8


def _join(prefix: str, name: str) -> str:
    return f"{prefix}/{name}" if prefix else name


def mat5_order(start: bytes) -> Literal["<", ">"] | None:
    """Return the byte order that the first 128 bytes of a MATLAB v5 file give, None if none."""
    mark = start[124:HEADER_BYTES]
    if len(start) < HEADER_BYTES or 0 in start[:4]:  # text there; zeros would be a v4 file
        return None
    return "<" if mark == b"\x00\x01IM" else ">" if mark == b"\x01\x00MI" else None


@contextmanager
def opened_mat5(path: Path) -> Iterator[Mat5Container]:
    with open(path, "rb") as file:
        order = mat5_order(file.read(HEADER_BYTES))
        if order is None:
            fail(path, "the header of a MATLAB v5 file", "something else")
        yield Mat5Container(path, file, order)
