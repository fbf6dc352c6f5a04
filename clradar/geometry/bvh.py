"""Bounding volume hierarchy: a binary tree, split level by level by the binned surface area
heuristic [1]_, and collapsed into the 8-wide nodes that the kernels traverse [2]_.

References
----------
.. [1] I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on
   Interactive Ray Tracing 2007.
.. [2] H. Ylitie, T. Karras and S. Laine, "Efficient incoherent ray traversal on GPUs through
   compressed wide BVHs", High-Performance Graphics 2017, section 3.1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clradar.errors import DeviceError, quoted, warn
from clradar.geometry.node_splits import BLOCK, SplitsOnDevice, SplitsOnHost
from clradar.geometry.watertight import outward_side
from clradar.model import checks
from clradar.opencl import Buffers, Device, cpu_beside
from clradar.opencl.program import private_length

CHILDREN = 8  # children per node in the kernels
NODE_ROWS, TRIANGLE_ROWS = 8, 12
"""Numbers per child of a node and per triangle of a block in the kernels."""

EMPTY_M = 1e30  # bound of a box that holds nothing
MEDIAN_BELOW_LEVEL = 40
"""From this depth on nodes are halved by count, which bounds the depth of any tree to this plus
log2 of the number of triangles."""

RAY_WORK = 2000.0  # operations, roughly, of a ray through the tree: some 8 nodes and 2 leaves
ERROR_ULPS = 32.0
"""Error bound of the triangle test, in 2^-24 of the scene's size (``kernels/common/bvh.h``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """A binary tree over triangles: root 0; children 2 i and 2 i + 1 belong to node i."""

    low: np.ndarray  # (2 n_nodes, 3), float32, metres: boxes of the children, without padding
    high: np.ndarray  # low > high where there is none
    child: np.ndarray  # (2 n_nodes,), int32: inner node, or -(16 first + count) - 1: a leaf's slots
    order: np.ndarray  # (n_kept,), int32: face at each slot, by leaves; none without area
    depth: int  # levels of inner nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class TraversalOptions:
    """Options of the kernels that include ``common/bvh.h``."""

    nvidia_registers: ClassVar[int] = 96  # without spills (`make gpucheck`)
    width: int
    wide: bool
    stack: int
    children: int = CHILDREN
    block: int = BLOCK
    node_rows: int = NODE_ROWS
    triangle_rows: int = TRIANGLE_ROWS


def build_bvh(triangles_m: np.ndarray, device: Device) -> Bvh:
    """Build the tree of triangles (n_faces, 3, 3), metres; it is the same for every device.

    It is built on a CPU device of this machine, beside a GPU else by numpy. Degenerate and
    duplicate faces are allowed; a wrong shape, none, or NaN is a `ModelError`.
    """
    corners = checks.read_only("build_bvh: triangles_m", triangles_m, np.float32, (None, 3, 3))
    kept = np.flatnonzero(face_normals(corners)[1] > 0).astype(np.int32)
    n = len(kept)
    # As (-low, high), so that the box around two is the larger of each component.
    boxes = np.zeros((n, 2, 4), dtype=np.float32)
    boxes[:, 0, :3] = -np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])[kept]
    boxes[:, 1, :3] = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])[kept]
    if n > BLOCK:
        levels, order = _nodes(boxes.reshape(n, 8), device)
    else:
        root = np.full((1, 2, 2, 4), -EMPTY_M, dtype=np.float32)
        if n:
            root[0, 0] = boxes.max(axis=0)
        levels, order = [(root, np.array([[_leaf(0, n), _leaf(0, 0)]]))], np.arange(n)
    both, child = (np.concatenate(parts) for parts in zip(*levels, strict=True))
    low, high = -both[:, :, 0, :3].reshape(-1, 3), both[:, :, 1, :3].reshape(-1, 3)
    return Bvh(low, high, child.ravel().astype(np.int32), kept[order], len(levels))


