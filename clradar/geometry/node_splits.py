"""Splitting the nodes of one level of a tree in two, on a CPU device or by numpy: the same splits.

A GPU takes neither: its root would be one item that goes through all triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.opencl import Buffers, build

BLOCK = 8  # triangles per leaf in the kernels
BINS = 16  # bins along an axis, as in ``kernels/build.cl``
FLOAT_MAX = np.finfo(np.float32).max


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """Options of ``build.cl``."""

    width: int = 1
    block: int = BLOCK


class SplitsOnDevice:
    """Splits by ``build.cl``, one item per node.

    `boxes` has shape (n, 8), float32: -low x, y, z, 0, high x, y, z, 0, metres.
    """

    def __init__(self, boxes: np.ndarray, buffers: Buffers) -> None:
        n = len(boxes)
        most = n // BLOCK + 1  # nodes of a level have more than a block each
        self._program = build(buffers.device, "build.cl", BuildOptions())
        self._buffers, self._boxes = buffers, buffers.upload(boxes)
        self._order, self._scratch = (
            buffers.upload(np.arange(n, dtype=np.int32)),
            buffers.empty(4 * n),
        )
        self._start, self._count, self._left = (buffers.empty(4 * most) for _ in range(3))
        self._children, self._n = buffers.empty(64 * most), n

    def split(
        self, start: np.ndarray, count: np.ndarray, halve: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Split nodes, each of `count` slots of the order from `start` on, ascending.

        Each has more than `BLOCK` slots; `halve` splits by count instead of by the surface area
        heuristic. Returns the slots of the left child, which come first, int32, shape (m,), and the
        boxes of both children, float32, shape (m, 2, 2, 4).
        """
        m = len(start)
        self._buffers.write(self._start, start)
        self._buffers.write(self._count, count)
        self._program.launch(
            "split_nodes", (m,), np.uint32(m), np.uint32(halve), self._boxes, self._start,
            self._count, self._order, self._scratch, self._left, self._children,
        )  # fmt: skip
        n_left = self._buffers.read(self._left, m, np.int32)
        return n_left, self._buffers.read(self._children, (m, 2, 2, 4), np.float32)

    def order(self) -> np.ndarray:
        """The triangle at each slot, shape (n,), int32."""
        return self._buffers.read(self._order, self._n, np.int32)


class SplitsOnHost:
    """The same by numpy, where there is no CPU device."""

    def __init__(self, boxes: np.ndarray) -> None:
        self._boxes, self._order = boxes, np.arange(len(boxes), dtype=np.int32)

    def split(
        self, start: np.ndarray, count: np.ndarray, halve: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `SplitsOnDevice.split`."""
        before = np.cumsum(count) - count
        node = np.repeat(np.arange(len(count)), count)
        within = np.arange(len(node)) - before[node]
        slot = start[node] + within
        box = self._boxes[self._order[slot]]
        first = within < (count // 2)[node]
        if not halve:
            axis, plane, bins = _best_planes(box, node, before, len(count))
            by_plane = bins[axis[node], np.arange(len(node))] < plane[node]
            first = np.where(axis[node] < 0, first, by_plane)
        turn = np.argsort(2 * node + ~first, kind="stable")
        self._order[slot] = self._order[slot[turn]]
        n_left = np.add.reduceat(first, before, dtype=np.int32)
        both = np.stack([before, before + n_left], axis=1).ravel()
        children = np.maximum.reduceat(box[turn], both, axis=0)
        return n_left, children.reshape(-1, 2, 2, 4)

    def order(self) -> np.ndarray:
        """As `SplitsOnDevice.order`."""
        return self._order


def _best_planes(
    box: np.ndarray, node: np.ndarray, before: np.ndarray, n_nodes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axis (-1: none) and plane of the cheapest split of each node, shape (n_nodes,), and the bin
    of each box along each axis, shape (3, n)."""
    centre = box[:, 4:7] + -box[:, :3]
    low = np.minimum.reduceat(centre, before, axis=0)
    extent = np.maximum.reduceat(centre, before, axis=0) - low
    best = np.full(n_nodes, FLOAT_MAX, np.float32)
    axis, plane = np.full(n_nodes, -1), np.zeros(n_nodes, np.int64)
    bins = np.empty((3, len(box)), np.int8)
    with np.errstate(all="ignore"):
        scale = np.where(extent > 0, np.float32(BINS) / extent, np.float32(0))
        for k in range(3):
            at = (centre[:, k] - low[node, k]) * scale[node, k]
            bins[k] = np.where(at < BINS - 1, np.where(at > 0, at, 0), BINS - 1)
            held, boxes = _binned(box, node * BINS + bins[k], n_nodes)
            left = _costs(held, boxes)
            right = _costs(held[:, ::-1], boxes[:, ::-1])[:, ::-1]
            cost = left[:, :-1] + right[:, 1:]
            cheapest = cost.argmin(axis=1)
            least = cost[np.arange(n_nodes), cheapest]
            better = least < best
            best[better], axis[better], plane[better] = least[better], k, cheapest[better] + 1
    return axis, plane, bins


def _binned(box: np.ndarray, key: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """How many boxes are in each bin, shape (n_nodes, BINS), and the box around these, with 8."""
    turn = np.argsort(key, kind="stable")
    used, first = np.unique(key[turn], return_index=True)
    boxes = np.full((n_nodes * BINS, 8), -FLOAT_MAX, np.float32)
    boxes[used] = np.maximum.reduceat(box[turn], first, axis=0)
    held = np.bincount(key, minlength=n_nodes * BINS)
    return held.reshape(n_nodes, BINS), boxes.reshape(n_nodes, BINS, 8)


def _costs(held: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Cost of a leaf of each bin and all before it, shape (n_nodes, BINS)."""
    count, around = held.cumsum(axis=1), np.maximum.accumulate(boxes, axis=1)
    x, y, z = (around[..., i] + around[..., 4 + i] for i in range(3))
    blocks = ((count + BLOCK - 1) // BLOCK).astype(np.float32)
    return np.where(count > 0, (x * y + y * z + z * x) * blocks, FLOAT_MAX)
