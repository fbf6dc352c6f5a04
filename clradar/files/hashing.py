"""Checksums of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

HASH_BLOCK_BYTES = 2**20


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    state = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            state.update(block)
    return state.hexdigest()
