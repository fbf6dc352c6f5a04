"""Read a pickle as plain data: nothing that it names is imported, called or made.

Opcodes are walked here, with a list for a stack and a dictionary for a memo, and build lists,
tuples, dictionaries, numbers, strings, and three records: `Array`, `Sparse` and `Chumpy`. A pickle
can name only what `_MAKERS` lists; any other name, and any other opcode, is refused. Pickles of
Python 2 are read, too, their strings as Latin-1.
"""

from __future__ import annotations

import ast
import io
import math
import pickletools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from clradar.rigs.failures import clean

_DTYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248])\Z")
_OPCODES = {opcode.code: opcode for opcode in pickletools.opcodes}
_MAX_DIMENSIONS = 32
_MAX_OPERATIONS = 5_000_000


class UnsafePickle(Exception):
    """The pickle asks for something that is no plain data; the text says what."""


def _refuse(what: str) -> NoReturn:
    raise UnsafePickle(what)


@dataclass(eq=False)
class _Dtype:
    """A data type: `code` as numpy writes it, with the byte order that the state gives."""

    code: str

    def fill(self, state: Any) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) >= 5 else None
        if order not in ("<", ">", "=", "|") or any(part is not None for part in state[2:5]):
            _refuse("a data type that is no plain number")
        self.code = order + self.code.lstrip("<>=|")

    def numpy(self) -> np.dtype[Any]:
        if not _DTYPE.match(self.code):
            _refuse(f"numbers of type '{clean(self.code)[:20]}'")
        return np.dtype(self.code)


@dataclass(eq=False)
class Array:
    """An array of the file."""

    value: np.ndarray | None = None

    def fill(self, state: Any) -> None:
        if self.value is not None or not isinstance(state, tuple) or len(state) != 5:
            _refuse("an array with an unknown kind of state")
        _version, shape, dtype, fortran, raw = state
        if isinstance(raw, list):  # objects: of no use here, and no harm if nobody asks for them
            return
        self.value = _array(shape, dtype, raw, "F" if fortran else "C")


@dataclass(eq=False)
class Sparse:
    """A matrix of scipy in compressed columns (`csc`) or rows (`csr`)."""

    columns: bool
    state: dict[str, Any] = field(default_factory=dict)

    def fill(self, state: Any) -> None:
        self.state = _attributes(state)

    def dense(self) -> np.ndarray:
        """Return the matrix with its zeros."""
        shape = self.state.get("_shape", self.state.get("shape"))
        parts = [self.state.get(name) for name in ("data", "indices", "indptr")]
        if not isinstance(shape, tuple) or not all(isinstance(p, Array) for p in parts):
            _refuse("a sparse matrix without data, indices, indptr and shape")
        data, indices, starts = (as_array(part) for part in parts)
        shape = _shape(shape)
        major, minor = shape[::-1] if self.columns else shape
        if (
            math.prod(shape) > 10**8
            or starts.shape != (major + 1,)
            or data.ndim != 1
            or data.shape != indices.shape
            or starts[0] != 0
            or starts[-1] > len(data)
            or (np.diff(starts.astype(np.int64)) < 0).any()
            or (len(indices) and not 0 <= indices.min() <= indices.max() < minor)
        ):
            _refuse("a sparse matrix whose parts do not fit together")
        used = int(starts[-1])
        lengths: np.ndarray = np.diff(starts.astype(np.int64))
        outer = np.repeat(np.arange(major), lengths)
        matrix = np.zeros((major, minor))
        np.add.at(matrix, (outer, indices[:used].astype(np.int64)), data[:used])
        return matrix.T if self.columns else matrix


@dataclass(eq=False)
class Chumpy:
    """An object of the package chumpy: `Ch` holds an array `x`; `Select` takes elements of `a`."""

    name: str
    state: dict[str, Any] = field(default_factory=dict)

    def fill(self, state: Any) -> None:
        self.state = _attributes(state)


