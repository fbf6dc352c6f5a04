"""Whether an image fits into memory, before hours of work on one that does not."""

from __future__ import annotations

import math
import os
import sys

from clradar.model import VoxelGrid, checks

BYTES_OF_ONE = 9  # of each voxel of an image: complex64, and whether it is finite
BYTES_OF_SEVERAL = 24
"""Of each voxel of one image of several captures: that of one, and the sum in complex128."""


def check_memory(grid: VoxelGrid, bytes_per_voxel: int) -> None:
    """Raise `ModelError` where the whole memory of this machine is too small for an image."""
    memory_bytes = _memory_bytes()
    needed_bytes = bytes_per_voxel * math.prod(grid.counts)
    if memory_bytes is not None and needed_bytes > memory_bytes:
        checks.fail(
            "grid",
            f"an image that fits into the memory of {memory_bytes / 1e9:.1f} GB; `clradar image` "
            "writes larger ones piece by piece, and pieces of a grid are grids",
            f"{' x '.join(map(str, grid.counts))} voxels, whose image needs "
            f"{needed_bytes / 1e9:.1f} GB",
        )


def _memory_bytes() -> int | None:
    """The memory of this machine; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return None
