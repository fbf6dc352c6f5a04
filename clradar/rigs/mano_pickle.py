"""Arrays of a MANO pickle: of numpy, of scipy's sparse matrices and of the package chumpy.

Nothing that the pickle names is imported or called; see `clradar.files.pickles`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from clradar.files.limits import MAX_SPARSE_ELEMENTS
from clradar.files.pickles import ARRAYS, Fixed, Names, PickledArray, array_shape, load, refuse

_MAX_NESTING = 6
"""Of chumpy objects; each level can have two inner ones. The models have a Select of a Ch."""


def load_mano(content: bytes) -> Any:
    """Return the content of the pickle of a model; `as_array` converts its arrays."""
    return load(content, _NAMES, "hand model")


class _Object(metaclass=Fixed):
    """An object with attributes."""

    __slots__ = ("state",)

    def __init__(self, *_arguments: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        # A dictionary, or that and one of the slots.
        both = state if isinstance(state, tuple) and len(state) == 2 else (state,)
        parts = [part for part in both if part is not None]
        if not all(isinstance(part, dict) for part in parts):
            refuse("an object whose state is no dictionary")
        self.state = {name: value for part in parts for name, value in part.items()}


class ByColumns(_Object):
    """A matrix of scipy in compressed columns."""


class Ch(_Object):
    """An object of the package chumpy that holds an array `x`."""


class Select(_Object):
    """One that takes elements of `a`."""


def as_array(value: Any, depth: int = 0) -> np.ndarray:
    """Convert a value of the file to an array: dense, sparse, a number, or of chumpy."""
    if depth > _MAX_NESTING:
        refuse(f"chumpy objects nested more than {_MAX_NESTING} deep")
    if isinstance(value, PickledArray):
        if not isinstance(value.value, np.ndarray):
            refuse("an array of objects where numbers are needed")
        return value.value
    if isinstance(value, ByColumns):
        return _dense(value)
    if isinstance(value, Ch):
        return as_array(value.state.get("x"), depth + 1)
    if isinstance(value, Select):
        source, at = (as_array(value.state.get(name), depth + 1) for name in ("a", "idxs"))
        if at.dtype.kind not in "iu" or (at.size and not 0 <= at.min() <= at.max() < source.size):
            refuse("a chumpy.reordering.Select whose elements do not exist")
        shape = value.state.get("preferred_shape", at.shape)
        if isinstance(shape, PickledArray):
            shape = [int(n) for n in as_array(shape).reshape(-1)]
        shape = tuple(shape) if isinstance(shape, list) else shape
        return source.reshape(-1)[at].reshape(array_shape(at.shape if shape is None else shape))
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return np.asarray(value)
    refuse(f"{type(value).__name__} where an array is needed")


def _dense(value: ByColumns) -> np.ndarray:
    shape = value.state.get("_shape") or value.state.get("shape")
    parts = [value.state.get(name) for name in ("data", "indices", "indptr")]
    if not isinstance(shape, tuple) or not all(isinstance(p, PickledArray) for p in parts):
        refuse("a sparse matrix without data, indices, indptr and shape")
    data, indices, starts = (as_array(part) for part in parts)
    kinds = data.dtype.kind in "iuf", indices.dtype.kind in "iu", starts.dtype.kind in "iu"
    shape = array_shape(shape)
    if len(shape) != 2 or not all(kinds) or math.prod(shape) > MAX_SPARSE_ELEMENTS:
        refuse("a sparse matrix whose parts do not fit together")
    try:
        matrix = csc_matrix((data.astype(np.float64), indices, starts), shape)
        matrix.check_format(full_check=True)
    except ValueError:
        refuse("a sparse matrix whose parts do not fit together")
    return np.asarray(matrix.toarray())


class _Listed(metaclass=Fixed):
    """A set, list or tuple of a list; also `object`, the base of classes that nobody makes."""

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


_BUILTINS = {"dict": _Dictionary} | dict.fromkeys(
    ("object", "set", "frozenset", "list", "tuple"), _Listed
)
_SPARSE = ("scipy.sparse", "scipy.sparse.csc", "scipy.sparse._csc")
_NAMES: Names = {
    **ARRAYS,
    ("collections", "OrderedDict"): _Dictionary,
    ("chumpy.ch", "Ch"): Ch,
    ("chumpy", "Ch"): Ch,
    ("chumpy.reordering", "Select"): Select,
    ("copy_reg", "_reconstructor"): _Reconstructor,
    ("copyreg", "_reconstructor"): _Reconstructor,
    **{(m, name): made for m in ("__builtin__", "builtins") for name, made in _BUILTINS.items()},
    **{(module, f"csc_{kind}"): ByColumns for module in _SPARSE for kind in ("matrix", "array")},
}
