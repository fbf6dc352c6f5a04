"""Read one JSON object from a file that may hold anything."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from measurement_io.failures import fail, read_bytes, reading
from measurement_io.provenance import MAX_TEXT_BYTES


def read_json_object(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds.

    Parameters
    ----------
    path : Path
        UTF-8, with or without a byte-order mark; at most `MAX_TEXT_BYTES`.

    Raises
    ------
    MeasurementError
        Missing, too large, no JSON, or JSON that is no object.
    """
    content = read_bytes(path, "a JSON file", MAX_TEXT_BYTES)
    with reading(path, "a JSON object in UTF-8"):
        value = json.loads(content.decode("utf-8-sig"))
        if not isinstance(value, dict):
            fail(path, "a JSON object", type(value).__name__)
    return value
