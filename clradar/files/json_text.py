"""The JSON text that carries `meta`, checked so that it reads back as what was saved."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from clradar.errors import ModelError

MAX_TEXT_BYTES = 16 * 2**20
"""Longest JSON text that is written or read."""

MAX_DEPTH = 64
"""Deepest nesting of lists and mappings in `meta`."""


def to_json(field: str, meta: Mapping[str, Any]) -> str:
    """Return `meta` as ASCII JSON.

    Raises
    ------
    ModelError
        A value that JSON cannot hold so that it reads back equal: NaN, infinite, bytes, arrays and
        numpy integers, tuples (they would come back as lists), keys that are no strings.
    """
    plain = _plain(field, meta, 0)
    try:
        text = json.dumps(plain, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ModelError(f"{field}: expected values that JSON can hold, got {error}") from error
    if len(text) > MAX_TEXT_BYTES:
        raise ModelError(
            f"{field}: expected at most {MAX_TEXT_BYTES} bytes of JSON, got {len(text)}"
        )
    return text


def from_json(text: str) -> dict[str, Any]:
    """Return the mapping that `to_json` wrote; raises ValueError for anything else."""
    meta = json.loads(text, parse_constant=_no_constant)
    if not isinstance(meta, dict):
        raise ValueError(f"a JSON object was expected, not {type(meta).__name__}")
    return meta


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _plain(field: str, value: Any, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise ModelError(f"{field}: expected at most {MAX_DEPTH} levels of nesting, got more")
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise ModelError(f"{field}: expected string keys, got {key!r:.100}")
        return {key: _plain(f"{field}[{key!r}]", item, depth + 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(f"{field}[{i}]", item, depth + 1) for i, item in enumerate(value)]
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ModelError(f"{field}: expected a finite number, got {value}")
        return value
    raise ModelError(
        f"{field}: expected what JSON can hold (string, number, true, false, None, list, mapping), "
        f"got {type(value).__name__} {value!r:.60}"
    )
