"""Checksums of files and of arrays."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

HASH_BLOCK_BYTES = 2**20


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    state = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            state.update(block)
    return state.hexdigest()


def sha256_of_arrays(*arrays: np.ndarray) -> str:
    """Return the SHA-256 of shapes, types and bytes of arrays."""
    state = hashlib.sha256()
    for array in arrays:
        state.update(str((array.shape, array.dtype)).encode())
        state.update(array.tobytes())
    return state.hexdigest()
