"""Down the tree of blocks: from samples to the image, by ``kernels/tree_sums.cl`` and
``backproject_fast.cl``."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.imaging.tree_on_device import WEIGHTS_TILE, Blocks, LevelStep, TreeOnDevice, padded
from clradar.imaging.voxels_on_device import VoxelsOnDevice

STRIPES = 16
"""Items per core of the kernel that takes a level's steps block by block: they are not of one
length where other programs run, too."""

FEWEST_BLOCKS = 8
"""Blocks per core from which that kernel is used; fewer blocks would leave cores idle."""

MOST_SCRATCH_BYTES = 512 * 2**10
"""What one of its blocks may need on the way: about half of a core's cache."""

AHEAD = 4
"""Launches over smallest blocks that may wait on the device: the host goes on meanwhile, and can
stop soon."""

LANES = 8  # numbers beyond the image that a kernel may read

Report = Callable[[float], None]


@dataclass(slots=True, eq=False)
class _Chunk:
    """Some blocks of one level that are launched together, and what is on the device of them.

    `leaf` is that of smallest blocks: global size of the last sum, its arguments before and after
    G, and where not all voxels are summed, the first voxels and wave vectors of the blocks.
    """

    index: np.ndarray  # (n, ...), int
    centre_m: np.ndarray  # (n, 3), float32
    centres: Any  # buffer of the same
    parents: Any  # buffer: which of the blocks above each lies in
    phasors: list[Any]  # buffers of the first level: rows and columns
    leaf: tuple[tuple[int, int], list[Any], list[Any], tuple[Any, Any] | None] | None
    inner: list[_Chunk] | None  # of the blocks in these; None until they are needed

    @property
    def n(self) -> int:
        return len(self.index)


