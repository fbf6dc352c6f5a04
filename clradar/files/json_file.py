"""Files of JSON: read with bounds, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeasurementError
from clradar.files.atomic import write_file
from clradar.files.failures import read_bytes, reading
from clradar.files.json_text import indented, parse_json, parse_object
from clradar.files.limits import MAX_JSON_BYTES


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
