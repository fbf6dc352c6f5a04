"""Argument checks: each returns the value in its stored form or raises a `ModelError`.

Its message has the field's name, what was expected and what was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NoReturn, get_args

import numpy as np

from clradar.errors import ModelError, quoted

MAX_DYNAMIC_RANGE_DB = 1000.0
"""Fifty decades of amplitude; float32 has 77, at its ends with few digits."""

MAX_COORDINATE_M = 1e6
"""Coordinates of images: squares of what is beyond it lose the wavelength, and overflow at last."""


def fail(field: str, expected: str, got: object) -> NoReturn:
    raise ModelError(f"{quoted(field)}: expected {expected}, got {quoted(got)}")


def shape_text(shape: tuple[int | None, ...]) -> str:
    inner = ", ".join("N" if n is None else str(n) for n in shape)
    return f"({inner},)" if len(shape) == 1 else f"({inner})"


def read_only(
    field: str,
    value: Any,
    dtype: Any,
    shape: tuple[int | None, ...],
    *,
    allow_empty: bool = False,
    finite: bool = True,
) -> np.ndarray:
    """Return `value` as a C-contiguous, read-only array of `dtype` whose shape matches `shape`.

    None in `shape` allows any length. The caller's array is copied unless it and the arrays that it
    is a view of are read-only, so a stored array never changes.
    """
    dtype = np.dtype(dtype)
    try:
        raw = np.asarray(value)
    except ValueError as error:
        fail(field, f"an array of shape {shape_text(shape)}", f"a ragged one ({error})")
    if raw.dtype.kind not in "biufc":
        fail(field, f"numbers ({dtype})", f"dtype {raw.dtype}")
    if raw.dtype.kind == "c" and dtype.kind != "c":
        fail(field, f"real numbers ({dtype})", f"dtype {raw.dtype}")
    if raw.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(raw.shape, shape, strict=True)
    ):
        fail(field, f"shape {shape_text(shape)}", f"shape {raw.shape}")
    if raw.size == 0 and not allow_empty:
        fail(field, "at least one element", f"an empty array of shape {raw.shape}")
    if finite and raw.dtype.kind in "fc" and not np.isfinite(raw).all():
        bad = int(raw.size - np.count_nonzero(np.isfinite(raw)))
        fail(field, "finite numbers", f"{bad} of {raw.size} that are NaN or infinite")
    if dtype.kind in "iu" and raw.size:
        if raw.dtype.kind == "f" and not (raw == np.floor(raw)).all():
            fail(field, "whole numbers", "fractions")
        limits = np.iinfo(dtype)
        if raw.min() < limits.min or raw.max() > limits.max:
            fail(
                field,
                f"values in [{limits.min}, {limits.max}] ({dtype})",
                f"[{raw.min()}, {raw.max()}]",
            )
    if value is raw and raw.dtype == dtype and _is_immutable(raw):
        stored = np.ascontiguousarray(value)
    else:
        with np.errstate(over="ignore"):
            stored = np.array(raw, dtype=dtype, order="C", copy=True)
        if finite and dtype.kind in "fc" and not np.isfinite(stored).all():
            fail(field, f"numbers within the range of {dtype}", "an overflow")
    stored.flags.writeable = False
    return stored


def _is_immutable(array: np.ndarray) -> bool:
    owner: Any = array
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return False
        owner = owner.base
    return owner is None or isinstance(owner, bytes)


def is_single(value: Any) -> bool:
    """Whether `value` is one number or string rather than a list or an array of them."""
    try:
        return np.ndim(value) == 0
    except ValueError:  # nested lists of different lengths
        return False


def one_axis(field: str, value: Any) -> np.ndarray:
    """Return a strictly ascending, finite, non-empty 1-D float64 array."""
    axis = read_only(field, value, np.float64, (None,))
    ascending = axis[1:] > axis[:-1]
    if not ascending.all():
        at = int(np.argmin(ascending))
        kind = "repeated" if axis[at + 1] == axis[at] else "descending"
        fail(
            field,
            "strictly ascending values",
            f"{kind} values {axis[at]:.12g}, {axis[at + 1]:.12g} at {at}, {at + 1}",
        )
    return axis


def positive(field: str, value: Any) -> float:
    number = real(field, value)
    if number <= 0:
        fail(field, "a positive number", repr(value))
    return number


def within(field: str, value: Any, low: float, high: float, unit: str = "") -> float:
    number = real(field, value)
    if not low <= number <= high:
        fail(field, f"a number in [{low:g}, {high:g}]{unit}", f"{number:g}{unit}")
    return number


def indices(field: str, values: np.ndarray, count: int) -> None:
    if values.size and not 0 <= values.min() <= values.max() < count:
        fail(field, f"indices in [0, {count})", f"[{values.min()}, {values.max()}]")


def dynamic_range(field: str, value: Any) -> float:
    """Return a positive level in decibel of at most `MAX_DYNAMIC_RANGE_DB`."""
    level_db = positive(field, value)
    if level_db > MAX_DYNAMIC_RANGE_DB:
        fail(field, f"at most {MAX_DYNAMIC_RANGE_DB:g} dB", f"{level_db:g}")
    return level_db


def within_reach(field: str, *coordinates_m: np.ndarray) -> None:
    """Raise where a coordinate, NaN aside, is farther than `MAX_COORDINATE_M` from the origin."""
    for values in coordinates_m:
        farthest = float(np.fmax.reduce(np.abs(values), axis=None))
        if farthest > MAX_COORDINATE_M:
            fail(field, f"coordinates within {MAX_COORDINATE_M:g} m", f"{farthest:g} m")


def real(field: str, value: Any) -> float:
    if isinstance(value, str | bytes | bool | np.bool_) or not is_single(value):
        fail(field, "a number", repr(value))
    if np.iscomplexobj(value):
        fail(field, "a real number", repr(value))
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        fail(field, "a number", repr(value))
    if not np.isfinite(number):
        fail(field, "a finite number", repr(value))
    return number


def whole(field: str, value: Any, low: int, high: int | None = None) -> int:
    expected = f"a whole number >= {low}" if high is None else f"a whole number in [{low}, {high}]"
    odd = isinstance(value, str | bytes | bool | np.bool_)
    if odd or not is_single(value) or np.iscomplexobj(value):
        fail(field, expected, repr(value))
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        fail(field, expected, repr(value))
    if number != value or number < low or (high is not None and number > high):
        fail(field, expected, repr(value))
    return number


def one_of(field: str, value: Any, choices: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in choices:
        fail(field, "one of " + ", ".join(repr(c) for c in choices), repr(value))
    return str(value)


def instance(field: str, value: Any, kind: Any) -> None:
    if not isinstance(value, kind):
        names = " or ".join(one.__name__ for one in get_args(kind) or (kind,))
        fail(field, f"{'an' if names[0] in 'AEIOU' else 'a'} {names}", type(value).__name__)


def several(field: str, value: Any) -> Iterator[Any]:
    """Return what can be gone through, once."""
    try:
        return iter(value)
    except TypeError:
        fail(field, "several, as in a list", type(value).__name__)


def text(field: str, value: Any) -> str:
    if not isinstance(value, str):
        fail(field, "a string", repr(value))
    return value


def transform(field: str, value: Any) -> np.ndarray:
    """Return a 4x4 affine matrix (last row 0 0 0 1, invertible), float64, read-only."""
    matrix = read_only(field, value, np.float64, (4, 4))
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        fail(field, "a 4x4 affine matrix with last row [0, 0, 0, 1]", f"last row {matrix[3]}")
    stretch = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    if stretch[2] <= 1e-12 * stretch[0]:  # singular in float64
        fail(field, "an invertible 4x4 matrix", "a singular one")
    return matrix


def frozen_mapping(field: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        fail(field, "a mapping with string keys", type(value).__name__)
    bad = [key for key in value if not isinstance(key, str)]
    if bad:
        fail(field, "string keys", repr(bad[0]))
    try:
        return MappingProxyType({key: _copied(item) for key, item in value.items()})
    except RecursionError:
        fail(field, "a mapping of limited depth", "one that contains itself or is nested too deep")


def _copied(value: Any) -> Any:
    """Copy nested mappings and lists, so that later changes do not reach the record."""
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_copied(item) for item in value]
    return value