class WayDown:
    """The image over one tree, of one cube of samples after the other.

    A context manager, which frees its buffers. What does not depend on the samples is uploaded for
    the first image, and kept.
    """

    def __init__(self, tree: TreeOnDevice) -> None:
        self.tree, self.buffers = tree, tree.buffers
        self._held: list[Any] = []
        self.n_values = int(np.prod(tree.blocks.counts))
        # Zeros, since the last lanes of `strongest_along_z` read beyond the values.
        self.volume = self.buffers.zeros(4 * (2 * self.n_values + LANES))
        self._held.append(self.volume)
        info = self.buffers.device.info
        most_bytes = min(MOST_SCRATCH_BYTES, tree.chunk_bytes)
        self._striped = [
            info.kind != "gpu"
            and i > 0
            and level.n_blocks >= FEWEST_BLOCKS * info.compute_units
            and 4 * _scratch(step, tree.unit) <= most_bytes
            for i, (step, level) in enumerate(zip(tree.steps, tree.levels, strict=True))
        ]
        self._at_once = [tree.blocks_at_once(i, striped) for i, striped in enumerate(self._striped)]
        self._top: list[_Chunk] | None = None
        self._waits: deque[tuple[int, Callable[[], None]]] = deque()
        self._make_room()

    def __enter__(self) -> WayDown:
        return self

    def __exit__(self, *error: Any) -> None:
        self.tree.release(*self._held)
        self._held.clear()
        if self._voxels is not None:
            self._voxels.release()

    def image(self, cube: Any, report: Report) -> Any:
        """Write the unscaled sum of an uploaded cube; return its buffer, (2, n_values), float32.

        `report` gets the fraction that is done. The buffer is kept, and written by the next image.
        """
        report(0.0)
        tree = self.tree
        if self._top is None:
            index = tree.blocks.top()
            self._top = self._chunks(0, index, np.zeros(len(index), np.int32))
        self._report, self._n_done = report, 0
        self._waits.clear()
        try:
            self._descend(0, tree.root(cube), self._top)
            self._wait_until_ahead(0)
        except BaseException:
            # What was launched uses buffers that the caller may free.
            self.buffers.device.queue.finish()
            raise
        return self.volume

    def _descend(self, i: int, above: Blocks, chunks: list[_Chunk]) -> None:
        """Form the image of chunks of level i, which lie in the blocks above, depth first."""
        for chunk in chunks:
            blocks = Blocks(chunk.index, chunk.centre_m, chunk.centres, self._g[i])
            reduce = self._reduce_striped if self._striped[i] else self._reduce
            reduce(i, above, chunk)
            if chunk.leaf is not None:
                size, before, after, spread = chunk.leaf
                program = self.tree.program
                work = self.tree.steps[-1].n_skeleton_frequencies * self.tree.leaf_work()
                wait = program.start("image_of_blocks", size, *before, blocks.g, *after, work=work)
                if self._voxels is not None and spread is not None:
                    wait = self._voxels.start(chunk.n, *spread, self.volume)
                self._waits.append((chunk.n, wait))
                self._wait_until_ahead(AHEAD)
                continue
            if chunk.inner is None:
                chunk.inner = self._chunks(i + 1, *self.tree.blocks.children(i, chunk.index))
            self._descend(i + 1, blocks, chunk.inner)

    def _wait_until_ahead(self, n: int) -> None:
        """Wait until at most n launches over smallest blocks are left."""
        while len(self._waits) > n:
            n_blocks, wait = self._waits.popleft()
            wait()
            self._n_done += n_blocks
            self._report(self._n_done / self.tree.blocks.n_leaves)

    def _chunks(self, i: int, index: np.ndarray, parent: np.ndarray) -> list[_Chunk]:
        """Return the chunks of some blocks of level i; `parent` says which block above each is in.

        Parameters
        ----------
        index : ndarray, shape (n, ...)
        parent : ndarray, shape (n,), int32
        """
        tree, made = self.tree, []
        for start in range(0, len(index), self._at_once[i]):
            part = slice(start, start + self._at_once[i])
            centre_m = tree.blocks.centres_m(i, index[part]).astype(np.float32)
            centres, parents = self._upload(centre_m), self._upload(parent[part])
            chunk = _Chunk(index[part], centre_m, centres, parents, [], None, None)
            if i == 0:
                chunk.phasors = [
                    self._upload(phasors) for phasors in tree.root_phasors(tree.steps[0], centre_m)
                ]
            if i + 1 == len(tree.steps):
                chunk.leaf = self._leaf(chunk)
            made.append(chunk)
        return made

    def _leaf(
        self, chunk: _Chunk
    ) -> tuple[tuple[int, int], list[Any], list[Any], tuple[Any, Any] | None]:
        tree = self.tree
        blocks = Blocks(chunk.index, chunk.centre_m, chunk.centres, None)
        numbers, per_block, shared = tree.leaf_arguments(blocks)
        self._held += per_block[2:]
        items = padded(tree.blocks.most_voxels(chunk.index), tree.width) // tree.width
        size = items, chunk.n
        if self._voxels is None or tree.skeleton is None:
            return size, numbers, [*per_block, *shared, self.volume], None
        n_row, n_y, n_z = self._voxels.summed_counts
        numbers[6:9] = (np.uint32(count) for count in (n_row, n_y, n_z * chunk.n))
        starts = np.zeros((chunk.n, 3), np.int32)
        starts[:, 2] = n_z * np.arange(chunk.n)
        waves = self._upload(tree.skeleton.waves.cycles_per_m(chunk.centre_m).astype(np.float32))
        *per_block, first = per_block
        after = [*per_block, self._upload(starts), *shared, waves, self._voxels.values]
        return size, numbers, after, (first, waves)

    def _reduce(self, i: int, above: Blocks, chunk: _Chunk) -> None:
        """Sum blocks of level i from those of the level above, step by step."""
        tree, u = self.tree, np.uint32
        step, unit, width = tree.steps[i], tree.unit, tree.width
        rows, columns, n, n_m = step.rows, step.columns, chunk.n, step.n_frequencies
        n_rows, n_columns = padded(rows.n, unit), padded(columns.n, unit)
        new_row = padded(rows.n_skeleton, unit)
        start = tree.sums.start
        phasors = chunk.phasors
        if not phasors:
            phasors = self._phasors
            tree.start_phasors(i, n, chunk.centres, above, chunk.parents, phasors)
        start(
            "reduce_and_transpose", (n_columns // width, n_m, n), u(n_columns), u(n_m), u(n),
            u(rows.n), u(new_row), u(columns.n), u(n_rows), above.g, chunk.parents, phasors[0],
            rows.weights, self._transposed, work=4.0 * rows.n * new_row,
        )  # fmt: skip
        start(
            "reduce_rows", (new_row // width, n_m, n), u(new_row), u(n_m), u(n), u(columns.n),
            u(columns.n_skeleton), u(padded(columns.n_skeleton, WEIGHTS_TILE)), u(n_columns),
            self._transposed, phasors[1], columns.weights, self._reduced,
            work=4.0 * columns.n * columns.n_skeleton,
        )  # fmt: skip
        n_values, n_left = 2 * columns.n_skeleton * new_row, step.n_skeleton_frequencies
        start(
            "reduce_frequencies", (n_values // width, n), u(n_values), u(n), u(n_m), u(n_left),
            u(padded(n_left, WEIGHTS_TILE)), self._reduced, step.frequency_weights, self._g[i],
            work=2.0 * n_m * n_left,
        )  # fmt: skip

    def _reduce_striped(self, i: int, above: Blocks, chunk: _Chunk) -> None:
        """The same in one launch: every item takes some blocks, one after the other."""
        tree, u = self.tree, np.uint32
        step = tree.steps[i]
        rows, columns, n_items = step.rows, step.columns, min(self._n_items, chunk.n)
        tree.sums.start(
            "reduce_blocks", (n_items,), u(n_items), u(chunk.n), u(step.n_frequencies), u(rows.n),
            u(columns.n), u(padded(rows.n_skeleton, tree.unit)), u(columns.n_skeleton),
            u(step.n_skeleton_frequencies), u(_scratch(step, tree.unit)), rows.planes,
            columns.planes, step.k, chunk.centres, above.centres, chunk.parents, above.g,
            rows.weights, columns.weights, step.frequency_weights, self._scratch, self._g[i],
        )  # fmt: skip

    def _make_room(self) -> None:
        """Allocate what each level's blocks leave, and what all levels need on the way."""
        unit, self._g = self.tree.unit, []
        sizes, scratch = np.zeros(4, np.int64), 0
        for i, step in enumerate(self.tree.steps):
            rows, columns, n_m = step.rows, step.columns, step.n_frequencies
            new_row = padded(rows.n_skeleton, unit)
            last = i + 1 == len(self.tree.steps)
            n_blocks = self.tree.blocks.n_leaves if last else self.tree.levels[i].n_blocks
            n = min(self._at_once[i], n_blocks)
            left = columns.n_skeleton * step.n_skeleton_frequencies
            self._g.append(self._empty(8 * n * left * new_row))
            if self._striped[i]:
                scratch = max(scratch, _scratch(step, unit))
                continue
            kept = [n_m * new_row * m for m in (columns.n, columns.n_skeleton)]
            turned = [n_m * padded(side.n, unit) if i else 0 for side in (rows, columns)]
            sizes = np.maximum(sizes, [8 * n * values for values in (*kept, *turned)])
        self._transposed, self._reduced, *self._phasors = (self._empty(int(s)) for s in sizes)
        room = self.tree.chunk_bytes // (4 * max(1, scratch))
        self._n_items = min(STRIPES * self.buffers.device.info.compute_units, room)
        self._scratch = self._empty(4 * self._n_items * scratch)
        self._voxels: VoxelsOnDevice | None = None
        if self.tree.skeleton is not None:
            most = min(self._at_once[-1], self.tree.blocks.n_leaves)
            self._voxels = VoxelsOnDevice(self.tree, most)

    def _empty(self, n_bytes: int) -> Any:
        self._held.append(self.buffers.empty(n_bytes))
        return self._held[-1]

    def _upload(self, array: np.ndarray) -> Any:
        self._held.append(self.buffers.upload(array))
        return self._held[-1]


def _scratch(step: LevelStep, unit: int) -> int:
    """Return the numbers that one block needs on the way: see `reduce_blocks`."""
    rows, columns, n_m = step.rows, step.columns, step.n_frequencies
    new_row = padded(rows.n_skeleton, unit)
    phasors = n_m * (padded(rows.n, unit) + padded(columns.n, unit))
    return 2 * (phasors + columns.n * new_row + n_m * columns.n_skeleton * new_row)
