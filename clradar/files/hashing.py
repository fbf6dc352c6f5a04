"""SHA-256 of files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from clradar.files.failures import reading, regular_file_size


def sha256_of_blocks(blocks: Iterable[bytes]) -> str:
    """Return the SHA-256 of bytes behind one another."""
    state = hashlib.sha256()
    for block in blocks:
        state.update(block)
    return state.hexdigest()


def sha256_of(*paths: Path) -> str:
    """Return the SHA-256 of the content of files, one behind the other."""
    return sha256_of_blocks(block for path in paths for block in _blocks(path))


def _blocks(path: Path) -> Iterator[bytes]:
    with open(path, "rb") as file:
        yield from iter(lambda: file.read(2**20), b"")


def content_record(path: Path) -> dict[str, Any]:
    """The name of a file, and its SHA-256."""
    expected = "a readable file"
    regular_file_size(path, expected)
    with reading(path, expected):
        return {"file": path.name, "sha256": sha256_of(path)}


def holds_still(path: Path, record: Mapping[str, Any]) -> bool:
    """Whether a file holds what it did at its record; its times and size say nothing of that."""
    return content_record(path)["sha256"] == record.get("sha256")
