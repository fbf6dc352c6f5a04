"""Plain `.npy` arrays and `.npz` archives of them. Nothing is ever unpickled."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_DIMENSIONS, MAX_INFLATED_BYTES, MAX_KEYS, MAX_TEXT_CHARACTERS
from measurement_io.layouts.byte_source import ByteSource, check_size, read_array
from measurement_io.layouts.container import Container, Content, Key, holds_numbers
from measurement_io.npy_header import read_npy_header

NPY_KEY = "array"
"""How a layout calls what an `.npy` file holds, which has no name."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1


class _Member:
    """Header and position of one `.npy` array."""

    __slots__ = ("dtype", "fortran", "offset", "shape")

    def __init__(self, path: Path, place: str, stream: Any, size: int) -> None:
        self.shape, self.fortran, self.dtype, self.offset = read_npy_header(path, stream)
        if len(self.shape) > MAX_DIMENSIONS:
            fail(path, f"{place} with at most {MAX_DIMENSIONS} axes", f"{len(self.shape)}")
        if self.dtype.hasobject:
            return
        want = self.offset + math.prod(self.shape) * self.dtype.itemsize
        if want != size:
            fail(
                path,
                f"{want} bytes in {place}, by its header ({clean(self.dtype)} {clean(self.shape)})",
                f"{size}",
            )

    def key(self, name: str) -> Key:
        content: Content = "other"
        kind = str(self.dtype)
        if self.dtype.hasobject:
            kind = "object (pickled, never read)"
        elif holds_numbers(self.dtype):
            content = "numbers"
        elif (
            self.dtype.kind in "SU"
            and self.shape in ((), (1,))
            and self.dtype.itemsize <= 4 * MAX_TEXT_CHARACTERS
        ):
            content, kind = "text", "text"
        return Key(name, self.shape, kind, content)

    def read(self, path: Path, place: str, stream: Any, pick: Mapping[int, int]) -> np.ndarray:
        check_size(path, place, self.shape, self.dtype.itemsize, pick)
        seekable = not isinstance(stream, zipfile.ZipExtFile)  # its checksum needs every byte
        size = self.offset + math.prod(self.shape) * self.dtype.itemsize
        source = ByteSource(path, place, stream, size, seekable=seekable)
        source.skip(self.offset)
        array = read_array(source, self.dtype, self.shape, pick, fortran=self.fortran)
        if stream.read(1):  # also makes an archive compare its checksum
            fail(path, f"{place} to end after its last number", "more bytes")
        return array

    def text(self, path: Path, place: str, stream: Any) -> str:
        value = self.read(path, place, stream, {}).reshape(())[()]
        return value.decode("utf-8") if isinstance(value, bytes) else str(value)


class NpyContainer(Container):
    """One plain array; its only key is "array"."""

    def __init__(self, path: Path, file: Any) -> None:
        super().__init__(path, "a plain .npy array")
        self._file = file
        self._member = _Member(path, "the file", file, path.stat().st_size)
        self.add(self._member.key(NPY_KEY))

    def _read(self, key: Key, pick: Mapping[int, int]) -> np.ndarray:
        self._file.seek(0)
        return self._member.read(self.path, "the array", self._file, pick)

    def _text(self, key: Key) -> str:
        self._file.seek(0)
        return self._member.text(self.path, "the array", self._file)


class NpzContainer(Container):
    """An archive of arrays; its keys are the members' names without `.npy`."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        super().__init__(path, "an .npz archive")
        self._archive = archive
        self._members: dict[str, tuple[zipfile.ZipInfo, _Member]] = {}
        entries = archive.infolist()
        if len(entries) > MAX_KEYS:
            fail(path, f"at most {MAX_KEYS} members", f"{len(entries)}")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            if name == entry.filename:
                self.add(Key(name, (), "no .npy array", "other"))
                continue
            place = f"'{clean(name)[:80]}'"
            if entry.flag_bits & _ENCRYPTED or entry.compress_type not in _METHODS:
                fail(path, f"{place} stored or deflated", "another method, or encrypted")
            if entry.file_size > MAX_INFLATED_BYTES:
                fail(
                    path,
                    f"{place} of at most {MAX_INFLATED_BYTES} bytes",
                    f"{entry.file_size} bytes",
                )
            with archive.open(entry) as stream:
                member = _Member(path, place, stream, entry.file_size)
            self._members[name] = (entry, member)
            self.add(member.key(name))

    def _read(self, key: Key, pick: Mapping[int, int]) -> np.ndarray:
        entry, member = self._members[key.name]
        with self._archive.open(entry) as stream:
            return member.read(self.path, f"'{clean(key.name)[:80]}'", stream, pick)

    def _text(self, key: Key) -> str:
        entry, member = self._members[key.name]
        with self._archive.open(entry) as stream:
            return member.text(self.path, f"'{clean(key.name)[:80]}'", stream)


@contextmanager
def opened_npy(path: Path) -> Iterator[NpyContainer]:
    with open(path, "rb") as file:
        yield NpyContainer(path, file)


@contextmanager
def opened_npz(path: Path) -> Iterator[NpzContainer]:
    with zipfile.ZipFile(path) as archive:
        yield NpzContainer(path, archive)
