"""Keys and arrays of another program's file, read in the confined process by numpy, scipy and h5py.

Sizes that a file declares are compared with their limits before its numbers are read.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.confined.process import forbid_opening
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import (
    MAX_ARRAY_BYTES,
    MAX_CHUNK_BYTES,
    MAX_KEYS,
    MAX_LOADED_BYTES,
    MAX_NESTING,
    MAX_TEXT_CHARACTERS,
)
from measurement_io.confined import hdf5_guard
from measurement_io.confined.hdf5_guard import DEFLATE, FLETCHER32, LZF, SHUFFLE
from measurement_io.maroon.frame_file import npy_header

EXPECTED = "an HDF5, MATLAB (v5 or v7.3), .npz or plain .npy file"
NPY_KEY = "array"
"""How a layout calls what an `.npy` file holds, which has no name."""

_FILTERS = (SHUFFLE, FLETCHER32, DEFLATE, LZF)
_SHOWN_BYTES = 2**26
"""A MATLAB v5 file of no more is loaded to list its types, which its headers do not say."""

Key = tuple[str, tuple[int, ...], str, str]
"""Name, shape, type in words, and what can be read: "numbers", "text" or "other"."""

Pick = Mapping[int, int]


class _Opened(Protocol):
    """An opened file."""

    kind: str
    matlab: bool

    def keys(self) -> Iterator[Key]: ...

    def value(self, key: Key, pick: Pick) -> Any: ...


def read(path: Path, form: str, wanted: list[tuple[str, list[tuple[int, int]]]]) -> dict[str, Any]:
    """Return "kind" and "matlab" of a file of a form, its "keys", and "values" of those wanted.

    `wanted` are names, and (axis, index) of axes of which one index is kept. A value is {"value":
    array or text} or {"error": text}; what is not there, or holds neither, is left out.
    """
    with reading(path, EXPECTED), _OPENERS[form](path) as opened:
        keys: dict[str, Key] = {}
        for key in opened.keys():  # noqa: SIM118 - a method that lists them
            if key[0] in keys:
                fail(path, "every key once", f"two of the name '{clean(key[0])[:80]}'")
            if len(keys) >= MAX_KEYS:
                fail(path, f"at most {MAX_KEYS} keys", "more")
            keys[key[0]] = key
        values: dict[str, Any] = {}
        for given, picks in wanted:
            name = given.replace(".", "/") if opened.matlab else given
            if name in values or name not in keys or keys[name][3] == "other":
                continue
            shape = keys[name][1]
            pick = {axis: i for axis, i in picks if axis < len(shape)}
            try:
                with reading(path, f"'{clean(name)[:80]}' that can be read"):
                    if any(i >= shape[axis] for axis, i in pick.items()):
                        fail(path, f"'{clean(name)[:80]}' with such an index", f"shape {shape}")
                    values[name] = {"value": opened.value(keys[name], pick)}
            except MeasurementError as error:
                values[name] = {"error": str(error)}
        rows = [[name, list(shape), kind, content] for name, shape, kind, content in keys.values()]
        return {"kind": opened.kind, "matlab": opened.matlab, "keys": rows, "values": values}


def _check_size(path: Path, name: str, shape: tuple[int, ...], itemsize: int, pick: Pick) -> None:
    """Raise unless an array is small enough to be read whole, and what is kept of it is."""
    place = f"'{clean(name)[:80]}'"
    kept = math.prod(n for axis, n in enumerate(shape) if axis not in pick) * itemsize
    if kept > MAX_ARRAY_BYTES:
        fail(path, f"{place} to take at most {MAX_ARRAY_BYTES} bytes", f"{kept} bytes")
    if math.prod(shape) == 0:
        fail(path, f"{place} with at least one element", f"shape {shape}")


def _picked(array: np.ndarray, pick: Pick) -> np.ndarray:
    return np.asarray(array[tuple(pick.get(axis, slice(None)) for axis in range(array.ndim))])


def _described(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Key:
    """Return the key of an array of numpy: numbers, one text, or nothing that is read."""
    if dtype.hasobject:
        return name, shape, "object (pickled, never read)", "other"
    if dtype.kind in "SU" and shape in ((), (1,)) and dtype.itemsize <= 4 * MAX_TEXT_CHARACTERS:
        return name, shape, "text", "text"
    return name, shape, str(dtype), "numbers" if _holds_numbers(dtype) else "other"


def _holds_numbers(dtype: np.dtype[Any]) -> bool:
    """Whether a dtype is real, complex, or a pair of real fields, possibly a complex number."""
    if dtype.names is not None:
        fields = [dtype[name] for name in dtype.names]
        return len(fields) == 2 and all(f.kind in "iuf" and f.itemsize <= 8 for f in fields)
    most = {"i": 8, "u": 8, "f": 8, "c": 16}
    return dtype.subdtype is None and dtype.itemsize <= most.get(dtype.kind, 0)


def _text(value: Any) -> str:
    value = np.asarray(value).reshape(-1)[0]
    return value.decode("utf-8") if isinstance(value, bytes) else str(value)


# ---- numpy


class _Npy:
    """One plain array, mapped into memory: what is not picked is not read."""

    kind, matlab = "a plain .npy array", False

    def __init__(self, path: Path, array: np.ndarray) -> None:
        self._path, self._array = path, array

    def keys(self) -> Iterator[Key]:
        yield _described(NPY_KEY, self._array.shape, self._array.dtype)

    def value(self, key: Key, pick: Pick) -> Any:
        if key[3] == "text":
            return _text(self._array)
        _check_size(self._path, NPY_KEY, self._array.shape, self._array.dtype.itemsize, pick)
        return np.array(_picked(self._array, pick))


@contextmanager
def _opened_npy(path: Path) -> Iterator[_Npy]:
    with open(path, "rb") as file:
        shape, _, dtype = npy_header(path, file)
        have = path.stat().st_size - file.tell()
    need = math.prod(shape) * dtype.itemsize
    if not dtype.hasobject and need != have:
        fail(path, f"{need} bytes of numbers, by its header ({clean(dtype)} {shape})", f"{have}")
    array = np.load(path, mmap_mode="r" if need else None, allow_pickle=False)
    forbid_opening()
    yield _Npy(path, array)


class _Npz:
    """An archive of arrays; its keys are the members' names without `.npy`."""

    kind, matlab = "an .npz archive", False

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._dtypes: dict[str, np.dtype[Any]] = {}

    def keys(self) -> Iterator[Key]:
        for entry in self._archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if name == entry.filename:
                yield name, (), "no .npy array", "other"
                continue
            with self._archive.open(entry) as stream:
                shape, _, dtype = npy_header(self._path, stream)
                have = entry.file_size - stream.tell()
            need = math.prod(shape) * dtype.itemsize
            if not dtype.hasobject and need != have:
                wanted = f"{need} bytes in '{clean(name)[:80]}', by its header"
                fail(self._path, wanted, f"{have}")
            self._dtypes[name] = dtype
            yield _described(name, shape, dtype)

    def value(self, key: Key, pick: Pick) -> Any:
        name, shape, _, content = key
        _check_size(self._path, name, shape, self._dtypes[name].itemsize, pick)
        _check_loaded(self._path, name, math.prod(shape) * self._dtypes[name].itemsize)
        with self._archive.open(f"{name}.npy") as stream:
            array = np.lib.format.read_array(stream, allow_pickle=False)
            stream.read(1)  # at the end the archive compares its checksum
        return _text(array) if content == "text" else _picked(array, pick)


