"""The node hierarchy of a glTF 2.0 file: parents, and global transforms (section 3.5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.rigs.failures import fail, index


@dataclass(frozen=True, slots=True, eq=False)
class NodeTree:
    """Nodes with their parents and global transforms.

    Attributes
    ----------
    names : tuple of str
        As the file has them; a node without a name is called ``node N``.
    parents : tuple of int
        -1 for a root.
    world : ndarray, shape (N, 4, 4), float64
        From each node's own coordinates to the scene's, in the file's unit.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    world: np.ndarray

    def label(self, node: int) -> str:
        """Return a node's name for messages."""
        return f"'{self.names[node]}' (node {node})"

    def nearest_of(self, wanted: dict[int, int]) -> list[int | None]:
        """Return for every node the value of `wanted` for it or its nearest ancestor there."""
        found: list[int | None] = [None] * len(self.names)
        for node in _from_roots(self.parents):
            parent = self.parents[node]
            above = None if parent < 0 else found[parent]
            found[node] = wanted.get(node, above)
        return found


def _from_roots(parents: Sequence[int]) -> list[int]:
    """Return all nodes, each after its parent."""
    children: dict[int, list[int]] = {}
    for node, parent in enumerate(parents):
        children.setdefault(parent, []).append(node)
    order = list(children.get(-1, []))
    for node in order:  # grows while it is walked
        order += children.get(node, [])
    return order


def node_tree(path: Path, nodes: list[Any]) -> NodeTree:
    """Return the hierarchy of the nodes of a document.

    Raises
    ------
    RigError
        Cycles, two parents, transforms that are no numbers.
    """
    names = tuple(f"node {i}" if n.name is None else str(n.name) for i, n in enumerate(nodes))
    parents = [-1] * len(nodes)
    for i, node in enumerate(nodes):
        for child in node.children or []:
            child = index(path, f"children of node {i}", child, len(nodes))
            if parents[child] >= 0:
                fail(path, f"one parent of node {child}", f"{parents[child]} and {i}")
            parents[child] = i
    order = _from_roots(parents)
    if len(order) < len(nodes):
        caught = min(set(range(len(nodes))) - set(order))
        fail(
            path, "nodes that form a tree", f"a cycle that holds '{names[caught]}' (node {caught})"
        )
    world = np.empty((len(nodes), 4, 4))
    for i in order:
        own = _matrix(path, i, nodes[i])
        world[i] = own if parents[i] < 0 else world[parents[i]] @ own
    return NodeTree(names, tuple(parents), world)


def _matrix(path: Path, at: int, node: Any) -> np.ndarray:
    if node.matrix is not None:
        # glTF stores matrices column by column.
        return _numbers(path, f"matrix of node {at}", node.matrix, 16).reshape(4, 4).T
    matrix = np.eye(4)
    if node.rotation is not None:
        quaternion = _numbers(path, f"rotation of node {at}", node.rotation, 4)
        norm = float(np.linalg.norm(quaternion))
        if not norm > 0.0:
            fail(path, f"rotation of node {at}: a quaternion", "zeros")
        matrix[:3, :3] = _rotation(quaternion / norm)
    if node.scale is not None:
        matrix[:3, :3] *= _numbers(path, f"scale of node {at}", node.scale, 3)
    if node.translation is not None:
        matrix[:3, 3] = _numbers(path, f"translation of node {at}", node.translation, 3)
    return matrix


def _numbers(path: Path, what: str, values: Any, count: int) -> np.ndarray:
    numbers = np.asarray(values)
    if numbers.shape != (count,) or numbers.dtype.kind not in "iuf":
        fail(path, f"{what}: {count} numbers", repr(values))
    if not np.isfinite(numbers).all():
        fail(path, f"{what}: finite numbers", repr(values))
    return numbers.astype(np.float64)


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
