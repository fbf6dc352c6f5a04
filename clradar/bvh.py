"""Bounding volume hierarchy: binned-SAH build, level by level in numpy, and its flat layout.

Every level of the tree is split at once with segmented numpy operations, so the work in Python is
proportional to the depth of the tree and not to its number of nodes.

References
----------
.. [1] I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on
   Interactive Ray Tracing 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import checks

WIDTH = 8
"""Children per node in the kernels."""

BLOCK = 8
"""Triangles per leaf in the kernels."""

EMPTY_M = 1e30
"""Bound of a box that holds nothing."""

BINS = 16
"""Candidate planes per axis and node."""

LEAF_ALWAYS = 8
"""A node with so few triangles is a leaf."""

LEAF_MOST = 8
"""A leaf has at most this many triangles; the layout allows 15."""

MEDIAN_BELOW_LEVEL = 40
"""From this depth on nodes are halved by count, which bounds the depth of any tree to this plus
log2 of the number of triangles."""

ERROR_ULPS = 32.0
"""Error bound of the triangle test, in 2^-24 of the scene's size (``kernels/common/bvh.h``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """A binary tree over triangles, in the layout of ``kernels/common/bvh.h`` but without padding.

    Attributes
    ----------
    nodes : ndarray, shape (n_nodes, 16), float32
        Boxes of both children and, as the bits of an int32, which they are.
    order : ndarray, shape (n_kept,), int32
        Face at each slot, in leaf order. Faces without area are left out: nothing hits them.
    depth : int
        Levels of inner nodes; a traversal stack of this many entries never overflows.
    """

    nodes: np.ndarray
    order: np.ndarray
    depth: int


def build_bvh(triangles_m: np.ndarray) -> Bvh:
    """Build the tree.

    Parameters
    ----------
    triangles_m : array_like, shape (n_faces, 3, 3), float32 or float64, metres
        Corners of every face. Degenerate and duplicate faces are allowed.

    Returns
    -------
    Bvh

    Raises
    ------
    ModelError
        Wrong shape, empty or NaN.
    """
    corners = checks.read_only("build_bvh: triangles_m", triangles_m, np.float32, (None, 3, 3))
    area = face_normals(corners)[1]
    kept = np.flatnonzero(area > 0).astype(np.int32)
    low = np.ascontiguousarray(corners[kept].min(axis=1).T)  # (3, n): each axis contiguous
    high = np.ascontiguousarray(corners[kept].max(axis=1).T)
    return _Builder(low, high).run(kept)


def face_normals(triangles_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit normals, shape (n, 3), and areas, shape (n,), square metres, in float64.

    A face whose area is below what its coordinates resolve (2^-40 of its longest edge squared)
    counts as degenerate: area 0 and normal 0.
    """
    corners = np.asarray(triangles_m, dtype=np.float64)
    e1 = corners[:, 1] - corners[:, 0]
    e2 = corners[:, 2] - corners[:, 0]
    normal = np.cross(e1, e2)
    twice = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    longest = np.maximum(np.einsum("ij,ij->i", e1, e1), np.einsum("ij,ij->i", e2, e2))
    real = twice > longest * 2.0**-40
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(real[:, None], normal / twice[:, None], 0.0)
    return unit, np.where(real, twice / 2.0, 0.0)


def error_bound_m(*points_m: np.ndarray) -> float:
    """Return delta, the error bound of the triangle test, metres (``kernels/common/bvh.h``).

    Parameters
    ----------
    points_m : arrays of shape (n, 3), metres
        Everything that a ray can start from or hit.
    """
    farthest = max(float(np.sqrt((p.reshape(-1, 3) ** 2).sum(axis=1).max())) for p in points_m)
    return ERROR_ULPS * 2.0**-24 * farthest


