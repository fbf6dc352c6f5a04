"""Keys and arrays of an HDF5 file of any program, read in the confined process.

MATLAB v7.3 files are HDF5 with MATLAB's conventions. Nothing but numbers, text and arrays leaves
`list_keys`, `read_key` and `read_text`; `hdf5_container` asks for them.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_CHUNK_BYTES, MAX_KEYS, MAX_NESTING, MAX_TEXT_CHARACTERS
from measurement_io.confined import hdf5_guard
from measurement_io.confined.hdf5_guard import DEFLATE, FLETCHER32, LZF, SHUFFLE
from measurement_io.layouts.byte_source import check_size
from measurement_io.layouts.container import Content, Key, holds_numbers

EXPECTED = "a readable HDF5 file"
FILTERS = (SHUFFLE, FLETCHER32, DEFLATE, LZF)

_LZF_RATIO = 88
"""LZF inflates three bytes to at most 264."""

_CHECKSUM_BYTES = 4
_MATLAB_NUMBERS = (
    b"double", b"single", b"int8", b"uint8", b"int16", b"uint16", b"int32", b"uint32", b"int64",
    b"uint64",
)  # fmt: skip


class Hdf5Contents:
    """Datasets by their path, "group/dataset".

    Of a MATLAB file the axes are in MATLAB's order, which is the reverse of the stored one.
    """

    def __init__(self, path: Path, file: Any, raw: BinaryIO) -> None:
        self.path, self._file, self._raw = path, file, raw
        self.matlab = is_matlab(raw.read(8))
        self.keys: dict[str, Key] = {}
        self._size = path.stat().st_size

    def list_keys(self) -> dict[str, Key]:
        """Return all keys of the file."""
        import h5py

        self._walk(self._file, "", 0, {h5py.h5o.get_info(self._file.id).addr})
        return self.keys

    def key(self, name: str) -> Key:
        """Return one key without a walk through the others."""
        return self._key(name, self._dataset(name))

    def _walk(self, group: Any, prefix: str, depth: int, seen: set[Any]) -> None:
        import h5py

        if depth > MAX_NESTING:
            fail(self.path, f"groups nested at most {MAX_NESTING} deep", "more")
        names = list(islice(group, MAX_KEYS + 1))
        if len(names) > MAX_KEYS:
            fail(self.path, f"at most {MAX_KEYS} keys in {clean(group.name)}", "more")
        for name in names:
            key = f"{prefix}{name}"
            if self.matlab and not prefix and name.startswith("#"):
                continue  # what cells and objects refer to
            link = group.get(name, getlink=True)
            if type(link) is not h5py.HardLink:
                kind = f"a link of kind {type(link).__name__}, not followed"
                self._add(Key(key, (), kind, "other"))
                continue
            found = group[name]
            if isinstance(found, h5py.Group):
                # A group can be linked to from several places, its own inside among them.
                if (identity := h5py.h5o.get_info(found.id).addr) not in seen:
                    seen.add(identity)
                    self._walk(found, f"{key}/", depth + 1, seen)
            elif isinstance(found, h5py.Dataset):
                self._add(self._key(key, found))

    def _add(self, key: Key) -> None:
        if len(self.keys) >= MAX_KEYS:
            fail(self.path, f"at most {MAX_KEYS} keys", "more")
        self.keys[key.name] = key

    def _key(self, name: str, found: Any) -> Key:
        shape = found.shape
        if shape is None:
            return Key(name, (), "empty", "other")
        shape = tuple(int(n) for n in (shape[::-1] if self.matlab else shape))
        try:
            dtype = found.dtype
        except (TypeError, ValueError) as error:
            return Key(name, shape, clean(error), "other")
        matlab_class = _matlab_class(found) if self.matlab else None
        if matlab_class == b"char":
            is_text = dtype.kind == "u" and math.prod(shape) <= MAX_TEXT_CHARACTERS
            return Key(name, shape, "text", "text" if is_text else "other")
        if matlab_class is not None and matlab_class not in _MATLAB_NUMBERS:
            kind = matlab_class.decode("ascii", "backslashreplace")
            return Key(name, shape, kind, "other")
        if self.matlab and "MATLAB_empty" in found.attrs:
            return Key(name, (0, 0), f"empty {dtype}", "other")
        content: Content = "other"
        kind = str(dtype)
        if holds_numbers(dtype):
            content = "numbers"
        elif _is_text(found, dtype) and shape in ((), (1,)):
            content, kind = "text", "text"
        return Key(name, shape, kind, content)

    def _dataset(self, name: str) -> Any:
        parent = self._file
        *groups, last = name.split("/")
        for group in groups:
            parent = hdf5_guard.group(self.path, parent, group)
        return hdf5_guard.dataset(self.path, parent, last, FILTERS)

    def numbers(self, key: Key, pick: Mapping[int, int]) -> np.ndarray:
        """Return the numbers of a key, without the axes that are picked from."""
        found = self._dataset(key.name)
        place = f"'{clean(key.name)[:80]}'"
        check_size(self.path, place, key.shape, found.dtype.itemsize, pick)
        if self.matlab:
            pick = {found.ndim - 1 - axis: index for axis, index in pick.items()}
        if math.prod(key.shape) == 0:
            fail(self.path, f"{place} with at least one element", f"shape {key.shape}")
        if found.chunks is None:
            need, have = found.size * found.dtype.itemsize, found.id.get_storage_size()
            if have < need:
                fail(self.path, f"{need} bytes stored for {place}", f"{have}")
        else:
            self._check_chunks(found, place, pick)
        content = found[tuple(pick.get(axis, slice(None)) for axis in range(found.ndim))]
        content = np.asarray(content)
        return content.transpose() if self.matlab else content

    def _check_chunks(self, found: Any, place: str, pick: Mapping[int, int]) -> None:
        """Raise unless every chunk that will be read is there and inflates to its own size."""
        chunks = found.chunks
        chunk_bytes = math.prod(chunks) * found.dtype.itemsize
        if chunk_bytes > MAX_CHUNK_BYTES:
            fail(
                self.path,
                f"{place} in chunks of at most {MAX_CHUNK_BYTES} bytes",
                f"{chunk_bytes} bytes",
            )
        per_axis = [-(-n // c) for n, c in zip(found.shape, chunks, strict=True)]
        need = math.prod(1 if axis in pick else n for axis, n in enumerate(per_axis))
        rows = {axis: index // chunks[axis] * chunks[axis] for axis, index in pick.items()}
        read: list[Any] = []

        def note(chunk: Any) -> None:
            if all(chunk.chunk_offset[axis] == row for axis, row in rows.items()):
                read.append(chunk)

        found.id.chunk_iter(note)
        if len(read) != need:
            fail(self.path, f"{need} chunks stored for {place}", f"{len(read)}")
        self._check_filters(found, place, chunk_bytes, read)

    def _check_filters(self, found: Any, place: str, chunk_bytes: int, chunks: list[Any]) -> None:
        plan = found.id.get_create_plist()
        filters = [plan.get_filter(i) for i in range(plan.get_nfilters())]
        codes = [entry[0] for entry in filters]
        packing = [code for code in codes if code in (DEFLATE, LZF)]
        if len(set(codes)) != len(codes) or len(packing) > 1:
            fail(self.path, f"{place} with every filter once, and one compression", f"{codes}")
        most = chunk_bytes + _CHECKSUM_BYTES
        if not packing:
            for chunk in chunks:
                if chunk.size > most:
                    fail(self.path, f"chunks of {chunk_bytes} bytes for {place}", f"{chunk.size}")
            return
        at = codes.index(packing[0])
        for chunk in chunks:
            # What does not shrink grows, by a few bytes.
            if chunk.size > min(self._size, 2 * most + 1024):
                fail(
                    self.path, f"chunks of {chunk_bytes} bytes for {place}", f"{chunk.size} stored"
                )
            if chunk.filter_mask >> at & 1:
                continue  # stored as it is
            if packing[0] == LZF:
                _check_lzf(self.path, place, filters[at][2], chunk.size, chunk_bytes)
            else:
                # HDF5's own filter inflates whatever there is, without a bound.
                raw = found.id.read_direct_chunk(chunk.chunk_offset)[1]
                inflate = zlib.decompressobj()
                size = len(inflate.decompress(raw, most + 1))
                if size > most:
                    fail(self.path, f"a chunk of {place} to inflate to {chunk_bytes} bytes", "more")

    def words(self, key: Key) -> str:
        """Return the text of a key."""
        found = self._dataset(key.name)
        if self.matlab:
            if math.prod(key.shape) == 0:
                return ""
            codes = self.numbers(key, {})
            return "".join(map(chr, codes.ravel(order="F").tolist()))
        if found.dtype.kind == "O":
            self._check_variable_text(found, key)
        value = found[()]
        value = value[0] if found.shape == (1,) else value
        return value.decode("utf-8") if isinstance(value, bytes) else str(value)

    def _check_variable_text(self, found: Any, key: Key) -> None:
        """Raise unless the length that stands in the dataset is one that HDF5 may allocate."""
        # The dataset holds the length, and where in the file's heap the text is.
        offset = None if found.chunks is not None else found.id.get_offset()
        if offset is None:
            fail(self.path, f"the text '{clean(key.name)[:80]}' stored in one piece", "chunks")
        self._raw.seek(offset)
        length = int.from_bytes(self._raw.read(4), "little")
        if length > MAX_TEXT_CHARACTERS:
            fail(
                self.path,
                f"at most {MAX_TEXT_CHARACTERS} bytes of text in '{clean(key.name)[:80]}'",
                f"{length}",
            )


def _check_lzf(
    path: Path, place: str, options: tuple[int, ...], size: int, chunk_bytes: int
) -> None:
    # The filter begins with a buffer of the size that its options name, and enlarges it.
    if len(options) > 2 and options[2] > chunk_bytes + _CHECKSUM_BYTES:
        fail(path, f"LZF with chunks of {chunk_bytes} bytes for {place}", f"{options[2]}")
    if size * _LZF_RATIO > 4 * MAX_CHUNK_BYTES:
        limit = 4 * MAX_CHUNK_BYTES // _LZF_RATIO
        fail(path, f"LZF chunks of at most {limit} stored bytes for {place}", f"{size}")


def _matlab_class(found: Any) -> bytes | None:
    """Return the attribute with the MATLAB class of a variable."""
    import h5py

    if "MATLAB_class" not in found.attrs:
        return None
    attribute = found.attrs.get_id("MATLAB_class")
    kind = attribute.get_type()
    # Text of variable length would be allocated as long as the file claims.
    if (
        not isinstance(kind, h5py.h5t.TypeStringID)
        or kind.is_variable_str()
        or kind.get_size() > 256
        or attribute.shape != ()
    ):
        return b"class of unknown form"
    return bytes(np.asarray(found.attrs["MATLAB_class"], dtype="S256")[()])


def _is_text(found: Any, dtype: np.dtype[Any]) -> bool:
    import h5py

    info = h5py.check_string_dtype(dtype)
    return info is not None and (info.length is None or info.length <= MAX_TEXT_CHARACTERS)


def is_matlab(start: bytes) -> bool:
    """Whether an HDF5 file begins with MATLAB's own block."""
    return start.startswith(b"MATLAB")


