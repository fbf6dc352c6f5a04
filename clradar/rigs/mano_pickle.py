"""Arrays of a MANO pickle: of numpy, of scipy's sparse matrices and of the package chumpy.

Nothing that the pickle names is imported or called; see `clradar.files.pickles`.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from clradar.files.limits import MAX_SPARSE_ELEMENTS
from clradar.files.pickles import (
    ARRAYS,
    Fixed,
    Names,
    PickledArray,
    array_shape,
    load,
    refuse,
)

_MAX_NESTING = 6
"""Of chumpy objects; each level can have two inner ones. The models have a Select of a Ch."""


def load_mano(content: bytes) -> Any:
    """Return the content of the pickle of a model; `as_array` converts its arrays."""
    return load(content, _NAMES, "hand model")


class _Object(metaclass=Fixed):
    """An object with attributes."""

    __slots__ = ("dictionaries",)

    def __init__(self, *_arguments: Any) -> None:
        self.dictionaries: tuple[dict[str, Any], ...] = ()

    def __setstate__(self, state: Any) -> None:
        # A state is a dictionary, or that and one of the slots.
        parts = state if isinstance(state, tuple) and len(state) == 2 else (state,)
        self.dictionaries = tuple(part for part in parts if part is not None)
        if not all(isinstance(part, dict) for part in self.dictionaries):
            refuse("an object whose state is no dictionary")

    def get(self, name: str) -> Any:
        found = [part[name] for part in self.dictionaries if name in part]
        return found[-1] if found else None


class Sparse(_Object):
    """A matrix of scipy in compressed columns (`csc`) or rows (`csr`)."""

    __slots__ = ()
    columns: ClassVar[bool]

    def dense(self) -> np.ndarray:
        """Return the matrix with its zeros."""
        shape = self.get("_shape") or self.get("shape")
        parts = [self.get(name) for name in ("data", "indices", "indptr")]
        if not isinstance(shape, tuple) or not all(isinstance(p, PickledArray) for p in parts):
            refuse("a sparse matrix without data, indices, indptr and shape")
        data, indices, starts = (as_array(part) for part in parts)
        shape = array_shape(shape)
        if len(shape) != 2 or indices.dtype.kind not in "iu" or starts.dtype.kind not in "iu":
            refuse("a sparse matrix whose parts do not fit together")
        if math.prod(shape) > MAX_SPARSE_ELEMENTS or data.dtype.kind not in "iuf":
            refuse("a sparse matrix whose parts do not fit together")
        form = csc_matrix if self.columns else csr_matrix
        try:
            matrix = form((data.astype(np.float64), indices, starts), shape)
            matrix.check_format(full_check=True)
        except ValueError:
            refuse("a sparse matrix whose parts do not fit together")
        return np.asarray(matrix.toarray())


class ByColumns(Sparse):
    __slots__ = ()
    columns = True


class ByRows(Sparse):
    __slots__ = ()
    columns = False


class Ch(_Object):
    """An object of the package chumpy that holds an array `x`."""

    __slots__ = ()


class Select(_Object):
    """One that takes elements of `a`."""

    __slots__ = ()


def as_array(value: Any, depth: int = 0) -> np.ndarray:
    """Convert a value of the file to an array: dense, sparse, a number, or of chumpy."""
    if depth > _MAX_NESTING:
        refuse(f"chumpy objects nested more than {_MAX_NESTING} deep")
    if isinstance(value, PickledArray):
        if not isinstance(value.value, np.ndarray):
            refuse("an array of objects where numbers are needed")
        return value.value
    if isinstance(value, Sparse):
        return value.dense()
    if isinstance(value, Ch):
        return as_array(value.get("x"), depth + 1)
    if isinstance(value, Select):
        source, at = (as_array(value.get(name), depth + 1) for name in ("a", "idxs"))
        if at.dtype.kind not in "iu" or (at.size and not 0 <= at.min() <= at.max() < source.size):
            refuse("a chumpy.reordering.Select whose elements do not exist")
        chosen = source.reshape(-1)[at]
        shape = value.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(array_shape(_sizes(shape)))
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return np.asarray(value)
    refuse(f"{type(value).__name__} where an array is needed")


def _sizes(shape: Any) -> Any:
    if isinstance(shape, PickledArray):
        return tuple(int(n) for n in as_array(shape).reshape(-1))
    return tuple(shape) if isinstance(shape, list) else shape


class _Listed(metaclass=Fixed):
    """A set, list or tuple of a list."""

    def __new__(cls, items: Any = ()) -> Any:
        if not isinstance(items, list | tuple):
            refuse("a collection of something else than a list")
        return items


class _Dictionary(metaclass=Fixed):
    def __new__(cls, *_arguments: Any) -> Any:
        return {}


class _Reconstructor(metaclass=Fixed):
    """What Python 2 makes objects with: of the class that it is given."""

    def __new__(cls, kind: Any, _base: Any, _state: Any) -> Any:
        if not isinstance(kind, Fixed) or not issubclass(kind, _Object | _Dictionary):
            refuse("an object without a class")
        return kind()


class _Plain(metaclass=Fixed):
    """`object`, the base of such a class; nobody calls it."""

    def __init__(self, *_arguments: Any) -> None:
        refuse("an object without a class of its own")


_BUILTINS = ("__builtin__", "builtins")
_NAMES: Names = {
    **ARRAYS,
    ("collections", "OrderedDict"): _Dictionary,
    ("chumpy.ch", "Ch"): Ch,
    ("chumpy", "Ch"): Ch,
    ("chumpy.reordering", "Select"): Select,
    **{(module, "object"): _Plain for module in _BUILTINS},
    **{(module, "dict"): _Dictionary for module in _BUILTINS},
    **{
        (module, kind): _Listed
        for module in _BUILTINS
        for kind in ("set", "frozenset", "list", "tuple")
    },
    **{(module, "_reconstructor"): _Reconstructor for module in ("copy_reg", "copyreg")},
    **{
        (module, f"{form}_{kind}"): made
        for form, made in (("csc", ByColumns), ("csr", ByRows))
        for module in ("scipy.sparse", f"scipy.sparse.{form}", f"scipy.sparse._{form}")
        for kind in ("matrix", "array")
    },
}