def as_array(value: Any, depth: int = 0) -> np.ndarray:
    """Return what the file has as an array: dense, sparse, a number, or of chumpy."""
    if depth > 20:
        _refuse("chumpy objects nested without end")
    if isinstance(value, Array):
        if value.value is None:
            _refuse("an array of objects where numbers are needed")
        return value.value
    if isinstance(value, Sparse):
        return value.dense()
    if isinstance(value, Chumpy) and value.name == "Ch":
        return as_array(value.state.get("x"), depth + 1)
    if isinstance(value, Chumpy):
        source, at = (as_array(value.state.get(name), depth + 1) for name in ("a", "idxs"))
        if at.dtype.kind not in "iu" or (at.size and not 0 <= at.min() <= at.max() < source.size):
            _refuse("a chumpy.reordering.Select whose elements do not exist")
        chosen = source.reshape(-1)[at]
        shape = value.state.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(_shape(_sizes(shape)))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return np.asarray(value)
    _refuse(f"{type(value).__name__} where an array is needed")


def _sizes(shape: Any) -> Any:
    if isinstance(shape, Array):
        return tuple(int(n) for n in as_array(shape).reshape(-1))
    return tuple(shape) if isinstance(shape, list) else shape


def _array(shape: Any, dtype: Any, raw: Any, order: Any) -> np.ndarray:
    if isinstance(raw, str):  # a string of Python 2
        raw = raw.encode("latin-1")
    if not isinstance(dtype, _Dtype) or not isinstance(raw, bytes | bytearray):
        _refuse("an array without a data type or data")
    kind, shape = dtype.numpy(), _shape(shape)
    if len(raw) != math.prod(shape) * kind.itemsize:
        _refuse(f"an array {kind} {shape} with {len(raw)} bytes of data")
    return np.frombuffer(raw, kind).reshape(shape, order="F" if order == "F" else "C")


def _shape(shape: Any) -> tuple[int, ...]:
    sizes = (shape,) if type(shape) is int else shape
    if (
        not isinstance(sizes, tuple)
        or len(sizes) > _MAX_DIMENSIONS
        or not all(type(n) is int and 0 <= n < 2**40 for n in sizes)
    ):
        _refuse("a shape that is no tuple of sizes")
    return sizes


def _attributes(state: Any) -> dict[str, Any]:
    if isinstance(state, tuple) and len(state) == 2:  # (dictionary, slots)
        merged = {}
        for part in state:
            merged.update(_attributes(part) if part is not None else {})
        return merged
    if not isinstance(state, dict):
        _refuse("an object whose state is no dictionary")
    return state


# --- what a pickle may name, and what is made instead


@dataclass(frozen=True)
class _Name:
    """A name that the pickle asked for and may have."""

    label: str
    make: Callable[..., Any]


def _reconstruct(*_arguments: Any) -> Array:
    return Array()


def _frombuffer(raw: Any, dtype: Any, shape: Any, order: Any, *axes: Any) -> Array:
    if axes or order not in ("C", "F"):
        _refuse("an array with permuted axes")
    return Array(_array(shape, dtype, raw, order))


def _dtype(code: Any, *_flags: Any) -> _Dtype:
    if not isinstance(code, str):
        _refuse("a data type that is not given by its code")
    return _Dtype(code)


def _scalar(dtype: Any, raw: Any) -> Any:
    return _array((), dtype, raw, "C").item()


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        _refuse("_codecs.encode of something else than latin1 text")
    return text.encode("latin-1")


def _list(items: Any = ()) -> Any:
    if not isinstance(items, list | tuple):
        _refuse("a collection of something else than a list")
    return items


def _pairs(items: Any = None) -> dict[Any, Any]:
    if items is not None:
        _refuse("a dictionary that is not filled item by item")
    return {}


def _reconstructor(name: Any, _base: Any, _state: Any) -> Any:
    if not isinstance(name, _Name):
        _refuse("an object without a class")
    return name.make()


def _no_object(*_arguments: Any) -> NoReturn:
    _refuse("an object without a class of its own")


_MAKERS: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): Array,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): _pairs,
    ("chumpy.ch", "Ch"): lambda *_: Chumpy("Ch"),
    ("chumpy", "Ch"): lambda *_: Chumpy("Ch"),
    ("chumpy.reordering", "Select"): lambda *_: Chumpy("Select"),
}
for _core in ("numpy.core", "numpy._core"):
    _MAKERS[f"{_core}.multiarray", "_reconstruct"] = _reconstruct
    _MAKERS[f"{_core}.multiarray", "scalar"] = _scalar
    _MAKERS[f"{_core}.numeric", "_frombuffer"] = _frombuffer
