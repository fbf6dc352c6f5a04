"""Read a TOML file that may hold anything."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from clradar.files.failures import clean, fail, read_bytes, reading

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_LINE = 2**14
"""A key of thousands of dotted parts keeps the parser busy for minutes."""


def read_toml(path: Path, expected: str, limit: int) -> dict[str, Any]:
    """Return what a TOML file says.

    Parameters
    ----------
    path : Path
        UTF-8, with or without a byte-order mark; at most `limit` bytes, lines of at most
        `MAX_LINE` characters.
    expected : str
        What the file should be, for messages.
    limit : int

    Raises
    ------
    MeasurementError
        Missing, too large, no TOML.
    """
    content = read_bytes(path, expected, limit)
    with reading(path, expected):
        text = content.decode("utf-8-sig")
        longest = max((len(line) for line in text.splitlines()), default=0)
        if longest > MAX_LINE:
            fail(path, f"lines of at most {MAX_LINE} characters", f"{longest}")
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            fail(path, expected, clean(error))
