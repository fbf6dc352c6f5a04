"""TOML (toml.io, version 1.0): files and text read with bounds, and written."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import read_bytes, reading
from clradar.files.limits import MAX_TOML_BYTES, MAX_TOML_LINE_CHARACTERS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_LIST_CHARACTERS = 100
"""A longer list gets a line for each item; long lines are refused by `parse_toml`."""

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+\Z")


def read_toml(
    path: Path,
    expected: str,
    *,
    limit: int = MAX_TOML_BYTES,
    error: type[ClradarError] = MeasurementError,
) -> dict[str, Any]:
    """Return the tables of a TOML file of at most `limit` bytes, UTF-8, with or without a BOM."""
    content = read_bytes(path, expected, limit, error=error)
    with reading(path, expected, error=error):
        return parse_toml(content.decode("utf-8-sig"))


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; raises ValueError for anything else."""
    longest = max((len(line) for line in text.splitlines()), default=0)
    if longest > MAX_TOML_LINE_CHARACTERS:
        raise ValueError(f"a line of {longest} characters, more than {MAX_TOML_LINE_CHARACTERS}")
    return tomllib.loads(text)


def toml_document(content: Mapping[str, Any]) -> str:
    """Return a document of strings, numbers, truth values, lists and tables of them."""
    return "\n".join(_lines(content, ())).strip("\n") + "\n"


def _lines(table: Mapping[str, Any], place: tuple[str, ...]) -> list[str]:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lines = []
    if place and (len(inner) < len(table) or not inner):
        lines.append(f"[{'.'.join(map(_key, place))}]")
    for key, value in table.items():
        if key not in inner:
            lines.append(f"{_key(key)} = {_value(value)}")
    if lines:
        lines.append("")
    for key, value in inner.items():
        lines += _lines(value, (*place, key))
    return lines


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        items = [_value(item) for item in value]
        line = f"[{', '.join(items)}]"
        return line if len(line) <= _LIST_CHARACTERS else "[\n" + ",\n".join(items) + "\n]"
    # A basic string is that of JSON, with DEL escaped, too.
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
    return text.replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    return key if _BARE_KEY.match(key) else _value(key)


def toml_brief(value: object) -> str:
    """Return a value as JSON writes it, cut to the length of a message."""
    parts = json.JSONEncoder(ensure_ascii=False, default=str).iterencode(value)
    try:
        return "nothing" if value is None else "".join(islice(parts, 60))[:600]
    except ValueError:  # of thousands of digits
        return "a huge number"


def nearest(given: object, known: Sequence[str]) -> str:
    """Return " (did you mean ...?)" where a known word is near, whatever its case, else nothing."""
    folded = {word.casefold(): word for word in known}
    found = get_close_matches(str(given).casefold(), folded, n=1)
    return f" (did you mean '{folded[found[0]]}'?)" if found else ""


def unknown_key(key: str, names: Sequence[str]) -> str:
    return f"unknown key; expected one of {', '.join(names)}{nearest(key, names)}"


def choice_text(given: object, choices: Sequence[str]) -> str:
    return "one of " + ", ".join(f'"{c}"' for c in choices) + nearest(given, choices)
