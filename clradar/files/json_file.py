"""Read one JSON object from a file that may hold anything, and write JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from clradar.files.atomic import replacing
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.json_text import MAX_DEPTH, MAX_TEXT_BYTES


def read_json_object(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds.

    Parameters
    ----------
    path : Path
        UTF-8, with or without a byte-order mark; at most `MAX_TEXT_BYTES`.

    Raises
    ------
    MeasurementError
        Missing, too large, no JSON, nested deeper than `MAX_DEPTH`, JSON that is no object, or a
        key that is there twice: which of the two values is meant cannot be known.
    """
    content = read_bytes(path, "a JSON file", MAX_TEXT_BYTES)
    with reading(path, "a JSON object in UTF-8"):
        value = json.loads(content.decode("utf-8-sig"), object_pairs_hook=_object)
        if not isinstance(value, dict):
            fail(path, "a JSON object", type(value).__name__)
        _check_depth(path, value)
    return value


def write_json(path: Path, value: object, *, force: bool) -> None:
    """Write strict JSON (no NaN), indented, whole or not at all."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def _check_depth(path: Path, value: dict[str, Any]) -> None:
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH):
        level = [
            inner
            for item in level
            for inner in (item.values() if isinstance(item, dict) else item)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return
    fail(path, f"at most {MAX_DEPTH} levels of nesting", "more")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key '{key[:60]}' twice")
        found[key] = value
    return found