def _check_loaded(path: Path, name: str, nbytes: int) -> None:
    if nbytes > MAX_LOADED_BYTES:
        place = f"'{clean(name)[:80]}'"
        wanted = f"{place} of at most {MAX_LOADED_BYTES} bytes, as it is loaded whole"
        fail(path, wanted, f"{nbytes} bytes")


@contextmanager
def _opened_npz(path: Path) -> Iterator[_Npz]:
    with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        forbid_opening()
        yield _Npz(path, archive)


# ---- MATLAB v5

_MAT5_BYTES = {
    "double": 8, "single": 4, "int64": 8, "uint64": 8, "int32": 4, "uint32": 4, "int16": 2,
    "uint16": 2, "int8": 1, "uint8": 1, "logical": 1,
}  # fmt: skip
"""Of a number of each class; complex ones have two."""


class _Mat5:
    """A MATLAB v5 file by `scipy.io`; inside structs names have "/" between the levels."""

    kind, matlab = "a MATLAB v5 file", True

    def __init__(self, path: Path, file: Any) -> None:
        import scipy.io

        self._path, self._file = path, file
        self._headers = {name: (shape, kind) for name, shape, kind in scipy.io.whosmat(file)}
        plain = {n: math.prod(s) * _MAT5_BYTES.get(k, 0) for n, (s, k) in self._headers.items()}
        self._bytes = plain
        self._loaded: dict[str, Any] = {}
        small = sum(plain.values()) <= _SHOWN_BYTES
        kinds = ("struct", "char", *(_MAT5_BYTES if small else ()))
        self._load([name for name, (_, kind) in self._headers.items() if kind in kinds])

    def _load(self, names: list[str]) -> None:
        import scipy.io

        if names:
            self._file.seek(0)
            self._loaded |= scipy.io.loadmat(self._file, variable_names=names)

    def keys(self) -> Iterator[Key]:
        for name, (shape, kind) in self._headers.items():
            if name in self._loaded:
                yield from self._inner(name, self._loaded[name], kind, 0)
            else:
                yield name, shape, kind, "numbers" if kind in _MAT5_BYTES else "other"

    def _inner(self, name: str, value: Any, kind: str, depth: int) -> Iterator[Key]:
        if depth > MAX_NESTING:
            fail(self._path, f"structs nested at most {MAX_NESTING} deep", "more")
        if not isinstance(value, np.ndarray):
            yield name, (), kind, "other"
        elif value.dtype.names is not None and value.shape == (1, 1):
            for field in value.dtype.names:
                yield from self._inner(f"{name}/{field}", value[0, 0][field], "", depth + 1)
        elif value.dtype.kind == "U":
            yield _described(name, value.shape, value.dtype)
        elif value.dtype.kind == "b":
            yield name, value.shape, "logical", "numbers"
        else:
            words = {"O": "cell array", "V": "struct array"}.get(value.dtype.kind)
            key = _described(name, value.shape, value.dtype)
            yield key if words is None else (name, value.shape, words, "other")

    def value(self, key: Key, pick: Pick) -> Any:
        first, *inner = key[0].split("/")
        if first not in self._loaded:
            _check_loaded(self._path, first, 2 * self._bytes[first])
            self._load([first])
        found = self._loaded[first]
        for field in inner:
            found = found[0, 0][field]
        if key[3] == "text":
            return _text(found) if found.size else ""
        if found.dtype.kind not in "iufcb":
            fail(self._path, f"numbers in '{clean(key[0])[:80]}'", clean(found.dtype))
        _check_size(self._path, key[0], found.shape, found.dtype.itemsize, pick)
        kind = self._headers[first][1]
        if found.dtype.kind == "b":
            found = found.astype(np.uint8)
        elif not inner and found.dtype.kind in "iu" and kind in ("double", "single"):
            found = found.astype(kind)  # MATLAB stores whole numbers in fewer bytes
        return _picked(found, pick)