for _builtins in ("__builtin__", "builtins"):
    _MAKERS[_builtins, "object"] = _no_object
    _MAKERS[_builtins, "dict"] = _pairs
    for _kind in ("set", "frozenset", "list", "tuple"):
        _MAKERS[_builtins, _kind] = _list
for _registry in ("copy_reg", "copyreg"):
    _MAKERS[_registry, "_reconstructor"] = _reconstructor
for _format, _columns in (("csc", True), ("csr", False)):
    for _module in ("scipy.sparse", f"scipy.sparse.{_format}", f"scipy.sparse._{_format}"):
        for _kind in ("matrix", "array"):
            _MAKERS[_module, f"{_format}_{_kind}"] = lambda *_, columns=_columns: Sparse(columns)


def _named(module: Any, name: Any) -> _Name:
    if not isinstance(module, str) or not isinstance(name, str):
        _refuse("a name that is no string")
    label = f"{module}.{name}"
    if (module, name) not in _MAKERS:
        _refuse(f"the name {clean(label)[:100]}, which no hand model needs; nothing was run")
    return _Name(label, _MAKERS[module, name])


# --- the walk


def load(content: bytes) -> Any:
    """Return what one pickle holds.

    Parameters
    ----------
    content : bytes

    Raises
    ------
    UnsafePickle
        A name or an opcode that is not allowed, or a damaged stream.
    Exception
        Whatever a damaged stream makes the parsers of numbers raise.
    """
    return _Machine(content).run()


