"""SHA-256 of files and of arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

HASH_BLOCK_BYTES = 2**20


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


def sha256_of_arrays(*arrays: np.ndarray) -> str:
    """Return the SHA-256 of shapes, types and bytes of arrays."""
    forms = (str((array.shape, array.dtype)).encode() for array in arrays)
    contents = (array.tobytes() for array in arrays)
    return sha256_of_blocks(block for pair in zip(forms, contents, strict=True) for block in pair)
