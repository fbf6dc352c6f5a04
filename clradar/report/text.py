"""Escaping of untrusted text for HTML and scripts."""

from __future__ import annotations

import html
import json
from typing import Any

from clradar.plot import printable


def escaped(value: object) -> str:
    """Return `value` as HTML text that is also safe inside a quoted attribute.

    Unprintable characters are written as escapes, so that no name imitates another one.
    """
    return html.escape(printable(value), quote=True)


def script_json(value: Any) -> str:
    """Return `value` as JSON for a <script> block: ASCII, without a character that could end it."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def shortened(value: object, longest: int) -> str:
    """Return `value` as text of at most `longest` characters, with a note of the missing number."""
    text = str(value)
    if len(text) <= longest:
        return text
    return f"{text[:longest]} … ({len(text) - longest} more characters)"