def _nodes(
    boxes: np.ndarray, device: Device
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """The nodes of `_split_all`, on the CPU beside the device where that works."""
    cpu = cpu_beside(device)
    if cpu is not None:
        try:
            with Buffers(cpu) as buffers:
                return _split_all(len(boxes), SplitsOnDevice(boxes, buffers))
        except DeviceError as error:
            if cpu is device:
                raise
            warn(f"{quoted(error)}; numpy builds the tree instead")
    return _split_all(len(boxes), SplitsOnHost(boxes))


def _split_all(
    n: int, splits: SplitsOnDevice | SplitsOnHost
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Boxes and children of the nodes of every level, and the triangles in the order of leaves."""
    start, count = np.zeros(1, dtype=np.int32), np.full(1, n, dtype=np.int32)
    levels: list[tuple[np.ndarray, np.ndarray]] = []
    n_nodes = 1
    while len(start):
        n_left, both = splits.split(start, count, len(levels) >= MEDIAN_BELOW_LEVEL)
        starts = np.stack([start, start + n_left], axis=1)
        counts = np.stack([n_left, count - n_left], axis=1)
        inner = counts > BLOCK
        child = _leaf(starts, counts)
        child[inner] = n_nodes + np.arange(inner.sum())
        levels.append((both, child))
        n_nodes += int(inner.sum())
        start, count = starts[inner], counts[inner]
    return levels, splits.order()


def face_normals(triangles_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals, shape (n, 3), and areas, shape (n,), square metres, in float64.

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
    """Error bound delta of the triangle test, metres (``kernels/common/bvh.h``).

    Parameters
    ----------
    points_m : arrays of shape (n, 3), metres
        All vertices and antennas.
    """
    farthest = max(float(np.sqrt((p.reshape(-1, 3) ** 2).sum(axis=1).max())) for p in points_m)
    return ERROR_ULPS * 2.0**-24 * farthest


@dataclass(frozen=True, slots=True, eq=False)
class MeshTree:
    """A mesh and its tree on a device, in the layout of ``kernels/common/bvh.h``."""

    buffers: list[Any]  # of nodes and of triangles
    wide: bool  # kernels traverse it eight boxes at a time, as a CPU does
    stack: int  # entries of the stack of a traversal
    delta_m: np.float32  # error bound of the triangle test

    @property
    def traversal(self) -> dict[str, Any]:
        """Its fields of `TraversalOptions`."""
        return {"wide": self.wide, "stack": self.stack}


def upload_tree(
    triangles_m: np.ndarray, ends_m: Iterable[np.ndarray], buffers: Buffers
) -> MeshTree:
    """Build the tree of a mesh for rays between it and `ends_m`, shapes (n, 3), metres."""
    delta_m = np.float32(error_bound_m(triangles_m, *ends_m))
    bvh = build_bvh(triangles_m, buffers.device)
    nodes, triangles, most_kept, levels = flatten(bvh, triangles_m, float(delta_m))
    wide = buffers.device.width == 8
    stack = private_length(most_kept if wide else levels, 16 if wide else 8, buffers.device)
    return MeshTree([buffers.upload(nodes), buffers.upload(triangles)], wide, stack, delta_m)


def flatten(
    bvh: Bvh, triangles_m: np.ndarray, delta_m: float
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Lay out what the kernels read: nodes of eight padded boxes and blocks of triangles.

    Returns nodes, float32, shape (n_nodes, NODE_ROWS * CHILDREN); triangles, float32, shape
    (n_blocks * (TRIANGLE_ROWS + 1) * BLOCK,); and how many children wait at most in a traversal
    that keeps each that it still has to visit, and how many nodes are above a leaf at most.
    """
    low, high, child = bvh.low, bvh.high, bvh.child
    levels, most_kept = _collapsed(child, _area(low.T, high.T))
    box = np.concatenate(levels)  # (n_nodes, CHILDREN) indices into low, high and child; -1: none
    inner = (box >= 0) & (child[box] >= 0)
    filled = (box >= 0) & (child[box] < -1)
    if not filled.any():
        filled[0, 0] = True  # an empty block for the children to point to
    children = np.full(box.shape, _leaf(0, 0), dtype=np.int32)
    # Level by level, the inner children are the next nodes in the order in which they are met.
    children[inner] = np.arange(1, inner.sum() + 1)
    children[filled] = -1 - np.arange(filled.sum())
    leaf = -(child[box[filled]] + 1)
    records = _records(bvh, leaf >> 4, leaf & 15, triangles_m)
    pad = np.float32(delta_m * (1 + 2.0**-10))
    far = np.float32(EMPTY_M)
    nodes = np.zeros((len(box), NODE_ROWS, CHILDREN), dtype=np.float32)
    for axis in range(3):
        nodes[:, 1 + axis] = np.where(box >= 0, low[box, axis] - pad, far)
        nodes[:, 4 + axis] = np.where(box >= 0, high[box, axis] + pad, -far)
    nodes.view(np.int32)[:, 0] = children
    nodes.view(np.int32)[0, 7, 0] = len(leaf)
    nodes[0, 7, 1] = outward_side(np.asarray(triangles_m, dtype=np.float32))
    nodes[0, 7, 2:5], nodes[0, 7, 5:8] = nodes[0, 1:4].min(axis=1), nodes[0, 4:7].max(axis=1)
    return nodes.reshape(len(box), -1), records, most_kept, len(levels)


def _collapsed(child: np.ndarray, area: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Collapse a binary tree into nodes of up to `CHILDREN` with the least surface area in all.

    `child` as in `Bvh`, shape (2 n_nodes,), with the `area` of its box. Returns the children of
    every wide node, shape (n, CHILDREN), level by level, as indices into `child`, -1 for none; and
    how many children a traversal may have to keep at a time.
    """
    columns_left = _optimal_collapse(child, area)
    parents = np.zeros(1, dtype=np.int64)
    waiting = np.zeros(1, dtype=np.int64)  # children that wait when a traversal comes to a node
    levels, most = [], 0
    while len(parents):
        # A child, and how many columns it may still be opened into, beginning at its own.
        wide = np.full((len(parents), CHILDREN), -1)
        columns = np.zeros((len(parents), CHILDREN), dtype=np.int64)
        row, column = np.arange(len(parents)), np.zeros(len(parents), dtype=np.int64)
        node, width = parents, np.full(len(parents), CHILDREN)
        while len(row):
            left = columns_left[width, node]
            row, column, node, width, left = (a[left > 0] for a in (row, column, node, width, left))
            for side, at, n_left in ((0, column, left), (1, column + left, width - left)):
                wide[row, at], columns[row, at] = 2 * node + side, n_left
            row, column = np.nonzero((columns > 1) & (child[wide] >= 0))
            node, width = child[wide[row, column]], columns[row, column]
            columns[row, column] = 0
        levels.append(wide)
        count = (wide >= 0).sum(axis=1)
        most = max(most, int((waiting + count).max()))
        inner = (wide >= 0) & (child[wide] >= 0)
        parents = child[wide[inner]]
        waiting = np.repeat(waiting + count - 1, inner.sum(axis=1))
    return levels, most


def _optimal_collapse(child: np.ndarray, area: np.ndarray) -> np.ndarray:
    """SAH-optimal collapse into an 8-wide BVH, by dynamic programming from the leaves up [2]_.

    Shape (CHILDREN + 1, n_nodes): of that many columns for a binary node, how many go to its left
    child; 0: it takes one, as a wide node of its own.
    """
    inner = np.flatnonzero(child >= 0)
    above = np.zeros(len(child) // 2, dtype=np.int64)  # which child a node is
    above[child[inner]] = inner
    starts = [0, 1]  # of the levels: a node's children come in the next one
    while starts[-1] < len(above):
        starts.append(starts[-1] + int((child[2 * starts[-2] : 2 * starts[-1]] >= 0).sum()))
    cost = np.tile(area, (CHILDREN + 1, 1))  # of a child by its columns; a leaf takes one
    columns_left = np.zeros((CHILDREN + 1, len(above)), dtype=np.int8)
    for start, stop in zip(starts[-2::-1], starts[:0:-1], strict=True):
        left, right = cost[:, 2 * start : 2 * stop : 2], cost[:, 2 * start + 1 : 2 * stop : 2]
        opened = np.full((CHILDREN + 1, stop - start), np.inf, dtype=cost.dtype)
        for width in range(2, CHILDREN + 1):
            for n_left in range(1, width):
                sum_ = left[n_left] + right[width - n_left]
                better = sum_ < opened[width]
                opened[width][better] = sum_[better]
                columns_left[width, start:stop][better] = n_left
        alone = area[above[start:stop]] + opened[CHILDREN]
        columns_left[2:CHILDREN, start:stop][alone <= opened[2:CHILDREN]] = 0
        cost[1:, above[start:stop]] = np.minimum(alone, opened[1:])
    return columns_left


def _records(bvh: Bvh, first: np.ndarray, count: np.ndarray, triangles_m: np.ndarray) -> np.ndarray:
    """Triangles of the leaves in blocks, and their faces after all blocks."""
    column = np.arange(BLOCK)
    used = column < count[:, None]
    order = bvh.order if len(bvh.order) else np.zeros(1, dtype=np.int32)
    faces = np.where(used, order[np.where(used, first[:, None] + column, 0)], -1)
    corners = np.asarray(triangles_m, dtype=np.float32)[faces].transpose(2, 3, 0, 1)
    v0, v1, v2 = np.where(used, corners, np.float32(0)).astype(np.float64)
    e1, e2 = v1 - v0, v2 - v0
    out = np.empty(len(first) * (TRIANGLE_ROWS + 1) * BLOCK, dtype=np.float32)
    blocks = out[: len(first) * TRIANGLE_ROWS * BLOCK].reshape(-1, TRIANGLE_ROWS, BLOCK)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for row, value in ((0, v0), (3, e1), (6, e2)):
            blocks[:, row + axis] = value[axis]
        blocks[:, 9 + axis] = e1[i] * e2[j] - e1[j] * e2[i]
    out[len(first) * TRIANGLE_ROWS * BLOCK :] = faces.astype(np.int32).view(np.float32).ravel()
    return out


def _area(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surface of boxes, shape of one axis; empty boxes (low > high) have none."""
    size = np.maximum(high - low, 0)
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


def _leaf(first: Any, count: Any) -> Any:
    return -(first * 16 + count) - 1
