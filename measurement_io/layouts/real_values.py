"""Real numbers, lists of them and text, out of a container."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_META_NUMBERS
from measurement_io.layouts.container import Container


def real_array(container: Container, key: str, purpose: str) -> np.ndarray:
    """Return a key's real numbers as finite float64."""
    value = container.read(key, purpose)
    if value.dtype.kind not in "iuf":
        fail(container.path, f"'{clean(key)}' ({purpose}) to hold real numbers", clean(value.dtype))
    if value.size == 0:
        fail(container.path, f"'{clean(key)}' ({purpose}) to hold numbers", f"shape {value.shape}")
    result = value.astype(np.float64)
    if not np.isfinite(result).all():
        bad = int(result.size - np.count_nonzero(np.isfinite(result)))
        fail(
            container.path,
            f"finite numbers in '{clean(key)}' ({purpose})",
            f"{bad} of {result.size} that are NaN or infinite",
        )
    return result


def real_list(container: Container, key: str, purpose: str) -> np.ndarray:
    """Return a key's numbers in one row; at most one of its axes may be longer than 1."""
    value = real_array(container, key, purpose)
    if sum(n > 1 for n in value.shape) > 1:
        fail(container.path, f"'{clean(key)}' ({purpose}) to be a list", f"shape {value.shape}")
    return value.ravel()


def real_number(container: Container, value: str | float, purpose: str) -> float:
    """Return a number of the layout, or the one that a key of the file holds."""
    if not isinstance(value, str):
        return float(value)
    found = real_array(container, value, purpose)
    if found.size != 1:
        fail(container.path, f"'{clean(value)}' ({purpose}) to be a number", f"{found.shape}")
    return float(found.ravel()[0])


def meta_value(container: Container, key: str) -> Any:
    """Return a key's content as a JSON value: text, a number or a list of numbers."""
    found = container.find(key, "metadata")
    if found.content == "text":
        return container.text(key, "metadata")
    if found.content == "numbers" and np.prod(found.shape, dtype=float) > MAX_META_NUMBERS:
        fail(
            container.path,
            f"at most {MAX_META_NUMBERS} numbers of metadata in '{clean(key)}'",
            f"shape {found.shape}",
        )
    value = real_array(container, key, "metadata")
    whole = container.read(key, "metadata").dtype.kind in "iu"
    numbers = (value.astype(np.int64) if whole else value).ravel().tolist()
    return numbers[0] if len(numbers) == 1 else numbers