@contextmanager
def _opened_mat5(path: Path) -> Iterator[_Mat5]:
    with open(path, "rb") as file:
        forbid_opening()
        yield _Mat5(path, file)


# ---- HDF5, and MATLAB v7.3, which is HDF5 with MATLAB's conventions

_MATLAB_NUMBERS = (
    b"double", b"single", b"int8", b"uint8", b"int16", b"uint16", b"int32", b"uint32", b"int64",
    b"uint64",
)  # fmt: skip


class _Hdf5:
    """Datasets by their path, "group/dataset".

    Of a MATLAB file the axes are in MATLAB's order, which is the reverse of the stored one.
    """

    def __init__(self, path: Path, file: Any, matlab: bool) -> None:
        self._path, self._file, self.matlab = path, file, matlab
        self.kind = "a MATLAB v7.3 file" if matlab else "an HDF5 file"

    def keys(self) -> Iterator[Key]:
        import h5py

        return self._walk(self._file, "", 0, {h5py.h5o.get_info(self._file.id).addr})

    def _walk(self, group: Any, prefix: str, depth: int, seen: set[Any]) -> Iterator[Key]:
        import h5py

        if depth > MAX_NESTING:
            fail(self._path, f"groups nested at most {MAX_NESTING} deep", "more")
        for name in islice(group, MAX_KEYS + 1):
            key = f"{prefix}{name}"
            if self.matlab and not prefix and name.startswith("#"):
                continue  # what cells and objects refer to
            link = group.get(name, getlink=True)
            if type(link) is not h5py.HardLink:
                yield key, (), f"a link of kind {type(link).__name__}, not followed", "other"
                continue
            found = group[name]
            if isinstance(found, h5py.Group):
                # A group can be linked to from several places, its own inside among them.
                if (identity := h5py.h5o.get_info(found.id).addr) not in seen:
                    seen.add(identity)
                    yield from self._walk(found, f"{key}/", depth + 1, seen)
            elif isinstance(found, h5py.Dataset):
                yield self._key(key, found)

    def _key(self, name: str, found: Any) -> Key:
        shape = found.shape
        if shape is None:
            return name, (), "empty", "other"
        shape = tuple(int(n) for n in (shape[::-1] if self.matlab else shape))
        try:
            dtype = found.dtype
        except (TypeError, ValueError) as error:
            return name, shape, clean(error), "other"
        if self.matlab and (matlab_class := _matlab_class(found)) is not None:
            if matlab_class == b"char":
                is_text = dtype.kind == "u" and math.prod(shape) <= MAX_TEXT_CHARACTERS
                return name, shape, "text", "text" if is_text else "other"
            if matlab_class not in _MATLAB_NUMBERS:
                return name, shape, matlab_class.decode("ascii", "backslashreplace"), "other"
            if "MATLAB_empty" in found.attrs:
                return name, (0, 0), f"empty {dtype}", "other"
        if _holds_numbers(dtype):
            return name, shape, str(dtype), "numbers"
        is_text = _is_text(dtype) and shape in ((), (1,))
        return name, shape, "text" if is_text else str(dtype), "text" if is_text else "other"

    def value(self, key: Key, pick: Pick) -> Any:
        parent, (*groups, last) = self._file, key[0].split("/")
        for group in groups:
            parent = hdf5_guard.group(self._path, parent, group)
        found = hdf5_guard.dataset(self._path, parent, last, _FILTERS)
        if key[3] == "text" and not self.matlab:
            return _text(found[()])
        if key[3] == "text" and not found.size:
            return ""
        _check_size(self._path, key[0], key[1], found.dtype.itemsize, pick)
        if self.matlab:
            pick = {found.ndim - 1 - axis: index for axis, index in pick.items()}
        self._check_stored(key[0], found, pick)
        content = np.asarray(found[tuple(pick.get(a, slice(None)) for a in range(found.ndim))])
        content = content.transpose() if self.matlab else content
        if key[3] == "text":
            return "".join(map(chr, content.ravel(order="F").tolist()))
        return content

    def _check_stored(self, name: str, found: Any, pick: Pick) -> None:
        """Raise unless all that will be read is in the file: HDF5 would fill in the rest."""
        place = f"'{clean(name)[:80]}'"
        if found.chunks is None:
            need, have = found.size * found.dtype.itemsize, found.id.get_storage_size()
            if have < need:
                fail(self._path, f"{need} bytes stored for {place}", f"{have}")
            return
        chunk_bytes = math.prod(found.chunks) * found.dtype.itemsize
        if chunk_bytes > MAX_CHUNK_BYTES:
            expected = f"{place} in chunks of at most {MAX_CHUNK_BYTES} bytes"
            fail(self._path, expected, f"{chunk_bytes} bytes")
        rows = {a: index // found.chunks[a] * found.chunks[a] for a, index in pick.items()}
        per_axis = [-(-n // c) for n, c in zip(found.shape, found.chunks, strict=True)]
        need = math.prod(1 if axis in pick else n for axis, n in enumerate(per_axis))
        have = 0

        def count(chunk: Any) -> None:
            nonlocal have
            have += all(chunk.chunk_offset[axis] == row for axis, row in rows.items())

        found.id.chunk_iter(count)
        if have != need:
            fail(self._path, f"{need} chunks stored for {place}", f"{have}")


def _matlab_class(found: Any) -> bytes | None:
    """Return the attribute with the MATLAB class of a variable."""
    import h5py

    if "MATLAB_class" not in found.attrs:
        return None
    kind = found.attrs.get_id("MATLAB_class").get_type()
    if not isinstance(kind, h5py.h5t.TypeStringID) or kind.is_variable_str():
        return b"class of unknown form"
    return bytes(np.asarray(found.attrs["MATLAB_class"], dtype="S256").reshape(-1)[0])


def _is_text(dtype: np.dtype[Any]) -> bool:
    import h5py

    info = h5py.check_string_dtype(dtype)
    return info is not None and (info.length is None or info.length <= MAX_TEXT_CHARACTERS)


@contextmanager
def _opened_hdf5(path: Path) -> Iterator[_Hdf5]:
    with open(path, "rb") as raw:
        matlab = raw.read(6) == b"MATLAB"
    with hdf5_guard.opened(path, "a readable HDF5 file") as file:
        yield _Hdf5(path, file, matlab)


_OPENERS: dict[str, Callable[[Path], Any]] = {
    "hdf5": _opened_hdf5,
    "npz": _opened_npz,
    "npy": _opened_npy,
    "mat5": _opened_mat5,
}
