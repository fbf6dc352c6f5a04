"""Down the tree of blocks: from samples to the image, by ``kernels/backproject_fast.cl``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clradar.imaging.tree_on_device import WEIGHTS_TILE, Blocks, TreeOnDevice, padded


class WayDown:
    """The image over one tree; `report` gets the fraction that is done."""

    def __init__(self, tree: TreeOnDevice, report: Callable[[float], None]) -> None:
        self.tree, self.report, self.buffers = tree, report, tree.buffers
        self.volume = self.buffers.empty(8 * int(np.prod(tree.blocks.counts)))
        self.n_done = 0

    def image(self, cube: Any) -> np.ndarray:
        """Return the unscaled sum, shape (2, n_values), float32, of an uploaded cube."""
        self.report(0.0)
        top = self.tree.blocks.top()
        self._descend(0, self.tree.root(cube), top, np.zeros(len(top), np.int32))
        shape = (2, int(np.prod(self.tree.blocks.counts)))
        out = self.buffers.read(self.volume, shape, np.float32)
        self.buffers.release(self.volume)
        return out

    def _descend(self, i: int, above: Blocks, index: np.ndarray, parent: np.ndarray) -> None:
        """Form the image of blocks of level i by depth-first recursion, a chunk of them at a time.

        Parameters
        ----------
        index : ndarray, shape (n, ...)
            Blocks of level i.
        parent : ndarray, shape (n,), int32
            For each the block of `above` that it lies in.
        """
        tree, at_once = self.tree, self.tree.blocks_at_once(i)
        for start in range(0, len(index), at_once):
            part = slice(start, start + at_once)
            blocks = self._reduced(i, above, index[part], parent[part])
            if i + 1 < len(tree.steps):
                self._descend(i + 1, blocks, *tree.blocks.children(i, blocks.index))
            else:
                self._image_of(blocks)
                self.n_done += len(blocks.index)
                self.report(self.n_done / tree.blocks.n_leaves)
            tree.release(blocks.centres, blocks.g)

    def _reduced(self, i: int, above: Blocks, index: np.ndarray, parent: np.ndarray) -> Blocks:
        """Return blocks of level i, summed from those of the level above."""
        tree, buffers, u = self.tree, self.buffers, np.uint32
        step, unit, width = tree.steps[i], tree.unit, tree.width
        rows, columns, n, n_m = step.rows, step.columns, len(index), step.n_frequencies
        n_rows, n_columns = padded(rows.n, unit), padded(columns.n, unit)
        new_row = padded(rows.n_skeleton, unit)
        centre_m = tree.blocks.centres_m(i, index).astype(np.float32)
        parents, centres = buffers.upload(parent), buffers.upload(centre_m)
        started: list[Callable[[], None]] = []

        def start(kernel: str, size: tuple[int, ...], *args: Any) -> None:
            started.append(tree.program.start(kernel, size, *args))

        phasors = tree.phasors(i, centre_m, centres, above, parents, started)
        transposed = buffers.empty(8 * n * n_m * columns.n * new_row)
        start(
            "reduce_and_transpose", (n_columns // width, n_m, n), u(n_columns), u(n_m), u(n),
            u(rows.n), u(new_row), u(columns.n), u(n_rows), above.g, parents, phasors[0],
            rows.weights, transposed,
        )  # fmt: skip
        reduced = buffers.empty(8 * n * n_m * columns.n_skeleton * new_row)
        start(
            "reduce_rows", (new_row // width, n_m, n), u(new_row), u(n_m), u(n), u(columns.n),
            u(columns.n_skeleton), u(padded(columns.n_skeleton, WEIGHTS_TILE)), u(n_columns),
            transposed, phasors[1], columns.weights, reduced,
        )  # fmt: skip
        n_values, n_left = 2 * columns.n_skeleton * new_row, step.n_skeleton_frequencies
        g = buffers.empty(4 * n * n_left * n_values)
        start(
            "reduce_frequencies", (n_values // width, n), u(n_values), u(n), u(n_m), u(n_left),
            u(padded(n_left, WEIGHTS_TILE)), reduced, step.frequency_weights, g,
        )  # fmt: skip
        for wait in started:
            wait()
        tree.release(parents, *phasors, transposed, reduced)
        return Blocks(index, centre_m, centres, g)

    def _image_of(self, blocks: Blocks) -> None:
        """Write the voxels of some smallest blocks."""
        tree = self.tree
        numbers, per_block, shared = tree.leaf_arguments(blocks)
        items = tree.blocks.most_voxels(blocks.index)
        tree.program.launch(
            "image_of_blocks", (padded(items, tree.width) // tree.width, len(blocks.index)),
            *numbers, blocks.g, *per_block, *shared, self.volume,
        )  # fmt: skip
        tree.release(*per_block[2:])
