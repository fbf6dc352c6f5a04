"""Load the pickle of a recorded frame without running anything that the file names.

`pickle.Unpickler` asks `find_class` for every name that a pickle holds. Here it gets, for a fixed
list of names, stand-ins of our own that check their arguments; numpy's functions themselves are
never handed out, because `numpy.ndarray(shape, dtype, buffer, offset, strides)` and an array's
`__setstate__` can be made to allocate without bound. Any other name is refused.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from typing import Any, NoReturn

import numpy as np

from clradar.files.failures import clean
from measurement_io.maroon.pickle_scan import UnsafePickle, scan

_MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
_NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")
ALLOWED_NAMES: dict[tuple[str, str], str] = {
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    **{(module, "_reconstruct"): "reconstruct" for module in _MULTIARRAY},
    **{(module, "scalar"): "scalar" for module in _MULTIARRAY},
    # What pickle protocol 5 writes in the place of _reconstruct for contiguous arrays.
    **{(module, "_frombuffer"): "frombuffer" for module in _NUMERIC},
    ("_codecs", "encode"): "encode",
    # A Python complex number has no opcode of its own; protocol 2 spells the module __builtin__.
    ("builtins", "complex"): "complex",
    ("__builtin__", "complex"): "complex",
}
_DTYPE_CODE = re.compile(r"(b1|[iu][1248]|f[248]|c8|c16|[SU][0-9]{1,9})\Z")
_MAX_DIMENSIONS = 32


class PickledArray:
    """An array of the file: `value` is an ndarray, a list of objects, or None if not readable.

    Attributes
    ----------
    value : ndarray or list or None
        Numbers and text as a read-only view of the file's bytes; an object array's items as a list.
    shape : tuple of int
    description : str
        What the file says it is, for messages.
    """

    __hash__ = None  # type: ignore[assignment]
    __slots__ = ("description", "shape", "value")

    def __init__(self) -> None:
        self.value: np.ndarray | list[Any] | None = None
        self.shape: tuple[int, ...] = ()
        self.description = ""

    def fill(self, shape: Any, dtype: Any, raw: Any, order: str, axes: Any = None) -> None:
        if self.description:
            _refuse("an array that is filled twice")
        if not isinstance(dtype, PickledDtype):
            _refuse("an array without a data type")
        self.shape = _shape(shape)
        self.description = f"{dtype.description} {self.shape}"
        count = math.prod(self.shape)
        if isinstance(raw, list):
            if len(raw) != count:
                _refuse(f"an object array of shape {self.shape} with {len(raw)} items")
            self.value = raw
            return
        if dtype.dtype is None:
            return
        need = count * dtype.dtype.itemsize
        if not isinstance(raw, bytes | bytearray) or len(raw) != need:
            have = len(raw) if isinstance(raw, bytes | bytearray) else type(raw).__name__
            _refuse(f"an array {self.description} of {need} bytes with {have} bytes of data")
        flat = np.frombuffer(raw, dtype.dtype) if need else np.empty(0, dtype.dtype)
        if order == "K" and axes is not None:
            value = flat.reshape(self.shape).transpose(_shape(axes))
            self.shape = value.shape
        else:
            value = flat.reshape(self.shape, order="F" if order == "F" else "C")
        value.flags.writeable = False
        self.value = value

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            _refuse("an array with an unknown kind of state")
        _version, shape, dtype, fortran, raw = state
        self.fill(shape, dtype, raw, "F" if fortran is True or fortran == 1 else "C")


class PickledDtype:
    """A data type of the file; `dtype` is None if it is not numbers or text."""

    __hash__ = None  # type: ignore[assignment]
    __slots__ = ("_code", "description", "dtype")

    def __init__(self, code: str) -> None:
        self._code = code
        self.description = clean(code)[:40]
        self.dtype: np.dtype[Any] | None = None
        if code == "O" or re.fullmatch("O[48]", code):
            self.description = "object"
        elif _DTYPE_CODE.match(code):
            self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        # (version, byte order, sub-array, names, fields, item size, alignment, flags, ...)
        if not isinstance(state, tuple) or len(state) < 8:
            _refuse("a data type with an unknown kind of state")
        order = _text(state[1])
        if self.dtype is None:
            return
        if any(part is not None for part in state[2:5]):
            self.dtype = None
            self.description += " (structured)"
        elif isinstance(order, str) and order in ("<", ">", "=", "|"):
            self.dtype = self.dtype.newbyteorder(order)  # type: ignore[arg-type]
        else:
            _refuse("a data type of unknown byte order")


class _StandIn:
    """What `find_class` returns: callable, without attributes that a pickle could set."""

    __slots__ = ()

    def __setstate__(self, state: object) -> None:
        _refuse("a change to one of the allowed functions")

    def __call__(self, *arguments: Any) -> Any:
        _refuse("a call of numpy.ndarray")


class _Dtype(_StandIn):
    __slots__ = ()

    def __call__(self, code: Any = None, *flags: Any) -> PickledDtype:
        code = _text(code)
        if not isinstance(code, str) or len(code) > 40:
            _refuse("a data type that is not given by its code")
        return PickledDtype(code)


class _Reconstruct(_StandIn):
    __slots__ = ()

    def __call__(self, *arguments: Any) -> PickledArray:
        if len(arguments) != 3 or type(arguments[0]) is not _StandIn or arguments[1] != (0,):
            _refuse("_reconstruct of something else than an empty numpy.ndarray")
        return PickledArray()


class _FromBuffer(_StandIn):
    __slots__ = ()

    def __call__(self, *arguments: Any) -> PickledArray:
        if not 4 <= len(arguments) <= 5 or arguments[3] not in ("C", "F", "A", "K"):
            _refuse("_frombuffer with unknown arguments")
        raw, dtype, shape, order, *axes = arguments
        array = PickledArray()
        array.fill(shape, dtype, raw, order, axes[0] if axes else None)
        return array


class _Scalar(_StandIn):
    __slots__ = ()

    def __call__(self, *arguments: Any) -> Any:
        if len(arguments) != 2 or not isinstance(arguments[0], PickledDtype):
            _refuse("a numpy scalar with unknown arguments")
        dtype = arguments[0].dtype
        raw = arguments[1]
        if dtype is None:
            return None
        if not isinstance(raw, bytes) or len(raw) != dtype.itemsize or not raw:
            _refuse(f"a numpy scalar of type {dtype} with the wrong number of bytes")
        return np.frombuffer(raw, dtype)[0]


class _Complex(_StandIn):
    __slots__ = ()

    def __call__(self, *arguments: Any) -> complex:
        if len(arguments) != 2 or not all(isinstance(a, int | float) for a in arguments):
            _refuse("a complex number with unknown arguments")
        return complex(float(arguments[0]), float(arguments[1]))


class _Encode(_StandIn):
    """`_codecs.encode(text, "latin1")`: how protocol 2 spells bytes."""

    __slots__ = ("_left",)

    def __init__(self, budget: int) -> None:
        self._left = budget

    def __call__(self, *arguments: Any) -> bytes:
        if (
            len(arguments) != 2
            or not isinstance(arguments[0], str)
            or arguments[1] not in ("latin1", "latin-1")
        ):
            _refuse("_codecs.encode of something else than latin1 text")
        # One string of the file can be encoded again and again, so the sum is what is limited.
        self._left -= len(arguments[0])
        if self._left < 0:
            _refuse("more bytes through _codecs.encode than the file has")
        return arguments[0].encode("latin1")


class RestrictedUnpickler(pickle.Unpickler):
    """Unpickler that knows the names of `ALLOWED_NAMES` and no others."""

    def __init__(self, data: bytes) -> None:
        # Python 2's strings stay bytes: decoding them here would copy large ones without bound.
        super().__init__(io.BytesIO(data), fix_imports=False, encoding="bytes")
        self._stand_ins: dict[str, _StandIn] = {
            "ndarray": _StandIn(),
            "dtype": _Dtype(),
            "reconstruct": _Reconstruct(),
            "scalar": _Scalar(),
            "frombuffer": _FromBuffer(),
            "encode": _Encode(len(data)),
            "complex": _Complex(),
        }

    def find_class(self, module: str, name: str) -> Any:
        check_name(module, name)
        return self._stand_ins[ALLOWED_NAMES[module, name]]

    def persistent_load(self, pid: Any) -> NoReturn:
        _refuse("a persistent object")


def check_name(module: str, name: str) -> None:
    """Raise `UnsafePickle` unless a recorded frame may ask for this name."""
    if (module, name) in ALLOWED_NAMES:
        return
    asked = f"{clean(module)}.{clean(name)}"
    if module in ("posix", "nt"):
        asked += f" (os.{clean(name)})"
    raise UnsafePickle(f"a pickle that asks for {asked}, which no frame needs; nothing was run")


def load(data: bytes) -> Any:
    """Return what one pickle holds, with arrays and data types as the records of this module.

    Parameters
    ----------
    data : bytes
        The pickle, from its first to its last byte.

    Raises
    ------
    UnsafePickle
        It asks for something that is not allowed, or is damaged.
    Exception
        Whatever `pickle` raises for damaged input; the caller turns it into its own error.
    """
    scan(data, check_name)
    return RestrictedUnpickler(data).load()


def _shape(shape: Any) -> tuple[int, ...]:
    if isinstance(shape, int) and not isinstance(shape, bool):
        shape = (shape,)
    if (
        not isinstance(shape, tuple)
        or len(shape) > _MAX_DIMENSIONS
        or not all(type(n) is int and 0 <= n < 2**40 for n in shape)
    ):
        _refuse("an array whose shape is no tuple of sizes")
    return shape


def _text(value: Any) -> Any:
    # The strings of Python 2 are loaded as bytes: some are text, some the bytes of an array.
    return value.decode("latin1") if isinstance(value, bytes) and len(value) <= 40 else value


def _refuse(what: str) -> NoReturn:
    raise UnsafePickle(what)
