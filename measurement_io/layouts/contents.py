"""Keys and arrays of another program's file, read in the confined process by numpy, scipy and h5py.

Sizes that a file declares are compared with their limits before its numbers are read.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.confined.process import forbid_opening
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import (
    MAX_ARRAY_BYTES,
    MAX_KEYS,
    MAX_LOADED_BYTES,
    MAX_NESTING,
)
from measurement_io.confined import hdf5_guard
from measurement_io.confined.hdf5_guard import DEFLATE, FLETCHER32, LZF, SHUFFLE
from measurement_io.maroon.frame_file import npy_header

EXPECTED = "an HDF5, MATLAB (v5 or v7.3), .npz or plain .npy file"
NPY_KEY = "array"  # how a layout calls what an `.npy` file holds, which has no name
_FILTERS = (SHUFFLE, FLETCHER32, DEFLATE, LZF)
_SHOWN_BYTES = 2**26
"""A MATLAB v5 file of no more is loaded to list its types, which its headers do not say."""

Pick = Mapping[int, int]
"""Of which axes only one index is kept."""

Opened = tuple[str, bool, "Iterable[Key]"]
"""What kind of file it is, whether one of MATLAB, and its keys."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a file, as a layout names it.

    `kind` is its type as text; `value` reads its numbers, if it has any, in the confined process.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    value: Callable[[Pick], np.ndarray] | None = None

    def __str__(self) -> str:
        return f"{clean(self.name)[:80]} {self.description}"

    @property
    def description(self) -> str:
        """Shape and type as text."""
        shape = "" if self.kind == "text" else f"{self.shape} "
        return f"{shape}{clean(self.kind)[:80]}"


def read(path: Path, form: str, wanted: list[tuple[str, list[tuple[int, int]]]]) -> dict[str, Any]:
    """Return "kind" and "matlab" of a file of a form, its "keys", and "values" of those wanted.

    `wanted` are names, and (axis, index) of axes of which one index is kept. What is not there, has
    no such index, or holds no numbers, is left out.
    """
    with reading(path, EXPECTED), _OPENERS[form](path) as (kind, matlab, listed):
        keys: dict[str, Key] = {}
        for key in listed:
            if key.name in keys:
                fail(path, "every key once", f"two of the name {_place(key.name)}")
            if len(keys) >= MAX_KEYS:
                fail(path, f"at most {MAX_KEYS} keys", "more")
            keys[key.name] = key
        values: dict[str, Any] = {}
        for name, picks in wanted:
            key = keys.get(name.replace(".", "/") if matlab else name, Key("", (), ""))
            pick = {axis: i for axis, i in picks if axis < len(key.shape)}
            inside = all(i < key.shape[axis] for axis, i in pick.items())
            if key.value is not None and inside and key.name not in values:
                with reading(path, f"{_place(key.name)} that can be read"):
                    values[key.name] = key.value(pick)
        rows = [[key.name, list(key.shape), key.kind] for key in keys.values()]
        return {"kind": kind, "matlab": matlab, "keys": rows, "values": values}


def _place(name: str) -> str:
    return f"'{clean(name)[:80]}'"


def _check_size(path: Path, name: str, shape: tuple[int, ...], itemsize: int, pick: Pick) -> None:
    """Raise unless what is kept of an array is small enough, and is something."""
    kept = math.prod(n for axis, n in enumerate(shape) if axis not in pick) * itemsize
    if kept > MAX_ARRAY_BYTES:
        fail(path, f"{_place(name)} to take at most {MAX_ARRAY_BYTES} bytes", f"{kept} bytes")
    if math.prod(shape) == 0:
        fail(path, f"{_place(name)} with at least one element", f"shape {shape}")


def _check_loaded(path: Path, name: str, nbytes: int) -> None:
    if nbytes > MAX_LOADED_BYTES:
        wanted = f"{_place(name)} of at most {MAX_LOADED_BYTES} bytes, as it is loaded whole"
        fail(path, wanted, f"{nbytes} bytes")


def _picked(array: np.ndarray, pick: Pick) -> np.ndarray:
    return np.asarray(array[tuple(pick.get(axis, slice(None)) for axis in range(array.ndim))])


def _holds_numbers(dtype: np.dtype[Any]) -> bool:
    """Whether a dtype is real, complex, or a pair of real fields, possibly a complex number."""
    if dtype.names is not None:
        fields = [dtype[name] for name in dtype.names]
        return len(fields) == 2 and all(f.kind in "iuf" and f.itemsize <= 8 for f in fields)
    most = {"i": 8, "u": 8, "f": 8, "c": 16}
    return dtype.subdtype is None and dtype.itemsize <= most.get(dtype.kind, 0)


# ---- numpy


