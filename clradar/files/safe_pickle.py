"""Read a pickle as plain data: nothing that it names is imported, called or made.

A stack machine for the operations of pickle protocols 0 to 5 (PEP 307, 3154, 574), in Python,
with a list for a stack and a dictionary for a memo. It builds lists, tuples, dictionaries, numbers,
strings and `PickledArray`. A pickle can name only what the caller lists, and each name selects
a function of this module that checks its arguments; any other name or operation is refused.
Sets become lists, entries of dictionaries with other keys than strings and numbers are left out,
and strings of Python 2 stay bytes.
"""

from __future__ import annotations

import ast
import io
import math
import pickletools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from clradar.files.failures import clean
from clradar.files.limits import MAX_DIMENSIONS, MAX_PICKLE_OPERATIONS

Makers = Mapping[tuple[str, str], Callable[..., Any]]
"""(module, name) as a pickle writes it -> the function that its arguments are passed to."""

_DTYPE_CODE = re.compile(r"(b1|[iu][1248]|f[248]|c8|c16|[SU][0-9]{1,9})\Z")
_LATIN_1 = ("latin1", "latin-1")


class UnsafePickle(Exception):
    """The pickle is damaged, or holds more than plain data; the text is the reason."""


def refuse(what: str) -> NoReturn:
    """Raise `UnsafePickle`."""
    raise UnsafePickle(f"a pickle with {what}")


def load(content: bytes, makers: Makers, kind: str, offset: int = 0) -> Any:
    """Return the value of the one pickle that reaches from `offset` to the end.

    Parameters
    ----------
    content : bytes
    makers : mapping
        The names that it may use: `ARRAYS` and others.
    kind : str
        What needs no other names, for the message: "frame".
    offset : int

    Raises
    ------
    UnsafePickle
        A name or an operation that is not allowed, or a damaged stream.
    Exception
        Whatever a damaged stream makes the parsers of numbers raise.
    """
    return _Machine(content, makers, kind, offset).run()


class Stateful:
    """Something of the file that takes a state, which `BUILD` gives it."""

    def fill(self, state: Any) -> None:
        raise NotImplementedError


# ---- arrays


@dataclass(eq=False)
class PickledDtype(Stateful):
    """A data type of the file; `dtype` is None unless it is plain numbers or text."""

    code: str

    def __post_init__(self) -> None:
        self.description = clean(self.code)
        plain = _DTYPE_CODE.match(self.code.lstrip("<>=|"))
        self.dtype = np.dtype(self.code) if plain else None

    def fill(self, state: Any) -> None:
        # (version, byte order, sub-array, names, fields, item size, alignment, flags, ...)
        if not isinstance(state, tuple) or len(state) < 8:
            refuse("a data type with an unknown kind of state")
        if self.dtype is None:
            return
        if any(part is not None for part in state[2:5]):
            self.dtype = None
            return
        order = text_of(state[1])
        if order not in ("<", ">", "=", "|"):
            refuse("a data type of unknown byte order")
        self.dtype = self.dtype.newbyteorder(order)


