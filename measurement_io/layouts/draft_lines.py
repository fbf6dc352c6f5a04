"""Lines of a drafted layout: a setting, and a remark on how it was found."""

from __future__ import annotations

from dataclasses import dataclass

from clradar.files.failures import clean
from clradar.files.toml_file import toml_string

UNKNOWN = "?"
"""Stands in a draft where nothing could be guessed; no file has a key of that name."""

GUESS = "guess: "


@dataclass(frozen=True, slots=True)
class Line:
    """One setting and the remark beside it."""

    text: str
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.text}  # {self.remark}" if self.remark else self.text


def toml_name(name: str) -> str:
    """Return a name as a TOML string; a long one is cut."""
    return toml_string(clean(name) if len(name) > 1000 else name)