def _numpy_key(
    path: Path,
    name: str,
    header: tuple[tuple[int, ...], np.dtype[Any]],
    have: int,
    load: Callable[[], np.ndarray],
) -> Key:
    """Return the key of an array of numpy, of which `have` bytes are there."""
    shape, dtype = header
    if dtype.hasobject:
        return Key(name, shape, "object (pickled, never read)")
    need = math.prod(shape) * dtype.itemsize
    if need != have:
        wanted = f"{need} bytes in {_place(name)}, by its header ({clean(dtype)} {shape})"
        fail(path, wanted, f"{have}")

    def value(pick: Pick) -> np.ndarray:
        _check_size(path, name, shape, dtype.itemsize, pick)
        return np.array(_picked(load(), pick))

    kind = "text" if dtype.kind in "SU" else str(dtype)
    return Key(name, shape, kind, value if _holds_numbers(dtype) else None)


@contextmanager
def _opened_npy(path: Path) -> Iterator[Opened]:
    """One plain array, mapped into memory: what is not picked is not read."""
    with open(path, "rb") as file:
        header = npy_header(path, file)
        have = path.stat().st_size - file.tell()
    array: Any = None
    if not header[1].hasobject:
        array = np.load(path, mmap_mode="r" if have else None, allow_pickle=False)
    forbid_opening()
    yield "a plain .npy array", False, [_numpy_key(path, NPY_KEY, header, have, lambda: array)]


@contextmanager
def _opened_npz(path: Path) -> Iterator[Opened]:
    """An archive of arrays; its keys are the members' names without `.npy`."""
    with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        forbid_opening()
        keys = (_member_key(path, archive, entry) for entry in archive.infolist())
        yield "an .npz archive", False, keys