def list_keys(path: Path) -> dict[str, Any]:
    """Return whether the file is MATLAB's, and of each key its name, shape, kind and content."""
    with _opened(path) as found:
        keys = found.list_keys().values()
        rows = [[key.name, list(key.shape), key.kind, key.content] for key in keys]
        return {"matlab": found.matlab, "keys": rows}


def read_key(path: Path, name: str, pick: list[tuple[int, int]]) -> np.ndarray:
    """Return the numbers of one key; `pick` has axes and the index that is kept of each."""
    with _opened(path) as found:
        return found.numbers(found.key(name), dict(pick))


def read_small_keys(path: Path, places: list[int]) -> dict[str, np.ndarray]:
    """Return the numbers of the keys at some places of the list; what is damaged is left out."""
    result = {}
    with _opened(path) as found:
        keys = list(found.list_keys().values())
        for place in places:
            with suppress(MeasurementError), reading(path, EXPECTED):
                result[keys[place].name] = found.numbers(keys[place], {})
    return result


def read_text(path: Path, name: str) -> str:
    """Return the text of one key."""
    with _opened(path) as found:
        return found.words(found.key(name))


@contextmanager
def _opened(path: Path) -> Iterator[Hdf5Contents]:
    # Once the HDF5 file is open, this process can open nothing more.
    with open(path, "rb") as raw, hdf5_guard.opened(path, EXPECTED) as file:
        yield Hdf5Contents(path, file, raw)
