"""Bounding volume hierarchy: built level by level on a device [1]_, then merged and laid out flat.

References
----------
.. [1] I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on
   Interactive Ray Tracing 2007.
.. [2] I. Wald, C. Benthin and S. Boulos, "Getting rid of packets: efficient SIMD single-ray
   traversal using multi-branching BVHs", IEEE Symposium on Interactive Ray Tracing 2008.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.geometry.watertight import outward_side
from clradar.model import checks
from clradar.opencl import Buffers, Device, build

WIDTH = 8
"""Children per node in the kernels."""

BLOCK = 8
"""Triangles per leaf in the kernels."""

ROWS = 12
"""Floats per triangle in a block."""

EMPTY_M = 1e30
"""Bound of a box that holds nothing."""

EMPTY = np.full((1, 2, 4), -EMPTY_M, dtype=np.float32)
"""That box, as (-low, high)."""

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


@dataclass(frozen=True, slots=True)
class _BuildOptions:
    width: int


def build_bvh(triangles_m: np.ndarray, device: Device) -> Bvh:
    """Build the tree; it is the same on every device.

    Parameters
    ----------
    triangles_m : array_like, shape (n_faces, 3, 3), float32 or float64, metres
        Corners of every face. Degenerate and duplicate faces are allowed.
    device : Device

    Returns
    -------
    Bvh

    Raises
    ------
    ModelError
        Wrong shape, empty or NaN.
    """
    corners = checks.read_only("build_bvh: triangles_m", triangles_m, np.float32, (None, 3, 3))
    kept = np.flatnonzero(face_normals(corners)[1] > 0).astype(np.int32)
    n = len(kept)
    boxes = np.zeros((n, 2, 4), dtype=np.float32)
    boxes[:, 0, :3] = -np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])[kept]
    boxes[:, 1, :3] = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])[kept]
    if n <= BLOCK:
        root = np.zeros((1, 16), dtype=np.float32)
        _set_child(root, 0, boxes.max(axis=0, keepdims=True) if n else EMPTY, np.array(_leaf(0, n)))
        _set_child(root, 1, EMPTY, np.array(_leaf(0, 0)))
        return Bvh(root, kept, 1)
    with Buffers(device) as buffers:
        nodes, order = _split_all(boxes.reshape(n, 8), device, buffers)
    return Bvh(np.concatenate(nodes), kept[order], len(nodes))


def _split_all(
    boxes: np.ndarray, device: Device, buffers: Buffers
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the nodes of every level, and the triangles in the order of the leaves."""
    program = build(device, "build.cl", _BuildOptions(1))
    n = len(boxes)
    most = n // BLOCK + 1  # nodes of a level have more than a block each
    put = buffers.upload(boxes)
    order, scratch = buffers.upload(np.arange(n, dtype=np.int32)), buffers.empty(4 * n)
    start_at, count_at, left_at = (buffers.empty(4 * most) for _ in range(3))
    children_at = buffers.empty(64 * most)
    start, count = np.zeros(1, dtype=np.int32), np.full(1, n, dtype=np.int32)
    levels: list[np.ndarray] = []
    n_nodes = 1
    while len(start):
        m = len(start)
        buffers.write(start_at, start)
        buffers.write(count_at, count)
        program.launch(
            "split_nodes", (m,), np.uint32(m), np.uint32(len(levels) >= MEDIAN_BELOW_LEVEL), put,
            start_at, count_at, order, scratch, left_at, children_at,
        )  # fmt: skip
        n_left = buffers.read(left_at, m, np.int32)
        children = buffers.read(children_at, (m, 2, 2, 4), np.float32)
        starts = np.stack([start, start + n_left], axis=1)
        counts = np.stack([n_left, count - n_left], axis=1)
        inner = counts > BLOCK
        refs = _leaf(starts, counts)
        refs[inner] = n_nodes + np.arange(inner.sum())
        nodes = np.zeros((m, 16), dtype=np.float32)
        for side in (0, 1):
            _set_child(nodes, side, children[:, side], refs[:, side])
        levels.append(nodes)
        n_nodes += int(inner.sum())
        start, count = starts[inner], counts[inner]
    return levels, buffers.read(order, n, np.int32)


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
    triangles : ndarray, shape (n_blocks * 104,), float32
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
    if not filled.any():
        filled[0, 0] = True  # a block of nothing, so that there is something to point to
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
        nodes[:, 1 + axis] = np.where(box >= 0, low[box, axis] - pad, far)
        nodes[:, 4 + axis] = np.where(box >= 0, high[box, axis] + pad, -far)
    nodes.view(np.int32)[:, 0] = children
    nodes.view(np.int32)[0, 7, 0] = len(leaf)
    nodes[0, 7, 1] = outward_side(np.asarray(triangles_m, dtype=np.float32))
    nodes[0, 7, 2:5], nodes[0, 7, 5:8] = nodes[0, 1:4].min(axis=1), nodes[0, 4:7].max(axis=1)
    return nodes.reshape(-1, 8 * WIDTH), records, -(-most_kept // 16) * 16


def _widened(refs: np.ndarray, area: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Merge binary nodes into nodes of up to `WIDTH` children so that their areas add up to least.

    Parameters
    ----------
    refs : ndarray, shape (2 n_nodes,), int32
        What each child is, in the order of `Bvh.nodes`.
    area : ndarray, shape (2 n_nodes,)
        Of its box.

    Returns
    -------
    levels : list of ndarray, shape (n, WIDTH)
        The children of every wide node, level by level, as indices into `refs`; -1: none.
    most : int
        How many children a traversal may have to keep at a time.
    """
    shares = _best_shares(refs, area)
    parents = np.zeros(1, dtype=np.int64)
    waiting = np.zeros(1, dtype=np.int64)  # children that wait when a traversal comes to a node
    levels, most = [], 0
    while len(parents):
        # A child, and how many columns it may still be opened into, beginning at its own.
        child = np.full((len(parents), WIDTH), -1)
        columns = np.zeros((len(parents), WIDTH), dtype=np.int64)
        row, column = np.arange(len(parents)), np.zeros(len(parents), dtype=np.int64)
        node, width = parents, np.full(len(parents), WIDTH)
        while len(row):
            left = shares[width, node]
            row, column, node, width, left = (a[left > 0] for a in (row, column, node, width, left))
            for side, at, share in ((0, column, left), (1, column + left, width - left)):
                child[row, at], columns[row, at] = 2 * node + side, share
            row, column = np.nonzero((columns > 1) & (refs[child] >= 0))
            node, width = refs[child[row, column]], columns[row, column]
            columns[row, column] = 0
        levels.append(child)
        count = (child >= 0).sum(axis=1)
        most = max(most, int((waiting + count).max()))
        inner = (child >= 0) & (refs[child] >= 0)
        parents = refs[child[inner]]
        waiting = np.repeat(waiting + count - 1, inner.sum(axis=1))
    return levels, most


def _best_shares(refs: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Return what is best for every binary node that may take 2 to `WIDTH` columns.

    Shape (WIDTH + 1, n_nodes): how many of that many columns go to its left child; 0: it takes one,
    as a wide node of its own. Found from the leaves up [2]_.
    """
    inner = np.flatnonzero(refs >= 0)
    above = np.zeros(len(refs) // 2, dtype=np.int64)  # which child a node is
    above[refs[inner]] = inner
    starts = [0, 1]  # of the levels: a node's children come in the next one
    while starts[-1] < len(above):
        starts.append(starts[-1] + int((refs[2 * starts[-2] : 2 * starts[-1]] >= 0).sum()))
    cost = np.tile(area, (WIDTH + 1, 1))  # of a child by its columns; a leaf takes one
    shares = np.zeros((WIDTH + 1, len(above)), dtype=np.int8)
    for start, stop in zip(starts[-2::-1], starts[:0:-1], strict=True):
        left, right = cost[:, 2 * start : 2 * stop : 2], cost[:, 2 * start + 1 : 2 * stop : 2]
        opened = np.full((WIDTH + 1, stop - start), np.inf, dtype=cost.dtype)
        for width in range(2, WIDTH + 1):
            for share in range(1, width):
                sum_ = left[share] + right[width - share]
                better = sum_ < opened[width]
                opened[width][better] = sum_[better]
                shares[width, start:stop][better] = share
        alone = area[above[start:stop]] + opened[WIDTH]
        shares[2:WIDTH, start:stop][alone <= opened[2:WIDTH]] = 0
        cost[1:, above[start:stop]] = np.minimum(alone, opened[1:])
    return shares


def _records(bvh: Bvh, first: np.ndarray, count: np.ndarray, triangles_m: np.ndarray) -> np.ndarray:
    """Return the triangles of the leaves in blocks, and their faces after all blocks."""
    column = np.arange(BLOCK)
    used = column < count[:, None]
    order = bvh.order if len(bvh.order) else np.zeros(1, dtype=np.int32)
    faces = np.where(used, order[np.where(used, first[:, None] + column, 0)], -1)
    corners = np.asarray(triangles_m, dtype=np.float32)[faces].transpose(2, 3, 0, 1)
    v0, v1, v2 = np.where(used, corners, np.float32(0)).astype(np.float64)
    e1, e2 = v1 - v0, v2 - v0
    out = np.empty(len(first) * (ROWS + 1) * BLOCK, dtype=np.float32)
    blocks = out[: len(first) * ROWS * BLOCK].reshape(-1, ROWS, BLOCK)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for row, value in ((0, v0), (3, e1), (6, e2)):
            blocks[:, row + axis] = value[axis]
        blocks[:, 9 + axis] = e1[i] * e2[j] - e1[j] * e2[i]
    out[len(first) * ROWS * BLOCK :] = faces.astype(np.int32).view(np.float32).ravel()
    return out


def _area(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surface of boxes, shape of one axis; empty boxes (low > high) have none."""
    size = np.maximum(high - low, 0)
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


def _leaf(first: Any, count: Any) -> Any:
    return -(first * 16 + count) - 1


def _set_child(nodes: np.ndarray, side: int, boxes: np.ndarray, refs: np.ndarray) -> None:
    """Write one child of each node: its box, given as (-low, high), and what it is."""
    at = 8 * side
    nodes[:, at : at + 3] = -boxes[:, 0, :3]
    nodes[:, at + 4 : at + 7] = boxes[:, 1, :3]
    nodes.view(np.int32)[:, (3, 7)[side]] = refs
