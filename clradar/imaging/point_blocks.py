"""Blocks of points anywhere: only those that have points exist, on any level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clradar.imaging.block_tree import (
    EXTREME,
    LEAF_WAVELENGTHS,
    LEAST_LEAF,
    BlockLevel,
    Triple,
    block_sizes,
    centre_wavelength_m,
    tree_levels,
)
from clradar.model import AntennaArray, Waveform
from clradar.opencl.buffers import hi_lo

MOST_POINTS = 1024
"""Points of one smallest block, which one work-item sums: others are cut, so that points that lie
close together do not wait for one another."""

STRICTER = 0.5
"""Fraction of the tolerance that is asked of the levels: a few points may reflect alone, and
errors of neighbours do not cancel."""

LANES = 8  # points are summed so many at a time


class PointCells:
    """Points in cells of the size of the smallest blocks, sorted: blocks are ranges of cells.

    So is every cell a range of points. Attributes: `order` of the points by cell, in a cell by
    number; `columns_m`, (3, n_points), x, y and z in that order; `first` point of every cell,
    (n_cells + 1,); index of all `cells` along x, y, z, (n_cells, 3); `low_m` and `high_m`,
    (n_cells, 3), of the box around its points; `sizes` of blocks in cells, from one around all
    points down to a cell; and `level_first`, for each level the first cell of every block, and
    n_cells.
    """

    def __init__(self, points_m: np.ndarray, wavelength_m: float) -> None:
        columns_m = points_m.T  # numpy is slow along a short last axis
        low_m = np.array([x_m.min() for x_m in columns_m])
        high_m = np.array([x_m.max() for x_m in columns_m])
        self.diagonal_m = float(np.linalg.norm(high_m - low_m))
        edges_m = np.array(LEAF_WAVELENGTHS) * wavelength_m
        while True:
            self._place(points_m, low_m, high_m, edges_m)
            keys = self._keys(points_m)
            self.order: np.ndarray = np.argsort(keys, kind="stable")
            keys = keys[self.order]
            starts = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))
            if len(points_m) >= LEAST_LEAF * len(starts) or len(self.sizes) == 1:
                break
            growing = np.flatnonzero(np.array(self.counts) > 1)
            edges_m[growing[np.argmin(edges_m[growing])]] *= 2.0
        self.columns_m = np.empty((3, len(points_m)))
        for axis, column_m in enumerate(self.columns_m):
            points_m[:, axis].take(self.order, out=column_m, mode="clip")
        self.first = np.append(starts, len(points_m))
        self.low_m = np.minimum.reduceat(self.columns_m, starts, axis=1).T.copy()
        self.high_m = np.maximum.reduceat(self.columns_m, starts, axis=1).T.copy()
        firsts_m = zip(self.columns_m[:, starts], range(3), strict=True)
        self.cells = np.stack([self._cells(x_m, axis) for x_m, axis in firsts_m], axis=1)
        self.level_first = []
        for shift in self._shifts:
            block = keys[starts].astype(np.int64) >> shift
            new = np.flatnonzero(np.append(True, block[1:] != block[:-1]))
            self.level_first.append(np.append(new, len(starts)))

    def _place(
        self, points_m: np.ndarray, low_m: np.ndarray, high_m: np.ndarray, edges_m: np.ndarray
    ) -> None:
        """Choose cells of some size, in the middle of the points, and the blocks of all levels."""
        n_x, n_y, n_z = (int(n) + 1 for n in np.floor((high_m - low_m) / edges_m))
        self.edges_m, self.counts = edges_m.copy(), (n_x, n_y, n_z)
        self.corner_m = 0.5 * (low_m + high_m - edges_m * self.counts)
        self.sizes: list[Triple] = block_sizes(self.counts, (1, 1, 1))

    def _cells(self, x_m: np.ndarray, axis: int) -> np.ndarray:
        """Return the index along an axis of the cells that coordinates are in."""
        # Truncated: slightly negative numbers are in the first cell, too.
        index = ((x_m - self.corner_m[axis]) / self.edges_m[axis]).astype(np.int64)
        return np.clip(index, 0, self.counts[axis] - 1, out=index)

    def _keys(self, points_m: np.ndarray) -> np.ndarray:
        """Return a number for the cell of every point: of the block on the first level, of that in
        it on the next, and so on, in its bits from high to low."""
        bits = [[larger[a] // smaller[a] == 2 for a in range(3)]
                for larger, smaller in zip(self.sizes, self.sizes[1:], strict=False)]  # fmt: skip
        total = sum(map(sum, bits))
        self._shifts, tables = [total], [np.zeros(n, np.int64) for n in self.counts]
        at = total
        for size, halved in zip(self.sizes[1:], bits, strict=True):
            for axis in range(3):
                if halved[axis]:
                    at -= 1
                    index = np.arange(self.counts[axis]) // size[axis]
                    tables[axis] |= (index & 1) << at
            self._shifts.append(at)
        # numpy sorts 16 bits in linear time.
        keys: np.ndarray = np.zeros(len(points_m), np.uint16 if total <= 16 else np.int64)
        for axis, table in enumerate(tables):
            keys += table.astype(keys.dtype)[self._cells(points_m[:, axis], axis)]
        return keys

    def centres_m(self, cell: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Return the centres of the blocks of some sizes that cells are in."""
        index = self.cells[cell]
        return self.corner_m + self.edges_m * (index // sizes * sizes + 0.5 * sizes)

    def level_counts(self) -> list[tuple[Triple, int, int]]:
        """Return for each level the size, the number of blocks, and of points with what fills up
        lanes."""
        found = []
        for size, first in zip(self.sizes, self.level_first, strict=True):
            n = np.diff(self.first[first])
            found.append((size, len(n), int((-(-n // LANES) * LANES).sum())))
        return found


class _PointSampler:
    """Draws positions in boxes around the points of blocks; rows are x, y, z and a cell."""

    def __init__(self, cells: PointCells, array: AntennaArray, rng: np.random.Generator) -> None:
        from scipy.spatial import cKDTree

        self.cells, self.rng, self.sizes = cells, rng, np.array(cells.sizes)
        antennas = cKDTree(np.concatenate([array.tx_m, array.rx_m]))
        middle_m = 0.5 * (cells.low_m + cells.high_m)
        nearest_m = antennas.query(middle_m)[1]
        all_m = np.concatenate([array.tx_m, array.rx_m])[nearest_m]
        out_m = all_m - np.clip(all_m, cells.low_m, cells.high_m)
        self._near = np.argsort((out_m**2).sum(axis=1), kind="stable")
        # Around the points of every block. What lies between them is sampled, too: interpolation is
        # bad beyond the samples, and a point far from the rest of its block is drawn too rarely.
        self._boxes_m = [
            (np.minimum.reduceat(cells.low_m, f[:-1]), np.maximum.reduceat(cells.high_m, f[:-1]))
            for f in cells.level_first
        ]
        # The outermost corners of boxes towards the faces, edges and corners of a cube.
        found = []
        for direction in np.indices((3, 3, 3)).reshape(3, -1).T - 1:
            corner_m = np.where(direction > 0, cells.high_m, cells.low_m)
            at = int((corner_m * direction).sum(axis=1).argmax())
            found.append(np.append(corner_m[at], at))
        self._outermost = np.array(found)

    def spread(self, n: int, level: int) -> np.ndarray:
        """Return n positions spread over the blocks of a level and over each of these blocks."""
        block = self.rng.integers(0, len(self._boxes_m[level][0]), n)
        return self._in_box(*self._boxes_m[level], block, self.cells.level_first[level][block])

    def corners(self, n: int) -> np.ndarray:
        """Return n of the outermost positions."""
        return self._outermost[self.rng.integers(0, len(self._outermost), n)]

    def near(self, n: int) -> np.ndarray:
        """Return n positions close to antennas: log-uniform in the rank of their cells."""
        rank = len(self._near) ** self.rng.random(n) - 1.0
        cell = self._near[rank.astype(int)]
        return self._in_box(self.cells.low_m, self.cells.high_m, cell, cell)

    def centres(self, voxel: np.ndarray, levels: int | slice) -> np.ndarray:
        """Return the centres of the blocks that positions are in, shape ([n_levels,] n, 3)."""
        return self.cells.centres_m(voxel[:, 3].astype(np.int64), self.sizes[levels, None])

    def metres(self, at: np.ndarray) -> np.ndarray:
        return at[..., :3]

    def _in_box(
        self, low_m: np.ndarray, high_m: np.ndarray, box: np.ndarray, cell: np.ndarray
    ) -> np.ndarray:
        """Return positions in some boxes, often at their ends, as rows with a cell of each."""
        share = self.rng.random((len(box), 3))
        ends = self.rng.random((len(box), 3)) < EXTREME
        share = np.where(ends, np.round(share), share)
        return np.column_stack([low_m[box] + share * (high_m - low_m)[box], cell])


@dataclass(frozen=True, eq=False)
class PointBlocks:
    """Some blocks of a level are an array of shape (n,), int: their numbers.

    Attributes
    ----------
    levels : tuple of BlockLevel
    cells : PointCells
    """

    levels: tuple[BlockLevel, ...]
    cells: PointCells

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """First points of the pieces of `MOST_POINTS` of all smallest blocks, and the number of
        points; and the block of each."""
        first = self.cells.first[self.cells.level_first[len(self.levels) - 1]]
        n_pieces = -(-np.diff(first) // MOST_POINTS)
        block = np.repeat(np.arange(len(n_pieces)), n_pieces)
        within = np.arange(len(block)) - np.repeat(np.cumsum(n_pieces) - n_pieces, n_pieces)
        return np.append(first[block] + MOST_POINTS * within, first[-1]), block

    @cached_property
    def _first_child(self) -> list[np.ndarray]:
        """For each level the first blocks of the next in its blocks, and how many those are."""
        firsts, last = self.cells.level_first, len(self.levels) - 1
        found = [np.searchsorted(firsts[i + 1], firsts[i]) for i in range(last)]
        if last > 0:
            found[-1] = np.searchsorted(self._pieces[1], found[-1])
        return found

    @property
    def counts(self) -> tuple[int, int, int]:
        return len(self.cells.order), 1, 1

    @property
    def diagonal_m(self) -> float:
        return self.cells.diagonal_m

    @property
    def n_leaves(self) -> int:
        return len(self._pieces[1])

    def top(self) -> np.ndarray:
        """Return the blocks of the first level."""
        return np.arange(self.n_leaves if len(self.levels) == 1 else 1)

    def children(self, i: int, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the blocks of level i + 1 in those of level i, and for each which one it is in."""
        first = self._first_child[i]
        n = first[index + 1] - first[index]
        parent = np.repeat(np.arange(len(index), dtype=np.int32), n)
        return np.arange(n.sum()) + np.repeat(first[index] - (np.cumsum(n) - n), n), parent

    def centres_m(self, i: int, index: np.ndarray) -> np.ndarray:
        """Return the centres of blocks of level i, shape (n, 3), float64."""
        block = self._pieces[1][index] if i == len(self.levels) - 1 else index
        cell = self.cells.level_first[i][block]
        return self.cells.centres_m(cell, np.array(self.levels[i].voxels))

    def leaf(self, width: int, far: bool) -> tuple[int, np.ndarray, np.ndarray]:
        """Return 0, all points' offsets from the float32 centres of their blocks, with as many more
        as a kernel may read beyond the last, and nothing."""
        planes = self._offsets_m[: 6 if far else 3]
        return 0, planes, np.zeros((1, 3), np.int32)

    @cached_property
    def _offsets_m(self) -> np.ndarray:
        """x, y, z as hi, then as lo, metres, float32."""
        first, index = self._pieces
        n_points, n = np.diff(first), len(self.cells.order)
        centre_m = self.centres_m(len(self.levels) - 1, np.arange(len(index))).astype(np.float32)
        planes = np.zeros((6, n + LANES), np.float32)
        for axis in range(3):
            offset_m = self.cells.columns_m[axis] - np.repeat(centre_m[:, axis], n_points)
            planes[axis, :n], planes[axis + 3, :n] = hi_lo(offset_m)
        return planes

    def most_voxels(self, index: np.ndarray) -> int:
        """Return the largest number of points of some smallest blocks."""
        first = self._pieces[0]
        return int((first[index + 1] - first[index]).max())

    def first(self, index: np.ndarray) -> np.ndarray:
        """Return the first point of smallest blocks, the one after the last, and 0."""
        first = self._pieces[0]
        return np.stack([first[index], first[index + 1], 0 * index], axis=1).astype(np.int32)

    def rest_m(self, exact_m: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
        """Return what offsets from the exact centres lack: nothing, they are from float32 ones."""
        return np.zeros_like(exact_m)


def point_blocks(
    array: AntennaArray, waveform: Waveform, points_m: np.ndarray, tolerance: float
) -> PointBlocks:
    """Return the blocks of points and their levels, see `clradar.imaging.block_tree`."""
    cells = PointCells(points_m, centre_wavelength_m(waveform))
    sampler = _PointSampler(cells, array, np.random.Generator(np.random.Philox(0)))
    levels = tree_levels(array, waveform, sampler, cells.level_counts(), STRICTER * tolerance)
    return PointBlocks(levels, cells)
