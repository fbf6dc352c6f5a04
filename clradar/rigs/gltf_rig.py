"""A rig from a skinned mesh of glTF 2.0 (specification, section 3.7.3: skins)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.meshes.gltf_document import EXPECTED
from clradar.hand import JOINT_NAMES
from clradar.rigs.anatomy import CHAINS, WRIST, check_joints, check_side
from clradar.rigs.failures import fail, reading
from clradar.rigs.gltf_file import GltfFile
from clradar.rigs.names import FoundJoints, hand_by_mapping, hands_by_name, side_in
from clradar.rigs.nodes import NodeTree, node_tree
from clradar.rigs.rig import Rig
from clradar.rigs.rigging import MAX_FILE_VERTICES, Surface, rig_of
from clradar.rigs.triangles import attributes_of, triangles

_MAX_SETS = 16


def gltf_rig(
    path: Path,
    content: bytes,
    mapping: Mapping[str, str | int] | None,
    mapping_name: str,
    unit: str | float | None,
    handedness: str | None,
) -> Rig:
    """Return the rig of a glTF file's content.

    The rest pose is that of the file's nodes, as viewers show it; the skin is that of the bind pose
    of the inverse bind matrices, which may differ.
    """
    file = GltfFile(path, content)
    # Overflows are checked for where the numbers are used.
    with reading(path, EXPECTED), np.errstate(over="ignore", invalid="ignore"):
        tree = node_tree(file)
        if not file.listed("meshes"):
            fail(path, "a mesh with a skin", "no mesh")
        skins = file.listed("skins")
        skinned = [n for n in file.listed("nodes") if None not in (n.get("mesh"), n.get("skin"))]
        if not skinned or not skins:
            fail(path, "a mesh with a skin", "a mesh that no joint moves (not skinned)")
        if mapping is not None:
            hands = [hand_by_mapping(path, tree, mapping, mapping_name)]
        else:
            hands = hands_by_name(path, tree, _joints_of(file, tree))
        hand, joints, side = _chosen(path, tree, hands, handedness)
        surface, ignored = _surface(file, tree, hand)
        local = np.full((len(JOINT_NAMES), 3, 3), np.nan)
        for joint, node in hand.nodes.items():
            local[joint] = _rotation_of(tree.world[node][:3, :3])
        return rig_of(str(path), joints, local, surface, side, unit, ignored=ignored)


def _joints_of(file: GltfFile, tree: NodeTree) -> set[int]:
    """Return the joints of all skins."""
    return {joint for skin in file.listed("skins") for joint in _joints(file, tree, skin)}


def _joints(file: GltfFile, tree: NodeTree, skin: dict[str, Any]) -> list[int]:
    what, count = "joints of a skin", len(tree.names)
    return [file.index(what, j, count) for j in file.numbers_of(what, skin.get("joints"))]


def _chosen(
    path: Path, tree: NodeTree, hands: list[FoundJoints], handedness: str | None
) -> tuple[FoundJoints, np.ndarray, str]:
    """Return the one hand of the requested side, its joints (25, 3), and its side."""
    sided = []
    for hand in hands:
        joints = np.full((len(JOINT_NAMES), 3), np.nan)
        for joint, node in hand.nodes.items():
            joints[joint] = tree.world[node][:3, 3]
        check_joints(str(path), joints)
        named = hand.side or side_in(path.stem)
        sided.append((hand, joints, named if len(hands) > 1 else handedness or named))
    fitting = [entry for entry in sided if handedness in (None, entry[2])]
    if len(fitting) > 1:
        fail(path, "one hand, or one of each side and --rig-hand", f"{len(fitting)} hands")
    if not fitting:
        fail(path, f"a {handedness} hand, by the names of joints", "none")
    hand, joints, side = fitting[0]
    if hand.side not in (None, side):
        fail(path, f"a {side} hand", f"a {hand.side} one, by the names of its joints")
    return hand, joints, check_side(str(path), joints, side)


def _surface(file: GltfFile, tree: NodeTree, hand: FoundJoints) -> tuple[Surface, tuple[str, ...]]:
    """Return the surface of the hand in scene coordinates, and the names of other meshes."""
    # A tip is the end of the last bone and moves with it.
    last = {chain[-1]: chain[-2] for chain in CHAINS}
    nearest = tree.nearest_of({node: last.get(joint, joint) for joint, node in hand.nodes.items()})
    moved_by = [WRIST if joint is None else joint for joint in nearest]
    pieces, ignored = [], []
    meshes = file.listed("meshes")
    for at, node in enumerate(file.listed("nodes")):
        if node.get("mesh") is None:
            continue
        mesh = meshes[file.index(f"mesh of node {at}", node["mesh"], len(meshes))]
        name, skinned = str(mesh.get("name") or tree.names[at]), node.get("skin") is not None
        if not skinned:
            if nearest[at] is None:
                ignored.append(name)
                continue
            bones, matrices = np.array([at]), tree.world[[at]]
        else:
            bones, matrices = _skin(file, tree, node["skin"])
            if all(nearest[bone] is None for bone in bones):
                ignored.append(name)
                continue
        joints = np.array([moved_by[bone] for bone in bones])
        primitives = file.objects(f"primitives of mesh '{name}'", mesh.get("primitives"))
        for number, primitive in enumerate(primitives):
            what = f"mesh '{name}', primitive {number}"
            piece = _piece(file, what, primitive, joints, matrices, skinned)
            if piece is not None:
                pieces.append(piece)
    if not pieces:
        file.fail("a mesh with triangles that the hand's joints move", "none")
    return Surface.joined(file.path, pieces), tuple(ignored)


def _skin(file: GltfFile, tree: NodeTree, skin: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return a skin's nodes, and for each the matrix from the mesh to the scene at rest."""
    skins = file.listed("skins")
    entry = skins[file.index("skin of a node", skin, len(skins))]
    bones = np.array(_joints(file, tree, entry), np.int64)
    if not len(bones):
        file.fail("a skin with joints", "none")
    world = tree.world[bones]
    if entry.get("inverseBindMatrices") is None:
        return bones, world
    columns = file.array("inverseBindMatrices", entry["inverseBindMatrices"])
    if columns.shape[1] != 16 or len(columns) < len(bones) or columns.dtype.kind != "f":
        file.fail(f"{len(bones)} inverse bind matrices of floats", f"shape {columns.shape}")
    inverse = columns[: len(bones)].reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
    if not np.isfinite(inverse).all():
        file.fail("finite inverse bind matrices", "NaN or infinite ones")
    return bones, world @ inverse


