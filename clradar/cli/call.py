"""The command that runs, for the provenance of what it writes."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class Call:
    """The command that runs, its options that count for results, and all that were typed."""

    command: str
    options: dict[str, Any]
    typed: Set[str]


call = Call("", {}, frozenset())


def plain(value: Any, *, paths: bool = True) -> Any:
    """A value in types that JSON reads back as they were; None in place of `paths`, if wanted."""
    if isinstance(value, Path):
        return str(value) if paths else None
    if isinstance(value, dict):
        return {name or "": plain(item, paths=paths) for name, item in value.items()}
    many = isinstance(value, list | tuple)
    return [plain(item, paths=paths) for item in value] if many else value