@dataclass(eq=False)
class PickledArray(Stateful):
    """An array of the file.

    Attributes
    ----------
    value : ndarray or list or None
        Numbers and text, read-only; the items of an object array; None if it is of other types.
    shape : tuple of int
    description : str
        Data type and shape, for messages; empty until the array is filled.
    """

    value: np.ndarray | list[Any] | None = None
    shape: tuple[int, ...] = ()
    description: str = ""

    def fill(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            refuse("an array with an unknown kind of state")
        _version, shape, dtype, fortran, raw = state
        self.set(shape, dtype, raw, "F" if fortran is True or fortran == 1 else "C")

    def set(self, shape: Any, dtype: Any, raw: Any, order: str, axes: Any = None) -> None:
        if self.description:
            refuse("an array that is filled twice")
        if not isinstance(dtype, PickledDtype):
            refuse("an array without a data type")
        self.shape = array_shape(shape)
        self.description = f"{dtype.description} {self.shape}"
        count = math.prod(self.shape)
        if isinstance(raw, list):
            if len(raw) != count:
                refuse(f"an object array of shape {self.shape} with {len(raw)} items")
            self.value = raw
            return
        if dtype.dtype is None:
            return
        need = count * dtype.dtype.itemsize
        if not isinstance(raw, bytes) or len(raw) != need:
            have = len(raw) if isinstance(raw, bytes) else type(raw).__name__
            refuse(f"an array {self.description} of {need} bytes with {have} bytes of data")
        flat = np.frombuffer(raw, dtype.dtype) if need else np.empty(0, dtype.dtype)
        if order == "K" and axes is not None:
            value = flat.reshape(self.shape).transpose(array_shape(axes))
            self.shape = value.shape
        else:
            value = flat.reshape(self.shape, order="F" if order == "F" else "C")
        value.flags.writeable = False
        self.value = value


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


def text_of(value: Any) -> Any:
    """Return a short string of Python 2 as text, anything else as it is."""
    return value.decode("latin-1") if isinstance(value, bytes) and len(value) <= 100 else value


# ---- functions in the place of those that a pickle names


def _ndarray(*_arguments: Any) -> NoReturn:
    refuse("a call of numpy.ndarray")


def _reconstruct(*arguments: Any) -> PickledArray:
    name = arguments[0] if len(arguments) == 3 else None
    if not isinstance(name, _Name) or name.make is not _ndarray or arguments[1] != (0,):
        refuse("_reconstruct of something else than an empty numpy.ndarray")
    return PickledArray()


def _frombuffer(raw: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> PickledArray:
    if order not in ("C", "F", "A", "K"):
        refuse("_frombuffer with unknown arguments")
    array = PickledArray()
    array.set(shape, dtype, raw, order, axes)
    return array


def _dtype(code: Any = None, *_flags: Any) -> PickledDtype:
    code = text_of(code)
    if not isinstance(code, str) or len(code) > 40:
        refuse("a data type that is not given by its code")
    return PickledDtype(code)


def _scalar(dtype: Any, raw: Any) -> Any:
    if not isinstance(dtype, PickledDtype):
        refuse("a numpy scalar without a data type")
    if dtype.dtype is None:
        return None
    if not isinstance(raw, bytes) or len(raw) != dtype.dtype.itemsize or not raw:
        refuse(f"a numpy scalar of type {dtype.dtype} with the wrong number of bytes")
    return np.frombuffer(raw, dtype.dtype)[0]


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding not in _LATIN_1:
        refuse("_codecs.encode of something else than latin1 text")
    return text.encode("latin-1")


def _complex(real: Any, imaginary: Any) -> complex:
    if not isinstance(real, int | float) or not isinstance(imaginary, int | float):
        refuse("a complex number of something else than numbers")
    return complex(float(real), float(imaginary))


_CORES = ("numpy.core", "numpy._core")
ARRAYS: Makers = {
    ("numpy", "ndarray"): _ndarray,
    ("numpy", "dtype"): _dtype,
    **{(f"{core}.multiarray", "_reconstruct"): _reconstruct for core in _CORES},
    **{(f"{core}.multiarray", "scalar"): _scalar for core in _CORES},
    # What protocol 5 writes in the place of _reconstruct for contiguous arrays.
    **{(f"{core}.numeric", "_frombuffer"): _frombuffer for core in _CORES},
    # Protocol 2 has no operation for bytes, and no protocol has one for a complex number.
    ("_codecs", "encode"): _encode,
    ("builtins", "complex"): _complex,
    ("__builtin__", "complex"): _complex,
}
"""What a dictionary of arrays, numbers and strings needs, by numpy before and since 2.0."""


# ---- the machine


@dataclass(frozen=True, slots=True)
class _Name:
    """An allowed name, on the stack."""

    label: str
    make: Callable[..., Any]


class _Machine:
    """A pickle's stack and memo. Objects are shared by reference, as in the file, never copied."""

    def __init__(self, content: bytes, makers: Makers, kind: str, offset: int) -> None:
        self._stream = io.BytesIO(content)
        self._stream.seek(offset)
        self._makers, self._kind = makers, kind
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        # One string can be encoded again and again, so that the sum is what is limited.
        self._left = len(content)

    def run(self) -> Any:
        stream, names = self._stream, _NAMES
        for _ in range(MAX_PICKLE_OPERATIONS):
            code = stream.read(1)
            if code == b".":
                return self._result()
            if code not in names:
                self._no_operation(code)
            name, read = names[code]
            step = _STEPS.get(name)
            if step is None:
                refuse(f"the operation {name}, which no {self._kind} needs")
            step(self, None if read is None else read(stream))
        refuse(f"more than {MAX_PICKLE_OPERATIONS} operations")

    def _result(self) -> Any:
        value = self._take()
        if self._stack or self._marks:
            refuse("an end in the middle")
        rest = len(self._stream.read())
        if rest:
            refuse(f"{rest} bytes after the end")
        return value

    def _no_operation(self, code: bytes) -> NoReturn:
        if not code:
            refuse("no end: it is cut short")
        refuse(f"a byte {code!r} that is no operation")

    def _take(self) -> Any:
        if len(self._stack) <= (self._marks[-1] if self._marks else 0):
            refuse("operations that take more than there is")
        return self._stack.pop()

    def _top(self) -> Any:
        value = self._take()
        self._stack.append(value)
        return value

    def _since_mark(self) -> list[Any]:
        if not self._marks:
            refuse("no mark where an operation goes back to one")
        at = self._marks.pop()
        items = self._stack[at:]
        del self._stack[at:]
        return items

    def _push(self, value: Any) -> None:
        self._stack.append(value)

    def _skip(self, _: Any) -> None:
        pass

    def _proto(self, number: int) -> None:
        if number > 5:
            refuse(f"protocol {number} (0 to 5 are read)")

    def _string_of_python_2(self, value: str) -> None:
        self._push(value.encode("latin-1"))

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _pop(self, _: Any) -> None:
        # Where a mark is on top, that is what goes.
        if self._marks and self._marks[-1] == len(self._stack):
            self._marks.pop()
        else:
            self._take()

    def _pop_mark(self, _: Any) -> None:
        self._since_mark()

    def _get(self, slot: Any) -> None:
        if slot not in self._memo:
            refuse(f"memo entry {slot}, which was never stored")
        self._push(self._memo[slot])

    def _put(self, slot: Any) -> None:
        self._memo[slot] = self._top()

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._top()

    def _extend(self, items: list[Any]) -> None:
        target = self._top()
        if not isinstance(target, list):
            refuse("items for something that is no list")
        target += items

    def _dict(self, _: Any) -> None:
        items = self._since_mark()
        self._push({})
        self._fill(items)

    def _setitem(self, _: Any) -> None:
        value = self._take()
        self._fill([self._take(), value])

    def _fill(self, items: list[Any]) -> None:
        target = self._top()
        if not isinstance(target, dict) or len(items) % 2:
            refuse("items for something that is no dictionary")
        for key, value in zip(items[::2], items[1::2], strict=True):
            name = text_of(key)
            # Long numbers, tuples and the like are slow to hash, again each time they are used.
            if isinstance(name, str | float) or (type(name) is int and name.bit_length() <= 64):
                target[name] = value

    def _named(self, module: Any, name: Any) -> None:
        if not isinstance(module, str) or not isinstance(name, str):
            refuse("a name that is no string")
        label = f"{clean(module)}.{clean(name)}"
        if (module, name) not in self._makers:
            if module in ("posix", "nt"):
                label += f" (os.{clean(name)})"
            refuse(f"the name {label}, which no {self._kind} needs; nothing was run")
        self._push(_Name(label, self._makers[module, name]))

    def _global(self, argument: str) -> None:
        self._named(*argument.split(" ", 1))

    def _stack_global(self, _: Any) -> None:
        name = self._take()
        self._named(self._take(), name)

    def _reduce(self, _: Any) -> None:
        arguments = self._take()
        self._make(self._take(), arguments)

    def _newobj_ex(self, _: Any) -> None:
        self._take()  # keywords: none of the names has any
        self._reduce(None)

    def _obj(self, _: Any) -> None:
        name, *arguments = self._since_mark() or [None]
        self._make(name, tuple(arguments))

    def _inst(self, argument: str) -> None:
        arguments = tuple(self._since_mark())
        self._global(argument)
        self._make(self._take(), arguments)

    def _make(self, name: Any, arguments: Any) -> None:
        if not isinstance(name, _Name) or not isinstance(arguments, tuple):
            refuse("a call of something that has no name")
        if name.make is _encode and arguments and isinstance(arguments[0], str):
            self._left -= len(arguments[0])
            if self._left < 0:
                refuse("more bytes through _codecs.encode than the file has")
        try:
            self._push(name.make(*arguments))
        except TypeError:
            refuse(f"{name.label} with {len(arguments)} arguments")

    def _build(self, _: Any) -> None:
        state, target = self._take(), self._top()
        if not isinstance(target, Stateful):
            refuse("a state for something that has none")
        target.fill(state)

    def _tuple_of(self, count: int) -> None:
        items = [self._take() for _ in range(count)]
        self._push(tuple(reversed(items)))


Step = Callable[[_Machine, Any], None]
_M = _Machine
_STEPS: dict[str, Step] = {
    "PROTO": _M._proto, "FRAME": _M._skip,
    "NONE": _M._push,
    "NEWTRUE": lambda m, _: m._push(True), "NEWFALSE": lambda m, _: m._push(False),
    **dict.fromkeys(("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"), _M._push),
    **dict.fromkeys(("FLOAT", "BINFLOAT"), _M._push),
    **dict.fromkeys(("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"), _M._push),
    **dict.fromkeys(("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"), _M._push),
    **dict.fromkeys(("STRING", "BINSTRING", "SHORT_BINSTRING"), _M._string_of_python_2),
    "MARK": _M._mark, "POP": _M._pop, "POP_MARK": _M._pop_mark,
    "DUP": lambda m, _: m._push(m._top()),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), _M._get),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _M._put), "MEMOIZE": _M._memoize,
    **dict.fromkeys(("EMPTY_LIST", "EMPTY_SET"), lambda m, _: m._push([])),
    **dict.fromkeys(("LIST", "FROZENSET"), lambda m, _: m._push(m._since_mark())),
    "APPEND": lambda m, _: m._extend([m._take()]),
    **dict.fromkeys(("APPENDS", "ADDITEMS"), lambda m, _: m._extend(m._since_mark())),
    "EMPTY_TUPLE": lambda m, _: m._push(()),
    "TUPLE": lambda m, _: m._push(tuple(m._since_mark())),
    "TUPLE1": lambda m, _: m._tuple_of(1), "TUPLE2": lambda m, _: m._tuple_of(2),
    "TUPLE3": lambda m, _: m._tuple_of(3),
    "EMPTY_DICT": lambda m, _: m._push({}), "DICT": _M._dict,
    "SETITEM": _M._setitem, "SETITEMS": lambda m, _: m._fill(m._since_mark()),
    "GLOBAL": _M._global, "STACK_GLOBAL": _M._stack_global,
    **dict.fromkeys(("REDUCE", "NEWOBJ"), _M._reduce), "NEWOBJ_EX": _M._newobj_ex,
    "OBJ": _M._obj, "INST": _M._inst, "BUILD": _M._build,
}  # fmt: skip


def _quoted(stream: io.BytesIO) -> str:
    """Read a string of protocol 0; pickletools wants ASCII, which arrays of Python 2 are not."""
    line = stream.readline().strip()
    if len(line) < 2 or line[:1] not in b"'\"" or line[-1:] != line[:1]:
        refuse("a string without quotes")
    return bytes(ast.literal_eval("b" + line.decode("ascii"))).decode("latin-1")


_NAMES: dict[bytes, tuple[str, Callable[[Any], Any] | None]] = {
    opcode.code.encode("latin-1"): (opcode.name, opcode.arg.reader if opcode.arg else None)
    for opcode in pickletools.opcodes
}
_NAMES[b"S"] = ("STRING", _quoted)
_NAMES[b"\x96"] = ("BYTEARRAY8", pickletools.read_bytes8)  # one copy, not two