def _piece(
    file: GltfFile,
    what: str,
    primitive: dict[str, Any],
    joint_of_bone: np.ndarray,
    matrices: np.ndarray,
    skinned: bool,
) -> Surface | None:
    """Return one primitive's triangles with their influences; None for points and lines."""
    read = triangles(file, what, primitive)
    if read is None:
        return None
    positions, faces = read
    if len(positions) > MAX_FILE_VERTICES:
        file.fail(f"{what}: at most {MAX_FILE_VERTICES} vertices", len(positions))
    if skinned:
        bones, weights = _weights(file, what, primitive, len(positions))
    else:
        bones, weights = np.zeros((len(positions), 1), np.int64), np.ones((len(positions), 1))
    moving = weights != 0
    if int(bones[moving].max(initial=0)) >= len(matrices):
        file.fail(f"{what}: JOINTS below {len(matrices)}", int(bones[moving].max()))
    vertex, column = np.nonzero(moving)
    bone, weight = bones[vertex, column], weights[vertex, column]
    at = np.einsum("nij,nj->ni", matrices[bone][:, :3, :3], positions[vertex])
    points = at + matrices[bone][:, :3, 3]
    return Surface.grouped(
        file.path, what, faces, len(positions), vertex, joint_of_bone[bone], weight, points
    )


def _weights(
    file: GltfFile, what: str, primitive: dict[str, Any], n_vertices: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return bones and weights (V, 4 k) of all k sets of a primitive."""
    attributes, bones, weights = attributes_of(file, what, primitive), [], []
    for number in range(_MAX_SETS):
        names = (f"JOINTS_{number}", f"WEIGHTS_{number}")
        given = [attributes.get(name) is not None for name in names]
        if not any(given):
            break
        if not all(given):
            file.fail(f"{what}: {names[0]} and {names[1]}", "one of the two")
        bone, weight = (file.array(f"{what}: {name}", attributes[name]) for name in names)
        shape = (n_vertices, 4)
        if bone.shape != shape or weight.shape != shape or bone.dtype.kind != "u":
            found = f"{bone.dtype} {bone.shape} and {weight.shape}"
            file.fail(f"{what}: 4 joints and weights per vertex, shape {shape}", found)
        bones.append(bone.astype(np.int64))
        weights.append(weight.astype(np.float64))
    if not bones:
        file.fail(f"{what}: JOINTS_0 and WEIGHTS_0", "none, though its node has a skin")
    return np.concatenate(bones, axis=1), np.concatenate(weights, axis=1)


def _rotation_of(matrix: np.ndarray) -> np.ndarray:
    """Return the directions of a node's axes, without its scale."""
    norm = np.linalg.norm(matrix, axis=0)
    return matrix / np.where(norm > 0.0, norm, 1.0)