def _member_key(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Key:
    name = entry.filename.removesuffix(".npy")
    if name == entry.filename:
        return Key(name, (), "no .npy array")
    with archive.open(entry) as stream:
        header = npy_header(path, stream)
        have = entry.file_size - stream.tell()

    def load() -> np.ndarray:
        _check_loaded(path, name, have)
        with archive.open(entry) as stream:
            array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
            stream.read(1)  # at the end the archive compares its checksum
        return array

    return _numpy_key(path, name, header, have, load)


# ---- MATLAB v5

_MAT5_BYTES = {
    "double": 8, "single": 4, "int64": 8, "uint64": 8, "int32": 4, "uint32": 4, "int16": 2,
    "uint16": 2, "int8": 1, "uint8": 1, "logical": 1,
}  # fmt: skip
"""Of a number of each class; complex ones have two."""


@contextmanager
def _opened_mat5(path: Path) -> Iterator[Opened]:
    """A MATLAB v5 file by `scipy.io`; inside structs names have "/" between the levels."""
    with open(path, "rb") as file:
        forbid_opening()
        yield "a MATLAB v5 file", True, _mat5_keys(path, file)


def _mat5_keys(path: Path, file: Any) -> Iterator[Key]:
    import scipy.io

    headers = scipy.io.whosmat(file)
    sizes = {name: math.prod(shape) * _MAT5_BYTES.get(kind, 0) for name, shape, kind in headers}
    small = sum(sizes.values()) <= _SHOWN_BYTES
    kinds = ("struct", "char", *(_MAT5_BYTES if small else ()))

    def load(*names: str) -> dict[str, Any]:
        file.seek(0)
        return scipy.io.loadmat(file, variable_names=names)

    at_once = [name for name, _, kind in headers if kind in kinds]
    loaded = load(*at_once) if at_once else {}
    for name, shape, kind in headers:
        if name in loaded:
            yield from _inner_keys(path, name, loaded[name], kind, 0)
        elif kind not in _MAT5_BYTES:
            yield Key(name, shape, kind)
        else:

            def value(pick: Pick, name: str = name, kind: str = kind) -> np.ndarray:
                _check_loaded(path, name, 2 * sizes[name])
                return _mat5_numbers(path, name, load(name)[name], kind, pick)

            yield Key(name, shape, kind, value)


def _inner_keys(path: Path, name: str, value: Any, kind: str, depth: int) -> Iterator[Key]:
    if depth > MAX_NESTING:
        fail(path, f"structs nested at most {MAX_NESTING} deep", "more")
    if not isinstance(value, np.ndarray):
        yield Key(name, (), kind)
        return
    dtype, shape = value.dtype, value.shape
    if dtype.names is not None and shape == (1, 1):
        for field in dtype.names:
            yield from _inner_keys(path, f"{name}/{field}", value[0, 0][field], "", depth + 1)
    elif dtype.kind == "U" and shape in ((), (0,), (1,)):
        yield Key(name, shape, "text")
    elif dtype.kind in "iufcb":
        label = "logical" if dtype.kind == "b" else str(dtype)
        yield Key(name, shape, label, partial(_mat5_numbers, path, name, value, kind))
    else:
        others = {"O": "cell array", "V": "struct array"}
        yield Key(name, shape, others.get(dtype.kind, str(dtype)))


def _mat5_numbers(path: Path, name: str, array: np.ndarray, kind: str, pick: Pick) -> np.ndarray:
    if array.dtype.kind not in "iufcb":
        fail(path, f"numbers in {_place(name)}", clean(array.dtype))
    _check_size(path, name, array.shape, array.dtype.itemsize, pick)
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    elif array.dtype.kind in "iu" and kind in ("double", "single"):
        array = array.astype(kind)  # MATLAB stores whole numbers in fewer bytes
    return _picked(array, pick)


# ---- HDF5, and MATLAB v7.3, which is HDF5 with MATLAB's conventions

_MATLAB_NUMBERS = tuple(name.encode() for name in _MAT5_BYTES if name != "logical")


@contextmanager
def _opened_hdf5(path: Path) -> Iterator[Opened]:
    import h5py

    with open(path, "rb") as raw:
        matlab = raw.read(6) == b"MATLAB"
    with hdf5_guard.opened(path, "a readable HDF5 file") as file:
        keys = _Hdf5(path, matlab).keys(file, "", 0, {h5py.h5o.get_info(file.id).addr})
        yield "a MATLAB v7.3 file" if matlab else "an HDF5 file", matlab, keys


@dataclass(frozen=True, slots=True)
class _Hdf5:
    """Datasets by their path, "group/dataset".

    Of a MATLAB file the axes are in MATLAB's order, which is the reverse of the stored one.
    """

    path: Path
    matlab: bool

    def keys(self, group: Any, prefix: str, depth: int, seen: set[Any]) -> Iterator[Key]:
        import h5py

        if depth > MAX_NESTING:
            fail(self.path, f"groups nested at most {MAX_NESTING} deep", "more")
        for name in islice(group, MAX_KEYS + 1):
            key = f"{prefix}{name}"
            if self.matlab and not prefix and name.startswith("#"):
                continue  # what cells and objects refer to
            link = group.get(name, getlink=True)
            if type(link) is not h5py.HardLink:
                yield Key(key, (), f"a link of kind {type(link).__name__}, not followed")
                continue
            found = group[name]
            if isinstance(found, h5py.Group):
                # A group can be linked to from several places, its own inside among them.
                if (identity := h5py.h5o.get_info(found.id).addr) not in seen:
                    seen.add(identity)
                    yield from self.keys(found, f"{key}/", depth + 1, seen)
            elif isinstance(found, h5py.Dataset):
                yield self._key(key, group, name, found)

    def _key(self, key: str, group: Any, name: str, found: Any) -> Key:
        import h5py

        if found.shape is None:
            return Key(key, (), "empty")
        shape = tuple(int(n) for n in (found.shape[::-1] if self.matlab else found.shape))
        try:
            dtype = found.dtype
        except (TypeError, ValueError) as error:
            return Key(key, shape, clean(error))
        kind = _matlab_class(found) if self.matlab else None
        if kind == b"char" or h5py.check_string_dtype(dtype) is not None:
            return Key(key, shape, "text")
        if kind is not None and kind not in _MATLAB_NUMBERS:
            return Key(key, shape, kind.decode("ascii", "backslashreplace"))
        if kind is not None and "MATLAB_empty" in found.attrs:
            return Key(key, (0, 0), f"empty {dtype}")
        numbers = partial(self._numbers, key, group, name) if _holds_numbers(dtype) else None
        return Key(key, shape, str(dtype), numbers)

    def _numbers(self, key: str, group: Any, name: str, pick: Pick) -> np.ndarray:
        found = hdf5_guard.dataset(self.path, group, name, _FILTERS)
        shape = found.shape[::-1] if self.matlab else found.shape
        _check_size(self.path, key, shape, found.dtype.itemsize, pick)
        if self.matlab:
            pick = {found.ndim - 1 - axis: index for axis, index in pick.items()}
        hdf5_guard.check_stored(self.path, _place(key), found, pick)
        content = np.asarray(found[tuple(pick.get(a, slice(None)) for a in range(found.ndim))])
        return content.transpose() if self.matlab else content


def _matlab_class(found: Any) -> bytes | None:
    """Return the attribute with the MATLAB class of a variable."""
    import h5py

    if "MATLAB_class" not in found.attrs:
        return None
    kind = found.attrs.get_id("MATLAB_class").get_type()
    if not isinstance(kind, h5py.h5t.TypeStringID) or kind.is_variable_str():
        return b"class of unknown form"
    return bytes(np.asarray(found.attrs["MATLAB_class"], dtype="S256").reshape(-1)[0])


_OPENERS: dict[str, Callable[[Path], Any]] = {
    "hdf5": _opened_hdf5,
    "npz": _opened_npz,
    "npy": _opened_npy,
    "mat5": _opened_mat5,
}