def flatten(
    bvh: Bvh, triangles_m: np.ndarray, delta_m: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return what the kernels read: padded nodes of eight children and blocks of triangles.

    Returns
    -------
    nodes : ndarray, shape (n_nodes, 64), float32
    triangles : ndarray, shape (n_blocks, 16, 8), float32
    stack : int
        Entries of the stack of a traversal that keeps all children that it still has to visit, in
        steps, so that scenes of similar depth share their programs.
    """
    low = np.concatenate([bvh.nodes[:, 0:3], bvh.nodes[:, 8:11]], axis=1).reshape(-1, 3)
    high = np.concatenate([bvh.nodes[:, 4:7], bvh.nodes[:, 12:15]], axis=1).reshape(-1, 3)
    refs = np.ascontiguousarray(bvh.nodes).view(np.int32)[:, [3, 7]].ravel()
    levels, most_kept = _widened(refs, _area(low.T, high.T))
    box = np.concatenate(levels)  # (n_nodes, WIDTH) indices into low, high and refs; -1: none
    inner = (box >= 0) & (refs[box] >= 0)
    filled = (box >= 0) & (refs[box] < -1)
    children = np.full(box.shape, _leaf(0, 0), dtype=np.int32)
    # Level by level, the inner children are the next nodes in the order in which they are met.
    children[inner] = np.arange(1, inner.sum() + 1)
    children[filled] = -1 - np.arange(filled.sum())
    leaf = -(refs[box[filled]] + 1)
    records = _records(bvh, leaf >> 4, leaf & 15, triangles_m)
    pad = np.float32(delta_m * (1 + 2.0**-10))
    far = np.float32(EMPTY_M)
    nodes = np.zeros((len(box), 8, WIDTH), dtype=np.float32)
    for axis in range(3):
        nodes[:, axis] = np.where(box >= 0, low[box, axis] - pad, far)
        nodes[:, 3 + axis] = np.where(box >= 0, high[box, axis] + pad, -far)
    nodes.view(np.int32)[:, 6] = children
    return nodes.reshape(-1, 8 * WIDTH), records, -(-most_kept // 16) * 16


def _widened(refs: np.ndarray, area: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Merge binary nodes into nodes of `WIDTH` children, the largest child opened first.

    Returns the children of every wide node, level by level, as indices of boxes (2 node + side, -1:
    none), and how many children a traversal may have to keep at a time.
    """
    cost = np.where(refs >= 0, area, -1.0)
    parents = np.zeros(1, dtype=np.int64)
    kept = np.zeros(1, dtype=np.int64)  # children that wait when a traversal comes to a node
    levels, stack = [], 0
    while len(parents):
        box = np.full((len(parents), WIDTH), -1)
        box[:, 0], box[:, 1] = 2 * parents, 2 * parents + 1
        rows = np.arange(len(parents))
        count = np.full(len(parents), 2)
        for used in range(2, WIDTH):
            costs = np.where(box[rows, :used] >= 0, cost[box[rows, :used]], -1.0)
            which = costs.argmax(axis=1)
            can = costs[np.arange(len(rows)), which] >= 0
            rows, which = rows[can], which[can]
            opened = refs[box[rows, which]]
            box[rows, which], box[rows, used] = 2 * opened, 2 * opened + 1
            count[rows] += 1
        levels.append(box)
        stack = max(stack, int((kept + count).max()))
        inner = (box >= 0) & (refs[box] >= 0)
        parents = refs[box[inner]]
        kept = np.repeat(kept + count - 1, inner.sum(axis=1))
    return levels, stack


def _records(bvh: Bvh, first: np.ndarray, count: np.ndarray, triangles_m: np.ndarray) -> np.ndarray:
    """Return the triangles of the leaves in blocks, as ``kernels/common/bvh.h`` lays them out."""
    out = np.zeros((max(len(first), 1), 16, BLOCK), dtype=np.float32)
    out[:, 14] = 1.0  # columns that are not used
    block = np.repeat(np.arange(len(first)), count)
    column = _places(np.zeros_like(first), count)
    faces = bvh.order[_places(first, count)]
    corners = np.asarray(triangles_m, dtype=np.float32)[faces].astype(np.float64)
    e1 = corners[:, 1] - corners[:, 0]
    e2 = corners[:, 2] - corners[:, 0]
    normal = np.cross(e1, e2)
    rows = np.empty((len(faces), 16), dtype=np.float32)
    rows[:, 0:3], rows[:, 3:6], rows[:, 6:9], rows[:, 9:12] = corners[:, 0], e1, e2, normal
    rows[:, 12], rows[:, 13] = np.linalg.norm(e1, axis=1), np.linalg.norm(e2, axis=1)
    rows[:, 14] = np.linalg.norm(normal, axis=1) * 2.0**-21
    rows[:, 15] = faces.view(np.float32)
    out[block, :, column] = rows
    return out


class _Builder:
    """State of one build: for each axis, the primitives sorted along it, grouped by open node."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low, self.high = low, high
        self.centroid = 0.5 * (low + high)
        self.side = np.zeros(low.shape[1], dtype=bool)
        self.slots: list[np.ndarray] = []
        self.n_slots = 0

    def run(self, kept: np.ndarray) -> Bvh:
        n = len(kept)
        empty = _empty_box()
        root = np.zeros((1, 16), dtype=np.float32)
        _set_child(root, np.array([0]), 1, empty, np.array([_leaf(0, 0)]))
        if n <= LEAF_ALWAYS:
            box = _box(self.low.min(axis=1), self.high.max(axis=1)) if n else empty
            _set_child(root, np.array([0]), 0, box, np.array([_leaf(0, n)]))
            return Bvh(root, kept, 1)

        orders = [np.argsort(self.centroid[axis], kind="stable") for axis in range(3)]
        starts, counts = np.array([0]), np.array([n])
        levels: list[np.ndarray] = []
        n_nodes, depth = 1, 0
        while len(starts):
            depth += 1
            nodes = np.zeros((len(starts), 16), dtype=np.float32)
            n_left = self._split(orders, starts, counts, median=depth > MEDIAN_BELOW_LEVEL)
            child_starts = np.stack([starts, starts + n_left], axis=1).ravel()
            child_counts = np.stack([n_left, counts - n_left], axis=1).ravel()
            boxes = np.concatenate(self._bounds(orders[0], child_starts)).T
            is_leaf = child_counts <= LEAF_ALWAYS
            maybe = np.flatnonzero(~is_leaf & (child_counts <= LEAF_MOST))
            is_leaf[maybe] = self._cheaper_as_leaf(orders[0], child_starts, child_counts, maybe)
            refs = np.empty(len(child_starts), dtype=np.int32)
            inner = np.flatnonzero(~is_leaf)
            refs[inner] = n_nodes + np.arange(len(inner))
            leaves = np.flatnonzero(is_leaf)
            firsts = self.n_slots + np.cumsum(child_counts[leaves]) - child_counts[leaves]
            refs[leaves] = _leaf(firsts, child_counts[leaves])
            self._emit(orders[0], child_starts[leaves], child_counts[leaves])
            rows = np.arange(len(starts))
            for child in (0, 1):
                _set_child(nodes, rows, child, boxes[child::2], refs[child::2])
            levels.append(nodes)
            n_nodes += len(inner)
            starts, counts = self._compact(orders, child_starts[inner], child_counts[inner])
        return Bvh(np.concatenate(levels), kept[np.concatenate(self.slots)], depth)

    def _split(
        self, orders: list[np.ndarray], starts: np.ndarray, counts: np.ndarray, median: bool
    ) -> np.ndarray:
        """Partition every segment of `orders` in two; return the size of the first parts."""
        m = len(starts)
        segment = np.repeat(np.arange(m), counts)
        best_cost = np.full(m, np.inf)
        best_axis = np.zeros(m, dtype=np.int64)
        best_left = counts // 2  # by count along x, where no plane separates the centroids
        if not median:
            for axis in range(3):
                cost, n_left = self._best_plane(orders[axis], axis, starts, counts, segment)
                better = cost < best_cost
                best_cost = np.where(better, cost, best_cost)
                best_axis = np.where(better, axis, best_axis)
                best_left = np.where(better, n_left, best_left)
        rank = np.arange(len(segment)) - starts[segment]
        for axis in range(3):
            mine = (best_axis == axis)[segment]
            self.side[orders[axis][mine]] = (rank >= best_left[segment])[mine]
        for axis in range(3):
            right = self.side[orders[axis]]
            before = np.cumsum(~right) - ~right  # how many go left before this one, overall
            left_rank = before - before[starts][segment]
            target = starts[segment] + np.where(
                right, best_left[segment] + rank - left_rank, left_rank
            )
            moved = np.empty_like(orders[axis])
            moved[target] = orders[axis]
            orders[axis] = moved
        return best_left

    def _best_plane(
        self,
        order: np.ndarray,
        axis: int,
        starts: np.ndarray,
        counts: np.ndarray,
        segment: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the cost of the best of the binned planes of every segment and its left count."""
        m = len(starts)
        position = self.centroid[axis][order]
        first, last = position[starts], position[starts + counts - 1]
        extent = last - first
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            scale = np.where(extent > 0, BINS / extent, 0.0)
            bins = ((position - first[segment]) * scale[segment]).astype(np.int64)
        np.clip(bins, 0, BINS - 1, out=bins)
        key = segment * BINS + bins
        runs = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        filled = key[runs]
        amount = np.zeros((m, BINS), dtype=np.int64)
        amount.reshape(-1)[filled] = np.diff(np.append(runs, len(key)))
        lows = np.full((3, m, BINS), np.inf, dtype=np.float32)
        highs = np.full((3, m, BINS), -np.inf, dtype=np.float32)
        for k in range(3):
            lows[k].reshape(-1)[filled] = np.minimum.reduceat(self.low[k][order], runs)
            highs[k].reshape(-1)[filled] = np.maximum.reduceat(self.high[k][order], runs)
        left_area = _area(
            np.minimum.accumulate(lows, axis=2), np.maximum.accumulate(highs, axis=2)
        )[:, :-1]
        right_area = _area(
            np.minimum.accumulate(lows[:, :, ::-1], axis=2),
            np.maximum.accumulate(highs[:, :, ::-1], axis=2),
        )[:, ::-1][:, 1:]
        n_left = np.cumsum(amount, axis=1)[:, :-1]
        n_right = counts[:, None] - n_left
        cost = np.where(
            (n_left > 0) & (n_right > 0), left_area * n_left + right_area * n_right, np.inf
        )
        best = cost.argmin(axis=1)
        rows = np.arange(m)
        return cost[rows, best], n_left[rows, best]

    def _cheaper_as_leaf(
        self, order: np.ndarray, starts: np.ndarray, counts: np.ndarray, which: np.ndarray
    ) -> np.ndarray:
        """Whether testing all triangles of a small segment costs no more than one more split."""
        if not len(which):
            return np.zeros(0, dtype=bool)
        count = counts[which]
        members = order[_places(starts[which], count)]
        begins = np.cumsum(count) - count
        whole = _area(*self._bounds(members, begins))
        both = np.stack([begins, begins + count // 2], axis=1).ravel()
        halves = _area(*self._bounds(members, both)).reshape(-1, 2)
        amounts = np.stack([count // 2, count - count // 2], axis=1)
        # One node visit costs about as much as one triangle.
        return whole * count <= whole + (halves * amounts).sum(axis=1)

    def _bounds(self, order: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the low and the high corner of every segment's box, shape (3, n_segments) each."""
        low = np.stack([np.minimum.reduceat(self.low[k][order], starts) for k in range(3)])
        high = np.stack([np.maximum.reduceat(self.high[k][order], starts) for k in range(3)])
        return low, high

    def _emit(self, order: np.ndarray, starts: np.ndarray, counts: np.ndarray) -> None:
        if not len(starts):
            return
        self.slots.append(order[_places(starts, counts)])
        self.n_slots += int(counts.sum())

    def _compact(
        self, orders: list[np.ndarray], starts: np.ndarray, counts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keep only the open segments in `orders`; return their new places."""
        if not len(starts):
            return starts, counts
        picked = _places(starts, counts)
        for axis in range(3):
            orders[axis] = orders[axis][picked]
        return np.cumsum(counts) - counts, counts


def _places(starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the indices of all members of the segments, one segment after the other."""
    first = np.cumsum(counts) - counts
    return np.repeat(starts - first, counts) + np.arange(counts.sum())


def _area(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surface of boxes, shape of one axis; empty boxes (low > high) have none."""
    size = np.maximum(high - low, 0)
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


def _empty_box() -> np.ndarray:
    far = np.float32(EMPTY_M)
    return np.array([[far, far, far, -far, -far, -far]], dtype=np.float32)


def _box(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.concatenate([low, high])[None].astype(np.float32)


def _leaf(first: Any, count: Any) -> Any:
    return -(first * 16 + count) - 1


def _set_child(
    nodes: np.ndarray, rows: np.ndarray, child: int, boxes: np.ndarray, refs: np.ndarray
) -> None:
    at = 8 * child
    nodes[rows, at : at + 3] = boxes[:, :3]
    nodes[rows, at + 4 : at + 7] = boxes[:, 3:]
    nodes.view(np.int32)[rows, (3, 7)[child]] = refs
