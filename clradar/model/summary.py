"""One line that says what a record holds, instead of a screen full of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

SMALL = 6
"""Arrays of at most this many elements are written out."""


def summary(record: Any) -> str:
    """Return the record's name and fields; of large arrays their type and shape.

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
