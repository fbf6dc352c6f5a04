"""The image in all voxels of smallest blocks from their skeleton voxels, on a device.

See `clradar.imaging.voxel_skeleton`. Kernels: ``reduce_frequencies`` of
``kernels/tree_sums.cl`` along z and ``voxels_of_blocks`` of ``backproject_fast.cl`` along y and x.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clradar.imaging.grid_blocks import GridBlocks
from clradar.imaging.tree_on_device import WEIGHTS_TILE, TreeOnDevice, padded


class VoxelsOnDevice:
    """Weights and room for some blocks at once.

    The kernel writes the image in skeleton voxels to the buffer `values`, float (n_blocks,
    n_kept_z, n_kept_y, n_row), whose last three are `summed_counts` from x to z.
    """

    def __init__(self, tree: TreeOnDevice, most_blocks: int) -> None:
        blocks = tree.blocks
        assert isinstance(blocks, GridBlocks)
        assert blocks.skeleton is not None
        self._tree, self._skeleton, self._counts = tree, blocks.skeleton, blocks.counts
        x, y, z = blocks.skeleton.axes
        self._size = blocks.levels[-1].voxels
        self._n_padded = padded(self._size[0], tree.width)
        self.summed_counts = blocks.skeleton.row, len(y.skeleton), len(z.skeleton)
        along_z = np.zeros((len(z.skeleton), padded(self._size[2], WEIGHTS_TILE)), np.float32)
        along_z[:, : self._size[2]] = z.weights.T
        along_x = np.zeros((len(x.skeleton), self._n_padded), np.float32)
        along_x[:, : self._size[0]] = x.weights.T
        along_y = np.ascontiguousarray(y.weights.T, dtype=np.float32)
        offset_x, *offsets_yz = blocks.axis_offsets_m()
        offset_x = np.pad(offset_x, (0, self._n_padded - len(offset_x)))
        offset = np.concatenate([offset_x, *offsets_yz]).astype(np.float32)
        upload = tree.buffers.upload
        self._along_z, *self._rest = (upload(a) for a in (along_z, offset, along_x, along_y))
        # Zeros, since the numbers that fill up rows are added, too.
        plane = blocks.skeleton.row * len(y.skeleton)
        self.values = tree.buffers.zeros(4 * most_blocks * len(z.skeleton) * plane)
        self._planes = tree.buffers.empty(4 * most_blocks * self._size[2] * plane)

    def release(self) -> None:
        self._tree.release(self._along_z, *self._rest, self.values, self._planes)

    def start(self, n: int, first: Any, waves: Any, volume: Any) -> Callable[[], None]:
        """Start writing the voxels of n blocks from `values`; return a function that waits.

        `first` and `waves` are buffers of the blocks' first voxels and wave vectors.
        """
        tree, u = self._tree, np.uint32
        n_row, n_y, n_z = self.summed_counts
        size, n_values = self._size, n_row * n_y
        tree.sums.start(
            "reduce_frequencies", (n_values // tree.width, n), u(n_values), u(n), u(n_z),
            u(size[2]), u(padded(size[2], WEIGHTS_TILE)), self.values, self._along_z, self._planes,
            work=2.0 * n_z * size[2],
        )  # fmt: skip
        n_items = size[1] if tree.buffers.device.info.kind == "gpu" else 1
        return tree.program.start(
            "voxels_of_blocks", (n_items, size[2], n), u(n_items), u(n), u(n_y), u(n_row),
            u(self._skeleton.counts[0]), *(u(s) for s in size), u(self._n_padded),
            *(u(count) for count in self._counts), first, waves, *self._rest, self._planes, volume,
            work=4.0 * size[1] * n_row * (n_y + size[0]) / n_items,
        )  # fmt: skip
