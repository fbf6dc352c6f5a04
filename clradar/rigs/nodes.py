"""The node hierarchy of a glTF 2.0 file: parents, and global transforms (section 3.5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.files.limits import MAX_MESH_NODES
from clradar.rigs.gltf_file import GltfFile


@dataclass(frozen=True, slots=True, eq=False)
class NodeTree:
    """Nodes with their parents (-1: a root) and transforms (N, 4, 4) to the scene, in the file's
    unit.

    A node without a name is called ``node N``.
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


def node_tree(file: GltfFile) -> NodeTree:
    """Return the hierarchy of the nodes of a file."""
    nodes = file.listed("nodes")
    if len(nodes) > MAX_MESH_NODES:
        file.fail(f"at most {MAX_MESH_NODES} nodes", len(nodes))
    names = tuple(
        f"node {i}" if n.get("name") is None else str(n["name"]) for i, n in enumerate(nodes)
    )
    parents = [-1] * len(nodes)
    for i, node in enumerate(nodes):
        for child in file.numbers_of(f"children of node {i}", node.get("children")):
            child = file.index(f"children of node {i}", child, len(nodes))
            if parents[child] >= 0:
                file.fail(f"one parent of node {child}", f"{parents[child]} and {i}")
            parents[child] = i
    order = _from_roots(parents)
    if len(order) < len(nodes):
        caught = min(set(range(len(nodes))) - set(order))
        found = f"a cycle that holds '{names[caught]}' (node {caught})"
        file.fail("nodes that form a tree", found)
    world = np.empty((len(nodes), 4, 4))
    for i in order:
        own = _matrix(file, i, nodes[i])
        world[i] = own if parents[i] < 0 else world[parents[i]] @ own
    return NodeTree(names, tuple(parents), world)


def _matrix(file: GltfFile, at: int, node: dict[str, Any]) -> np.ndarray:
    if node.get("matrix") is not None:
        # glTF stores matrices column by column.
        return _numbers(file, f"matrix of node {at}", node["matrix"], 16).reshape(4, 4).T
    matrix = np.eye(4)
    if node.get("rotation") is not None:
        quaternion = _numbers(file, f"rotation of node {at}", node["rotation"], 4)
        norm = float(np.linalg.norm(quaternion))
        if not 0.0 < norm < np.inf:
            file.fail(
                f"rotation of node {at}: a quaternion", "zeros" if norm == 0 else "an overflow"
            )
        matrix[:3, :3] = _rotation(quaternion / norm)
    if node.get("scale") is not None:
        matrix[:3, :3] *= _numbers(file, f"scale of node {at}", node["scale"], 3)
    if node.get("translation") is not None:
        matrix[:3, 3] = _numbers(file, f"translation of node {at}", node["translation"], 3)
    return matrix


def _numbers(file: GltfFile, what: str, values: Any, count: int) -> np.ndarray:
    listed = values if isinstance(values, list) and len(values) == count else []
    if not listed or any(type(value) not in (int, float) for value in listed):
        file.fail(f"{what}: {count} numbers", repr(values))
    with np.errstate(over="ignore"):
        numbers = np.array([float(value) for value in listed])
    if not np.isfinite(numbers).all():
        file.fail(f"{what}: finite numbers", repr(values))
    return numbers


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
