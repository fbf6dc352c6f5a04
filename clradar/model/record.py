"""What all records share: how they are printed, and how they go to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np

SMALL = 6
"""Arrays of at most this many elements are written out."""


def summary(record: Any) -> str:
    """Return the record's name and fields on one line; of large arrays their type and shape.

    To be used as `__repr__` of a dataclass that is declared with ``repr=False``.
    """
    parts = [f"{f.name}={_short(getattr(record, f.name))}" for f in fields(record) if f.repr]
    return f"{type(record).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        if value.size <= SMALL:
            return np.array2string(value, separator=", ")
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, Mapping):
        return f"<{len(value)} entries>"
    return repr(value)


def reduced(record: Any) -> tuple[type, tuple[Any, ...]]:
    """Return what pickle makes the record from again, checked anew: its class and its fields.

    To be used as `__reduce__` of a dataclass whose mappings are read-only views, which pickle
    does not know.
    """
    values = (getattr(record, f.name) for f in fields(record) if f.init)
    plain = (dict(v) if isinstance(v, MappingProxyType) else v for v in values)
    return type(record), tuple(plain)