class _Machine:
    """A pickle's stack and memo. Objects are shared by reference, as in the file, never copied."""

    def __init__(self, content: bytes) -> None:
        self._stream = io.BytesIO(content)
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        # One string can be encoded again and again, so that the sum is what is limited.
        self._left = len(content)

    def run(self) -> Any:
        for _ in range(_MAX_OPERATIONS):
            name, argument = self._next()
            if name == "STOP":
                return self._take()
            getattr(self, f"_{name.lower()}", self._unknown(name))(argument)
        _refuse(f"more than {_MAX_OPERATIONS} operations")

    def _next(self) -> tuple[str, Any]:
        code = self._stream.read(1)
        if not code:
            _refuse("a pickle that is cut short")
        opcode = _OPCODES.get(code.decode("latin-1"))
        if opcode is None:
            _refuse(f"a byte {code!r} that is no pickle operation")
        if opcode.name == "STRING":  # pickletools wants ASCII; arrays of Python 2 are not
            return "STRING", self._quoted()
        return opcode.name, None if opcode.arg is None else opcode.arg.reader(self._stream)

    def _quoted(self) -> str:
        line = self._stream.readline().strip()
        if len(line) < 2 or line[:1] not in b"'\"" or line[-1:] != line[:1]:
            _refuse("a string without quotes")
        return bytes(ast.literal_eval("b" + line.decode("ascii"))).decode("latin-1")

    def _unknown(self, name: str) -> Callable[[Any], NoReturn]:
        return lambda _: _refuse(f"the pickle operation {name}")

    def _take(self) -> Any:
        if len(self._stack) <= (self._marks[-1] if self._marks else 0):
            _refuse("a pickle that takes more than it has")
        return self._stack.pop()

    def _top(self) -> Any:
        value = self._take()
        self._stack.append(value)
        return value

    def _since_mark(self) -> list[Any]:
        if not self._marks:
            _refuse("a pickle without the mark that it goes back to")
        at = self._marks.pop()
        items = self._stack[at:]
        del self._stack[at:]
        return items

    def _push(self, value: Any) -> None:
        self._stack.append(value)

    def _skip(self, _: Any) -> None:
        pass

    _proto = _frame = _skip
    _int = _binint = _binint1 = _binint2 = _long = _long1 = _long4 = _float = _binfloat = _push
    _string = _binstring = _short_binstring = _push
    _unicode = _binunicode = _short_binunicode = _binunicode8 = _push
    _binbytes = _short_binbytes = _binbytes8 = _bytearray8 = _push

    def _none(self, _: Any) -> None:
        self._push(None)

    def _newtrue(self, _: Any) -> None:
        self._push(True)

    def _newfalse(self, _: Any) -> None:
        self._push(False)

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _pop_mark(self, _: Any) -> None:
        self._since_mark()

    def _pop(self, _: Any) -> None:
        # Where a mark is on top, that is what goes.
        if self._marks and self._marks[-1] == len(self._stack):
            self._marks.pop()
        else:
            self._take()

    def _dup(self, _: Any) -> None:
        self._push(self._top())

    def _get(self, slot: Any) -> None:
        if slot not in self._memo:
            _refuse(f"memo entry {slot}, which was never stored")
        self._push(self._memo[slot])

    _binget = _long_binget = _get

    def _put(self, slot: Any) -> None:
        self._memo[slot] = self._top()

    _binput = _long_binput = _put

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._top()

    # Sets become lists: a set's items would have to be hashed, and nobody asks for them.
    def _empty_list(self, _: Any) -> None:
        self._push([])

    _empty_set = _empty_list

    def _list(self, _: Any) -> None:
        self._push(self._since_mark())

    _frozenset = _list

    def _append(self, _: Any) -> None:
        self._extend([self._take()])

    def _appends(self, _: Any) -> None:
        self._extend(self._since_mark())

    _additems = _appends

    def _extend(self, items: list[Any]) -> None:
        target = self._top()
        if not isinstance(target, list):
            _refuse("items for something that is no list")
        target += items

    def _empty_tuple(self, _: Any) -> None:
        self._push(())

    def _tuple(self, _: Any) -> None:
        self._push(tuple(self._since_mark()))

    def _tuple1(self, _: Any) -> None:
        self._push((self._take(),))

    def _tuple2(self, _: Any) -> None:
        last = self._take()
        self._push((self._take(), last))

    def _tuple3(self, _: Any) -> None:
        last, middle = self._take(), self._take()
        self._push((self._take(), middle, last))

    def _empty_dict(self, _: Any) -> None:
        self._push({})

    def _dict(self, _: Any) -> None:
        items = self._since_mark()
        self._push({})
        self._fill(items)

    def _setitem(self, _: Any) -> None:
        value = self._take()
        self._fill([self._take(), value])

    def _setitems(self, _: Any) -> None:
        self._fill(self._since_mark())

    def _fill(self, items: list[Any]) -> None:
        target = self._top()
        if not isinstance(target, dict) or len(items) % 2:
            _refuse("items for something that is no dictionary")
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str | int):
                _refuse("a dictionary's key that is no string or number")
            target[key] = value

    def _global(self, argument: Any) -> None:
        self._push(_named(*str(argument).split(" ", 1)))

    def _stack_global(self, _: Any) -> None:
        name = self._take()
        self._push(_named(self._take(), name))

    def _reduce(self, _: Any) -> None:
        arguments = self._take()
        self._make(self._take(), arguments)

    _newobj = _reduce

    def _newobj_ex(self, _: Any) -> None:
        _keywords, arguments = self._take(), self._take()
        self._make(self._take(), arguments)

    def _obj(self, _: Any) -> None:
        name, *arguments = self._since_mark() or [None]
        self._make(name, tuple(arguments))

    def _inst(self, argument: Any) -> None:
        self._make(_named(*str(argument).split(" ", 1)), tuple(self._since_mark()))

    def _make(self, name: Any, arguments: Any) -> None:
        if not isinstance(name, _Name) or not isinstance(arguments, tuple):
            _refuse("a call of something that has no name")
        if name.make is _encode and arguments and isinstance(arguments[0], str):
            self._left -= len(arguments[0])
            if self._left < 0:
                _refuse("more bytes through _codecs.encode than the file has")
        try:
            self._push(name.make(*arguments))
        except TypeError:
            _refuse(f"{name.label} with {len(arguments)} arguments")

    def _build(self, _: Any) -> None:
        state, target = self._take(), self._top()
        if not isinstance(target, Array | Sparse | Chumpy | _Dtype):
            _refuse("a state for something that has none")
        target.fill(state)
