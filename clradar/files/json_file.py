"""JSON (RFC 8259): text and files, parsed with bounds, and written so that it reads back equal."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeasurementError, ModelError
from clradar.files.atomic import write_file
from clradar.files.failures import read_bytes, reading
from clradar.files.limits import MAX_JSON_BYTES, MAX_JSON_DEPTH

MOST = 5  # differences that an error lists
SHOWN = 60  # characters of a setting's value in an error


def read_json(
    path: Path,
    expected: str,
    error: type[ClradarError] = MeasurementError,
    parse: Callable[[str], Any] | None = None,
) -> Any:
    """Return the value in a file of at most `MAX_JSON_BYTES`, UTF-8, with or without a BOM."""
    content = read_bytes(path, expected, MAX_JSON_BYTES, error=error)
    with reading(path, expected, error=error):
        return (parse or parse_json)(content.decode("utf-8-sig"))


def read_json_object(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file of at most `MAX_JSON_BYTES`; errors as `read_json`."""
    found: dict[str, Any] = read_json(path, "a JSON object in UTF-8", parse=parse_object)
    return found


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
    if _depth(value) > MAX_JSON_DEPTH:
        raise ValueError(f"more than {MAX_JSON_DEPTH} levels of nesting")
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


def _depth(value: Any) -> int:
    """Levels of nesting; `RecursionError` of more than Python has."""
    inner = value.values() if isinstance(value, dict) else value
    return 1 + max(map(_depth, inner), default=0) if isinstance(value, dict | list) else 0


def differences(before: Any, now: Any, name: str = "") -> list[str]:
    """Return as text how two values of JSON differ, one line per setting."""
    if before == now:
        return []
    texts = str(before), str(now)
    if isinstance(before, dict) and isinstance(now, dict):
        above = f"{name}." if name else ""
        inner = ((f"{above}{key}", before.get(key), now.get(key)) for key in {**now, **before})
        return [line for key, one, other in inner for line in differences(one, other, key)]
    if isinstance(before, list) and isinstance(now, list) and max(map(len, texts)) > SHOWN:
        found = [f"{name} of {len(before)}, now of {len(now)}"] * (len(before) != len(now))
        for i, (one, other) in enumerate(zip(before, now, strict=False)):
            found += differences(one, other, f"{name}[{i}]")
        return found
    # Long texts from about where they differ.
    alike = takewhile(lambda pair: pair[0] == pair[1], zip(*texts, strict=False))
    start = max(0, len([*alike]) - SHOWN // 3)
    lead = "…" if start else ""
    one, other = (lead + text[start:][:SHOWN] + "…" * (len(text) > start + SHOWN) for text in texts)
    return [f"{name} {one}, now {other}"]


def listed_differences(found: Sequence[str], most: int = MOST) -> str:
    """Return differences in one line: the first `most` of them, and how many more there are."""
    more = len(found) - most
    return "; ".join(found[:most]) + (f"; {more} more" if more > 0 else "")
