"""SHA-256 of files."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from clradar.files.failures import reading, regular_file_size

HASH_BLOCK_BYTES = 2**20

SETTLED_NS = 2_000_000_000
"""What was written less than this ago can be written again without that its times tell."""


def sha256_of_blocks(blocks: Iterable[bytes]) -> str:
    """Return the SHA-256 of bytes behind one another."""
    state = hashlib.sha256()
    for block in blocks:
        state.update(block)
    return state.hexdigest()


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    with open(path, "rb") as file:
        return sha256_of_blocks(iter(lambda: file.read(HASH_BLOCK_BYTES), b""))


def content_record(path: Path) -> dict[str, Any]:
    """The name of a file, its SHA-256, and what the system says of it while it stays as it is."""
    expected = "a readable file"
    regular_file_size(path, expected)
    with reading(path, expected):
        system = _system(path)  # before it is read: what is written meanwhile will differ
        settled = time.time_ns() - max(system[-2:]) > SETTLED_NS
        known = {"file": path.name, "sha256": sha256_of(path)}
        return {**known, "system": system if settled else None}


def holds_still(path: Path, record: Mapping[str, Any]) -> bool:
    """Whether a file holds what it did at its record; it is read if the system cannot tell."""
    with reading(path, "a readable file"):
        same = record.get("system") == _system(path)
    return same or content_record(path)["sha256"] == record.get("sha256")


def _system(path: Path) -> list[int]:
    found = os.stat(path)
    return [found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns]
