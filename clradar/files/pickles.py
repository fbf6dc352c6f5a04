"""Pickles of arrays, read in a confined process by `pickle.Unpickler` with a list of exact names.

A name of the list stands for a class of this module, or of the caller: nothing that a pickle names
is imported, and neither numpy nor another package restores a state. What is loaded are lists,
tuples, dictionaries, numbers, strings and `PickledArray`.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from clradar.files.failures import clean
from clradar.files.limits import MAX_DIMENSIONS, MAX_PICKLE_OPERATIONS

_DTYPE_CODE = re.compile(r"[<>=|]?(b1|[iu][1248]|f[248]|c8|c16|[SU][0-9]{1,9})\Z")
_OPERATIONS = {operation.code: operation for operation in pickletools.opcodes}
_MEMO = ("PUT", "BINPUT", "LONG_BINPUT")
_FORBIDDEN = ("EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID", "NEXT_BUFFER", "READONLY_BUFFER")


class UnsafePickle(Exception):
    """The pickle is damaged, or holds more than plain data; the text is the reason."""


def refuse(what: str) -> NoReturn:
    """Raise `UnsafePickle`."""
    raise UnsafePickle(f"a pickle with {what}")


class Fixed(type):
    """Of the classes that stand for names: a pickle can set no attribute of them."""

    def __setattr__(cls, name: str, value: Any) -> None:
        refuse("a state for a class")


class PickledDtype(metaclass=Fixed):
    """`numpy.dtype`; `dtype` is None unless it is plain numbers or text."""

    __slots__ = ("code", "dtype")

    def __init__(self, code: Any = None, *_flags: Any) -> None:
        if not isinstance(code, str) or len(code) > 40:
            refuse("a data type that is not given by its code")
        self.code = clean(code)
        self.dtype = np.dtype(code) if _DTYPE_CODE.match(code) else None

    def __setstate__(self, state: Any) -> None:
        # (version, byte order, sub-array, names, fields, item size, alignment, flags, ...)
        if not isinstance(state, tuple) or len(state) < 8:
            refuse("a data type with an unknown kind of state")
        if any(part is not None for part in state[2:5]):
            self.dtype = None
        if self.dtype is None:
            return
        if state[1] not in ("<", ">", "=", "|"):
            refuse("a data type of unknown byte order")
        self.dtype = self.dtype.newbyteorder(state[1])


class PickledArray(metaclass=Fixed):
    """An array of the file: numbers and text, read-only, or the items of an object array.

    None if it is of other types, or was never filled.
    """

    __slots__ = ("shape", "value")

    def __init__(self) -> None:
        self.value: np.ndarray | list[Any] | None = None
        self.shape: tuple[int, ...] = ()

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            refuse("an array with an unknown kind of state")
        _version, shape, dtype, fortran, raw = state
        self.fill(shape, dtype, raw, "F" if fortran is True or fortran == 1 else "C")

    def fill(self, shape: Any, dtype: Any, raw: Any, order: str, axes: Any = None) -> PickledArray:
        if not isinstance(dtype, PickledDtype):
            refuse("an array without a data type")
        self.shape = array_shape(shape)
        what = f"{dtype.code} {self.shape}"
        count = math.prod(self.shape)
        if isinstance(raw, list):
            if len(raw) != count:
                refuse(f"an object array of shape {self.shape} with {len(raw)} items")
            self.value = raw
            return self
        if dtype.dtype is None:
            return self
        if isinstance(raw, str):  # of Python 2
            raw = raw.encode("latin-1")
        need = count * dtype.dtype.itemsize
        if not isinstance(raw, bytes | bytearray) or len(raw) != need:
            have = len(raw) if isinstance(raw, bytes | bytearray) else type(raw).__name__
            refuse(f"an array {what} of {need} bytes with {have} bytes of data")
        flat = np.frombuffer(raw, dtype.dtype) if need else np.empty(0, dtype.dtype)
        flat = flat.reshape(self.shape, order="F" if order == "F" else "C")
        self.value = flat if order != "K" or axes is None else flat.transpose(array_shape(axes))
        self.shape = self.value.shape
        return self


def array_shape(shape: Any) -> tuple[int, ...]:
    """Return a tuple of sizes, or refuse."""
    sizes = (shape,) if type(shape) is int else shape
    if (
        not isinstance(sizes, tuple)
        or len(sizes) > MAX_DIMENSIONS
        or not all(type(n) is int and 0 <= n < 2**40 for n in sizes)
    ):
        refuse("an array whose shape is no tuple of sizes")
    return sizes


class _Ndarray(metaclass=Fixed):
    """`numpy.ndarray`, which `_reconstruct` is given and nobody calls."""

    def __init__(self, *_arguments: Any) -> None:
        refuse("a call of numpy.ndarray")


class _Reconstruct(metaclass=Fixed):
    def __new__(cls, kind: Any = None, shape: Any = None, code: Any = None) -> Any:
        if kind is not _Ndarray or shape != (0,):
            refuse("_reconstruct of something else than an empty numpy.ndarray")
        return PickledArray()


class _FromBuffer(metaclass=Fixed):
    def __new__(cls, raw: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> Any:
        if order not in ("C", "F", "A", "K"):
            refuse("_frombuffer with unknown arguments")
        return PickledArray().fill(shape, dtype, raw, order, axes)


class _Scalar(metaclass=Fixed):
    def __new__(cls, dtype: Any, raw: Any) -> Any:
        return PickledArray().fill((), dtype, raw, "C")


class _Encode(metaclass=Fixed):
    """`_codecs.encode`: protocol 2 has no operation for bytes."""

    def __new__(cls, text: Any, encoding: Any) -> Any:
        if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
            refuse("_codecs.encode of something else than latin1 text")
        return text.encode("latin-1")


Names = Mapping[tuple[str, str], type]
"""(module, name) as a pickle writes it -> the class that stands for it."""

_CORES = ("numpy.core", "numpy._core")
ARRAYS: Names = {
    ("numpy", "ndarray"): _Ndarray,
    ("numpy", "dtype"): PickledDtype,
    **{(f"{core}.multiarray", "_reconstruct"): _Reconstruct for core in _CORES},
    **{(f"{core}.multiarray", "scalar"): _Scalar for core in _CORES},
    # What protocol 5 writes in the place of _reconstruct for contiguous arrays.
    **{(f"{core}.numeric", "_frombuffer"): _FromBuffer for core in _CORES},
    ("_codecs", "encode"): _Encode,
    ("builtins", "complex"): complex,
    ("__builtin__", "complex"): complex,
}
"""What a dictionary of arrays, numbers and strings needs, by numpy before and since 2.0."""


class _Unpickler(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, names: Names, kind: str) -> None:
        super().__init__(stream, encoding="latin1")
        self._names, self._kind = names, kind

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._names:
            label = f"{clean(module)}.{clean(name)}"
            if module in ("posix", "nt"):
                label += f" (os.{clean(name)})"
            refuse(f"the name {label}, which no {self._kind} needs; nothing was run")
        return self._names[module, name]


def load(content: bytes, names: Names, kind: str, offset: int = 0) -> Any:
    """Return the value of the one pickle that reaches from `offset` to the end."""
    stream = io.BytesIO(content)
    stream.seek(offset)
    _check(stream, kind)
    rest = len(content) - stream.tell()
    if rest:
        refuse(f"{rest} bytes after the end")
    stream.seek(offset)
    return _Unpickler(stream, names, kind).load()


def _check(stream: io.BytesIO, kind: str) -> None:
    """Refuse lengths and places that the file does not back: the unpickler allocates them first."""
    for _ in range(MAX_PICKLE_OPERATIONS):
        code = stream.read(1)
        if not code:
            refuse("no end: it is cut short")
        operation = _OPERATIONS.get(code.decode("latin-1"))
        if operation is None:
            refuse(f"a byte {code!r} that is no operation")
        name, value = operation.name, 0
        if name in _FORBIDDEN:
            refuse(f"the operation {name}, which no {kind} needs")
        if name == "STRING":  # of Python 2, not ASCII as pickletools wants it
            stream.readline()
        elif operation.arg is not None:
            value = operation.arg.reader(stream)
        if name in _MEMO and not 0 <= value < MAX_PICKLE_OPERATIONS:
            refuse(f"memo entry {value}, which is too many")
        if name == "STOP":
            return
    refuse(f"more than {MAX_PICKLE_OPERATIONS} operations")
