"""Immutable records: printed on one line, and checked again when they are unpickled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib import import_module
from types import MappingProxyType
from typing import Any

import numpy as np

from clradar.model import checks

SMALL = 6  # arrays of at most this many elements are written out


class Record:
    """Base of frozen dataclasses, which are declared with ``repr=False``."""

    __slots__ = ()

    def __repr__(self) -> str:
        own: Any = self
        parts = [f"{f.name}={_field_text(getattr(self, f.name))}" for f in fields(own) if f.repr]
        return f"{type(self).__name__}({', '.join(parts)})"

    def _repr_html_(self) -> str | None:
        # By name: figures are above the records, and are imported for notebooks alone.
        return import_module("clradar.plot.notebook").html_of(self)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        # Pickle calls the class again with its fields. It does not know read-only mappings.
        own: Any = self
        values = (getattr(self, f.name) for f in fields(own) if f.init)
        plain = (dict(v) if isinstance(v, MappingProxyType) else v for v in values)
        return type(self), tuple(plain)

    def _own_array(self, dtype: Any, copy: bool | None) -> np.ndarray:
        """Return the array that numpy makes of the record: its first field."""
        own: Any = self
        array: np.ndarray = getattr(own, fields(own)[0].name)
        if copy is None:
            return np.asarray(array, dtype)
        return np.array(array, dtype, copy=copy)

    def _set(self, **values: Any) -> None:
        """Store fields in their checked form; for `__post_init__` alone."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _set_array(
        self, name: str, dtype: Any, shape: tuple[int | None, ...], axes: str = "", **options: bool
    ) -> np.ndarray:
        """Check a field by `checks.read_only`, store and return it; `axes` explains its shape."""
        field = f"{type(self).__name__}.{name}{axes}"
        array = checks.read_only(field, getattr(self, name), dtype, shape, **options)
        object.__setattr__(self, name, array)
        return array


def plain(value: Any) -> Any:
    """Records, arrays and numbers in types of strict JSON; None replaces NaN."""
    from pydantic_core import to_jsonable_python

    return to_jsonable_python(value, fallback=lambda own: own.tolist(), inf_nan_mode="null")


def _field_text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        if value.size <= SMALL:
            return np.array2string(value, separator=", ")
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, Mapping):
        return f"<{len(value)} entries>"
    return repr(value)
