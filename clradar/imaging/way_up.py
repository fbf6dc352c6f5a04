"""Up the tree of blocks: from reflectivity to samples, by ``kernels/forward_fast.cl``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clradar.imaging.tree_on_device import WEIGHTS_TILE, Blocks, TreeOnDevice, padded


class WayUp:
    """The samples of values over one tree; `report` gets the fraction that is done."""

    def __init__(self, tree: TreeOnDevice, report: Callable[[float], None]) -> None:
        self.tree, self.report, self.buffers = tree, report, tree.buffers
        self.n_done = 0

    def samples(self, values: np.ndarray) -> np.ndarray:
        """Return the cube, (n_freq, n_tx, 2, n_rx), float32, of values of shape (2, n_values)."""
        self.report(0.0)
        tree, buffers = self.tree, self.buffers
        self.values = buffers.borrow(values)
        n_freq, n_tx, n_rx = len(tree.k), tree.array.n_tx, tree.array.n_rx
        shape = (n_freq, n_tx, 2, padded(n_rx, tree.unit))
        cube = buffers.empty(4 * int(np.prod(shape)))
        top = tree.blocks.top()
        self._ascend(0, tree.root(cube), top, np.zeros(len(top), np.int32))
        out = buffers.read(cube, shape, np.float32)[..., :n_rx]
        tree.release(cube, self.values)
        return out

    def _ascend(self, i: int, above: Blocks, index: np.ndarray, parent: np.ndarray) -> None:
        """Sum blocks of level i into those above by depth-first recursion, a chunk at a time.

        `index`, (n, ...), are blocks of level i, those in one parent in a row; `parent`, (n,),
        int32, is for each the block of `above` that it lies in.
        """
        tree, at_once = self.tree, self.tree.blocks_at_once(i)
        step = tree.steps[i]
        row = padded(step.rows.n_skeleton, tree.unit)
        n_bytes = 8 * step.n_skeleton_frequencies * step.columns.n_skeleton * row
        for start in range(0, len(index), at_once):
            part = slice(start, start + at_once)
            some = index[part]
            centre_m = tree.blocks.centres_m(i, some).astype(np.float32)
            centres, g = self.buffers.upload(centre_m), self.buffers.empty(n_bytes * len(some))
            blocks = Blocks(some, centre_m, centres, g)
            if i + 1 < len(tree.steps):
                self._ascend(i + 1, blocks, *tree.blocks.children(i, some))
            else:
                self._sum_voxels(blocks)
                self.n_done += len(some)
                self.report(self.n_done / tree.blocks.n_leaves)
            begun = start > 0 and parent[start] == parent[start - 1]
            self._add(i, blocks, above, parent[part], begun)
            tree.release(centres, g)

    def _sum_voxels(self, blocks: Blocks) -> None:
        """Form the samples of some smallest blocks."""
        tree = self.tree
        numbers, per_block, shared = tree.leaf_arguments(blocks)
        n_m = tree.steps[-1].n_skeleton_frequencies
        at_once = 1 if tree.buffers.device.info.kind == "gpu" else n_m
        tree.program.launch(
            "blocks_of_voxels", (-(-n_m // at_once), len(blocks.index)), *numbers,
            np.uint32(at_once), self.values, *per_block, *shared, blocks.g,
            work=tree.leaf_work() * at_once * tree.leaf.n_voxels,
        )  # fmt: skip
        tree.release(*per_block[2:])

    def _add(self, i: int, blocks: Blocks, above: Blocks, parent: np.ndarray, begun: bool) -> None:
        """Add blocks of level i to those above; `begun`: to the first of them some were added."""
        tree, buffers, u = self.tree, self.buffers, np.uint32
        step, unit, width, sums = tree.steps[i], tree.unit, tree.width, tree.sums
        rows, columns, n, n_m = step.rows, step.columns, len(parent), step.n_frequencies
        n_rows, n_columns = padded(rows.n, unit), padded(columns.n, unit)
        n_lanes, n_few = padded(rows.n_skeleton, unit), step.n_skeleton_frequencies
        parents = buffers.upload(parent)
        phasors = tree.phasors(i, blocks.centre_m, blocks.centres, above, parents)
        n_values = 2 * columns.n_skeleton * n_lanes
        every = buffers.empty(4 * n * n_m * n_values)
        sums.start(
            "reduce_frequencies", (n_values // width, n), u(n_values), u(n), u(n_few), u(n_m),
            u(padded(n_m, WEIGHTS_TILE)), blocks.g, step.frequency_weights, every,
            work=2.0 * n_few * n_m,
        )  # fmt: skip
        expanded = buffers.empty(8 * n * n_m * rows.n_skeleton * n_columns)
        sums.start(
            "expand_and_transpose", (n_lanes // width, n_m, n), u(n_lanes), u(n_m), u(n),
            u(columns.n_skeleton), u(n_columns), u(rows.n_skeleton), every, phasors[1],
            columns.weights, expanded, work=4.0 * columns.n_skeleton * n_columns,
        )  # fmt: skip
        first, n_parents = int(parent[0]), int(parent[-1] - parent[0]) + 1
        stops = np.searchsorted(parent, np.arange(first, first + n_parents), side="right")
        ranges = np.zeros((n_parents, 3), np.int32)
        ranges[1:, 0], ranges[:, 1], ranges[0, 2] = stops[:-1], stops, begun
        held = buffers.upload(ranges)
        sums.launch(
            "expand_rows", (n_columns // width, n_m, n_parents), u(n_columns), u(n_m),
            u(n_parents), u(rows.n_skeleton), u(rows.n), u(padded(rows.n, WEIGHTS_TILE)),
            u(n_rows), u(first), expanded, held, phasors[0], rows.weights, above.g,
            work=4.0 * rows.n_skeleton * rows.n * n / n_parents,
        )  # fmt: skip
        tree.release(parents, *phasors, every, expanded, held)
