"""The blocks of a grid of voxels: where they, their voxels and the blocks in them are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.imaging.block_tree import BlockLevel, grid_block_counts
from clradar.imaging.voxel_skeleton import VoxelSkeleton
from clradar.model import VoxelGrid
from clradar.opencl.buffers import antenna_rows

NO_VOXEL = 2**30  # index of the voxels that fill up a block to whole lanes: outside every grid


@dataclass(frozen=True, slots=True, eq=False)
class GridBlocks:
    """Some blocks of a level are an array of shape (n, 3), int: their x, y, z indices."""

    levels: tuple[BlockLevel, ...]
    grid: VoxelGrid
    skeleton: VoxelSkeleton | None = None
    """The voxels of a smallest block that are summed; all by default."""

    @property
    def counts(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        return self.grid.counts

    @property
    def diagonal_m(self) -> float:
        """Of the whole grid."""
        return float(np.linalg.norm(self.grid.spacing_m * (np.array(self.grid.counts) - 1)))

    @property
    def n_leaves(self) -> int:
        return self.levels[-1].n_blocks

    def top(self) -> np.ndarray:
        """Return the blocks of the first level."""
        return np.zeros((1, 3), np.int64)

    def children(self, i: int, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the blocks of level i + 1 in those of level i, and for each which one it is in."""
        size = self.levels[i + 1].voxels
        ratio = np.array(self.levels[i].voxels) // np.array(size)
        inner = np.indices(tuple(ratio)).reshape(3, -1).T
        children = (index[:, None] * ratio + inner).reshape(-1, 3)
        parent = np.repeat(np.arange(len(index), dtype=np.int32), len(inner))
        inside = (children < grid_block_counts(self.grid, size)).all(axis=1)
        return children[inside], parent[inside]

    def centres_m(self, i: int, index: np.ndarray) -> np.ndarray:
        """Return the centres of blocks of level i, shape (n, 3), float64."""
        size = np.array(self.levels[i].voxels)
        return self.grid.origin_m + self.grid.spacing_m * (index * size + 0.5 * (size - 1))

    def leaf(self, width: int, far: bool) -> tuple[int, np.ndarray, np.ndarray]:
        """Return the voxels of a smallest block that are summed, whole lanes: how many, their
        offsets from its centre (x, y, z as hi, then as lo, metres, float32), and their indices
        among them."""
        size = np.array(self.levels[-1].voxels)
        axes = [np.arange(n) for n in size]
        if self.skeleton is not None:
            axes = [axis.skeleton for axis in self.skeleton.axes]
        n_x, n_y, n_z = (len(axis) for axis in axes)
        n = n_x * n_y * n_z
        index = np.arange(-(-n // width) * width)
        place = np.stack([index % n_x, index // n_x % n_y, index // (n_x * n_y)], axis=1)
        at = [axis.take(column, mode="clip") for axis, column in zip(axes, place.T, strict=True)]
        offset_m = self.grid.spacing_m * (np.stack(at, axis=1) - 0.5 * (size - 1))
        place[n:] = NO_VOXEL
        planes = antenna_rows(offset_m).T[: 6 if far else 3]
        return len(index), planes, place.astype(np.int32)

    def axis_offsets_m(self) -> list[np.ndarray]:
        """Return the offsets of a smallest block's voxels from its centre along x, y, z."""
        return [
            step * (np.arange(n) - 0.5 * (n - 1))
            for n, step in zip(self.levels[-1].voxels, self.grid.spacing_m, strict=True)
        ]

    def most_voxels(self, index: np.ndarray) -> int:
        """Return the largest number of voxels of some smallest blocks that are summed."""
        kept = self.levels[-1].voxels if self.skeleton is None else self.skeleton.counts
        return int(np.prod(kept))

    def first(self, index: np.ndarray) -> np.ndarray:
        """Return the first voxel of smallest blocks, x, y, z, shape (n, 3), int32."""
        return (index * np.array(self.levels[-1].voxels)).astype(np.int32)

    def rest_m(self, exact_m: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
        """Return what voxels' offsets from the exact centres lack to those from float32 ones."""
        return exact_m - centre_m
