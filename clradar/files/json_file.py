"""JSON (RFC 8259): text and files, parsed with bounds, and written so that it reads back equal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeasurementError, ModelError
from clradar.files.atomic import write_file
from clradar.files.failures import read_bytes, reading
from clradar.files.json_differences import differences
from clradar.files.limits import MAX_JSON_BYTES, MAX_JSON_DEPTH


def read_json(path: Path, expected: str, error: type[ClradarError] = MeasurementError) -> Any:
    """Return the value in a file of at most `MAX_JSON_BYTES`, UTF-8, with or without a BOM."""
    content = read_bytes(path, expected, MAX_JSON_BYTES, error=error)
    with reading(path, expected, error=error):
        return parse_json(content.decode("utf-8-sig"))


def read_json_object(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file of at most `MAX_JSON_BYTES`; errors as `read_json`."""
    content = read_bytes(path, "a JSON file", MAX_JSON_BYTES)
    with reading(path, "a JSON object in UTF-8"):
        return parse_object(content.decode("utf-8-sig"))


def write_json(path: Path, value: object, *, force: bool) -> None:
    """Write strict JSON (no NaN), indented, whole or not at all."""
    # Names of files may be no UTF-8.
    write_file(path, indented(value).encode("utf-8", "backslashreplace"), force=force)


def parse_json(text: str, *, strict: bool = False) -> Any:
    """Return the value of a JSON text; raises ValueError for anything else.

    A key that an object has twice is refused, since its value would depend on the reader, and so
    is nesting deeper than `MAX_JSON_DEPTH`. NaN and infinities, which Python writes though JSON
    has none, are refused only if `strict`.
    """
    value = json.loads(
        text, object_pairs_hook=_object, parse_constant=_no_constant if strict else float
    )
    _check_depth(value)
    return value


def parse_object(text: str, *, strict: bool = False) -> dict[str, Any]:
    """Return the mapping of a JSON object; raises ValueError for anything else."""
    value = parse_json(text, strict=strict)
    if not isinstance(value, dict):
        raise ValueError(f"{type(value).__name__} where a JSON object was expected")
    return value


def indented(value: object) -> str:
    """Return strict JSON (no NaN), indented, with a line break at its end."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def to_json(field: str, meta: Mapping[str, Any]) -> str:
    """Return `meta` as ASCII JSON on one line, which reads back equal."""
    try:
        text = json.dumps(meta, default=_mapping)
        if found := differences(dict(meta), parse_object(text, strict=True)):
            raise ValueError(found[0])
    except (TypeError, ValueError, RecursionError) as error:
        raise ModelError(f"{field}: expected {_HELD}, got {error}") from error
    if len(text) > MAX_JSON_BYTES:
        raise ModelError(
            f"{field}: expected at most {MAX_JSON_BYTES} bytes of JSON, got {len(text)}"
        )
    return text


_HELD = "what JSON can hold and give back (string, finite number, true, false, None, list, mapping)"


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"{type(value).__name__} {value!r:.60}")
    return dict(value)


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key '{key[:60]}' twice")
        found[key] = value
    return found


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(MAX_JSON_DEPTH + 2):
        tables = [list(item.values()) if isinstance(item, dict) else item for item in level]
        level = [inner for item in tables if isinstance(item, list) for inner in item]
        if not level:
            return
    raise ValueError(f"more than {MAX_JSON_DEPTH} levels of nesting")
