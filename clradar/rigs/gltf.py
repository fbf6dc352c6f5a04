"""A rig from a skinned mesh of glTF 2.0 (specification, sections 3.5 to 3.7).

pygltflib reads the document; what is in it is checked where it is used.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import numpy as np
from pygltflib import DATA_URI_HEADER, GLTF2
from scipy.spatial.transform import Rotation

from clradar.errors import RigError
from clradar.files import limits
from clradar.files.confined.process import forbid_opening
from clradar.files.meshes.gltf_document import EXPECTED, GLB_MAGIC, bytes_beside, check_document
from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS
from clradar.rigs.anatomy import WRIST, check_joints, check_side
from clradar.rigs.failures import fail, file_bytes, reading
from clradar.rigs.names import FoundJoints, hand_by_mapping, hands_by_name, side_in
from clradar.rigs.rigging import MAX_FILE_VERTICES, Surface, rig_of

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MAX_SETS = 16

Entry = TypeVar("Entry")


def plain_gltf(
    path: Path,
    mapping: Mapping[str, str | int] | None,
    mapping_name: str,
    unit: str | float | None,
    handedness: str | None,
) -> dict[str, Any]:
    """Return the rig of a glTF file, in plain types; called in the confined process.

    The rest pose is that of the file's nodes, as viewers show it; the skin is that of the bind pose
    of the inverse bind matrices, which may differ.
    """
    content = file_bytes(path, EXPECTED)
    # Overflows are checked for where the numbers are used.
    with reading(path, EXPECTED), np.errstate(over="ignore", invalid="ignore"):
        file = _File(path, content)
        names, world = file.names, file.world
        if mapping is not None:
            hands = [hand_by_mapping(path, names, mapping, mapping_name)]
        else:
            skinned = {joint for skin in file.document.skins for joint in skin.joints}
            hands = hands_by_name(path, names, skinned)
        hand, joints, side = _chosen(path, world, hands, handedness)
        surface, ignored = _surface(file, hand)
        local = np.full((len(JOINT_NAMES), 3, 3), np.nan)
        for joint, node in hand.nodes.items():
            norm = np.linalg.norm(world[node][:3, :3], axis=0)
            local[joint] = world[node][:3, :3] / np.where(norm > 0.0, norm, 1.0)
        rig = rig_of(str(path), joints, local, surface, side, unit, ignored=ignored)
        return rig.plain()


def _chosen(
    path: Path, world: np.ndarray, hands: list[FoundJoints], handedness: str | None
) -> tuple[FoundJoints, np.ndarray, str]:
    """Return the one hand of the requested side, its joints (25, 3), and its side."""
    sided = []
    for hand in hands:
        joints = np.full((len(JOINT_NAMES), 3), np.nan)
        joints[list(hand.nodes)] = world[list(hand.nodes.values()), :3, 3]
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


def _surface(file: _File, hand: FoundJoints) -> tuple[Surface, tuple[str, ...]]:
    """Return the surface of the hand in scene coordinates, and the names of other meshes."""
    # A tip is the end of the last bone and moves with it.
    last = {chain[-1]: chain[-2] for chain in CHAINS}
    nearest = file.inherited({node: last.get(joint, joint) for joint, node in hand.nodes.items()})
    moved_by = np.array([WRIST if joint is None else joint for joint in nearest])
    pieces, ignored = [], []
    for at, node in enumerate(file.document.nodes):
        if node.mesh is None:
            continue
        mesh = file.entry(file.document.meshes, node.mesh, f"mesh of node {at}")
        name, skinned = str(mesh.name or file.names[at]), node.skin is not None
        bones, matrices = file.skin(node.skin) if skinned else (np.array([at]), file.world[[at]])
        if all(nearest[bone] is None for bone in bones):
            ignored.append(name)
            continue
        for number, primitive in enumerate(mesh.primitives):
            what = f"mesh '{name}', primitive {number}"
            read = file.triangles(what, primitive)
            if read is None:
                continue
            positions, faces = read
            own, weights = file.weights(what, primitive, len(positions), skinned)
            moving = weights != 0
            if int(own[moving].max(initial=0)) >= len(matrices):
                fail(file.path, f"{what}: JOINTS below {len(matrices)}", int(own[moving].max()))
            vertex, column = np.nonzero(moving)
            bone = own[vertex, column]
            turned = np.einsum("nij,nj->ni", matrices[bone][:, :3, :3], positions[vertex])
            pieces.append(
                Surface.grouped(
                    file.path, what, faces, vertex, moved_by[bones[bone]],
                    weights[vertex, column], turned + matrices[bone][:, :3, 3],
                )
            )  # fmt: skip
    if not pieces:
        fail(file.path, "a mesh with triangles that the hand's joints move", "none")
    return Surface.joined(file.path, pieces), tuple(ignored)


class _File:
    """A document, its buffers, and its nodes: their names, parents (-1: a root) and transforms
    (N, 4, 4) to the scene, in the file's unit.

    Once the buffers are read, the confined process that this runs in can open nothing any more.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        self.path = path
        self._numbers_left = limits.MAX_GLTF_NUMBERS
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pygltflib asks for reports of what it does not know
            if content.startswith(GLB_MAGIC):
                document = GLTF2.load_from_bytes(content)
            else:
                document = GLTF2.gltf_from_json(content.decode("utf-8-sig"))
        if document is None:
            fail(path, "a GLB file with a JSON chunk", "none")
        check_document(path, document.asset.version, document.extensionsRequired, RigError)
        self.document = document
        self._buffers = []
        for at, buffer in enumerate(document.buffers):
            data = self._buffer(f"buffer {at}", buffer.uri)
            if len(data) < buffer.byteLength:
                expected = f"buffer {at} of {buffer.byteLength} bytes"
                fail(path, expected, f"{len(data)}: the file is cut short")
            self._buffers.append(data[: buffer.byteLength])
        forbid_opening()
        self.names = tuple(
            f"node {at}" if node.name is None else str(node.name)
            for at, node in enumerate(document.nodes)
        )
        self._find_parents()
        self.world = np.empty((len(self.names), 4, 4))
        for at in self._from_roots:
            own, parent = self._matrix(at), self.parents[at]
            self.world[at] = own if parent < 0 else self.world[parent] @ own
        if not document.meshes:
            fail(path, "a mesh with a skin", "no mesh")
        if not any(None not in (node.mesh, node.skin) for node in document.nodes):
            fail(path, "a mesh with a skin", "a mesh that no joint moves (not skinned)")

    def _buffer(self, what: str, uri: Any) -> bytes:
        if uri is None:
            data = self.document.binary_blob() if what == "buffer 0" else None
            if data is None:
                fail(self.path, f"{what} with data", "neither a uri nor a binary chunk")
            return bytes(data)
        if uri.startswith("data:"):
            if ";base64," not in uri:
                fail(self.path, f"{what} in base64", uri[:40])
            return bytes(GLTF2.decode_data_uri(DATA_URI_HEADER + unquote(uri.partition(",")[2])))
        left = limits.MAX_MESH_BUFFERS_BYTES - sum(map(len, self._buffers))
        return bytes_beside(self.path, what, unquote(uri), left, RigError)

    def entry(self, entries: Sequence[Entry], index: Any, what: str) -> Entry:
        """Return the entry of an index in the file, which is checked."""
        if type(index) is not int or not 0 <= index < len(entries):
            expected = f"{what}: a whole number in [0, {len(entries)})"
            fail(self.path, expected, repr(index))
        return entries[index]

    def _find_parents(self) -> None:
        nodes = self.document.nodes
        if len(nodes) > limits.MAX_MESH_NODES:
            fail(self.path, f"at most {limits.MAX_MESH_NODES} nodes", len(nodes))
        self.parents = [-1] * len(nodes)
        for at, node in enumerate(nodes):
            for child in node.children or []:
                self.entry(nodes, child, f"children of node {at}")
                if self.parents[child] >= 0:
                    found = f"{self.parents[child]} and {at}"
                    fail(self.path, f"one parent of node {child}", found)
                self.parents[child] = at
        self._from_roots = [at for at, parent in enumerate(self.parents) if parent < 0]
        for at in self._from_roots:  # grows while it is walked
            self._from_roots += nodes[at].children or []
        if len(self._from_roots) < len(nodes):
            caught = min(set(range(len(nodes))) - set(self._from_roots))
            found = f"a cycle that holds '{self.names[caught]}' (node {caught})"
            fail(self.path, "nodes that form a tree", found)

    def inherited(self, values: Mapping[int, int]) -> list[int | None]:
        """Return for every node the value of it or of its nearest ancestor that has one."""
        found: list[int | None] = [None] * len(self.names)
        for at in self._from_roots:
            above = None if self.parents[at] < 0 else found[self.parents[at]]
            found[at] = values.get(at, above)
        return found

    def _matrix(self, at: int) -> np.ndarray:
        node, what = self.document.nodes[at], f"of node {at}"
        if node.matrix is not None:
            # glTF stores matrices column by column.
            return self._vector(f"matrix {what}", node.matrix, 16).reshape(4, 4).T
        matrix = np.eye(4)
        if node.rotation is not None:
            quaternion = self._vector(f"rotation {what}", node.rotation, 4)
            if not 0.0 < np.linalg.norm(quaternion) < np.inf:
                got = "zeros" if not quaternion.any() else "an overflow"
                fail(self.path, f"rotation {what}: a quaternion", got)
            matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        if node.scale is not None:
            matrix[:3, :3] *= self._vector(f"scale {what}", node.scale, 3)
        if node.translation is not None:
            matrix[:3, 3] = self._vector(f"translation {what}", node.translation, 3)
        return matrix

    def _vector(self, what: str, values: Any, count: int) -> np.ndarray:
        numbers = np.array(values, np.float64)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            fail(self.path, f"{what}: {count} finite numbers", repr(values))
        return numbers

    def skin(self, index: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return a skin's nodes, and for each the matrix from the mesh to the scene at rest."""
        skin = self.entry(self.document.skins, index, "skin of a node")
        for joint in skin.joints:
            self.entry(self.names, joint, "joints of a skin")
        bones = np.array(skin.joints, np.int64)
        if not len(bones):
            fail(self.path, "a skin with joints", "none")
        if skin.inverseBindMatrices is None:
            return bones, self.world[bones]
        columns = self.array("inverseBindMatrices", skin.inverseBindMatrices)
        if columns.shape[1] != 16 or len(columns) < len(bones) or columns.dtype.kind != "f":
            expected = f"{len(bones)} inverse bind matrices of floats"
            fail(self.path, expected, f"shape {columns.shape}")
        inverse = columns[: len(bones)].reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
        if not np.isfinite(inverse).all():
            fail(self.path, "finite inverse bind matrices", "NaN or infinite ones")
        return bones, self.world[bones] @ inverse

    def triangles(self, what: str, primitive: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Return positions (n, 3), float64, and faces (m, 3); None without triangles."""
        mode = _TRIANGLES if primitive.mode is None else primitive.mode
        if mode in (_STRIP, _FAN):
            fail(self.path, f"{what}: a plain list of triangles", "a strip or a fan")
        if mode != _TRIANGLES:
            return None
        positions = self.array(f"{what}: POSITION", primitive.attributes.POSITION)
        if positions.shape[1] != 3 or not np.isfinite(positions).all():
            fail(self.path, f"{what}: finite positions with 3 coordinates", "other ones")
        if len(positions) > MAX_FILE_VERTICES:
            fail(self.path, f"{what}: at most {MAX_FILE_VERTICES} vertices", len(positions))
        corners = np.arange(len(positions))
        if primitive.indices is not None:
            raw = self.array(f"{what}: indices", primitive.indices)
            if raw.dtype.kind != "u" or raw.shape[1] != 1:
                fail(self.path, f"{what}: indices that are unsigned integers", raw.dtype)
            corners = raw[:, 0].astype(np.int64)
        if len(corners) // 3 > limits.MAX_MESH_FACES:
            expected = f"{what}: at most {limits.MAX_MESH_FACES} triangles"
            fail(self.path, expected, f"{len(corners)} indices")
        if len(corners) and int(corners.max()) >= len(positions):
            fail(self.path, f"{what}: indices below {len(positions)}", int(corners.max()))
        if len(corners) % 3:
            fail(self.path, f"{what}: three indices per triangle", len(corners))
        faces = corners.reshape(-1, 3)
        return (positions.astype(np.float64), faces) if len(faces) else None

    def weights(
        self, what: str, primitive: Any, n_vertices: int, skinned: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bones and weights (V, 4 k) of all k sets of a primitive; (V, 1) without a skin."""
        if not skinned:
            return np.zeros((n_vertices, 1), np.int64), np.ones((n_vertices, 1))
        attributes, bones, weights = vars(primitive.attributes), [], []
        for number in range(_MAX_SETS):
            names = (f"JOINTS_{number}", f"WEIGHTS_{number}")
            given = [attributes.get(name) for name in names]
            if given == [None, None]:
                break
            if None in given:
                fail(self.path, f"{what}: {names[0]} and {names[1]}", "one of the two")
            bone, weight = (
                self.array(f"{what}: {name}", at) for name, at in zip(names, given, strict=True)
            )
            shape = (n_vertices, 4)
            if bone.shape != shape or weight.shape != shape or bone.dtype.kind != "u":
                found = f"{bone.dtype} {bone.shape} and {weight.shape}"
                fail(self.path, f"{what}: 4 joints and weights per vertex, shape {shape}", found)
            bones.append(bone.astype(np.int64))
            weights.append(weight.astype(np.float64))
        if not bones:
            fail(self.path, f"{what}: JOINTS_0 and WEIGHTS_0", "none, though its node has a skin")
        return np.concatenate(bones, axis=1), np.concatenate(weights, axis=1)

    def array(self, what: str, accessor: Any) -> np.ndarray:
        """Return the numbers (count, n) of an accessor of the file, normalised if it is flagged."""
        entry = self.entry(self.document.accessors, accessor, f"accessor of {what}")
        code, n = _TYPES.get(entry.componentType), _NUMBERS.get(entry.type)
        if code is None or n is None:
            found = f"type {entry.type} of component type {entry.componentType}"
            fail(self.path, f"{what}: numbers of a known type", found)
        if entry.sparse is not None:
            fail(self.path, f"{what}: numbers of a buffer", "sparse ones")
        dtype, count = np.dtype(code), self._size(f"count of {what}", entry.count)
        self._numbers_left -= count * n
        if self._numbers_left < 0:
            most = f"a mesh of at most {limits.MAX_GLTF_NUMBERS} numbers, with all uses of them"
            fail(self.path, most, f"{count} elements more for {what}")
        if entry.bufferView is None:
            values = np.zeros((count, n), dtype)
        else:
            values = self._viewed(what, entry, dtype, count, n)
        if dtype.kind == "f" or not entry.normalized:
            return values
        # glTF 2.0, 3.6.2.2: the most negative signed value means -1, too.
        return np.maximum(values / np.iinfo(dtype).max, -1.0)

    def _size(self, what: str, value: Any) -> int:
        return self.entry(range(2**40), value, what)

    def _viewed(
        self, what: str, entry: Any, dtype: np.dtype[Any], count: int, n: int
    ) -> np.ndarray:
        """Return the numbers that an accessor has in a buffer view."""
        view = self.entry(self.document.bufferViews, entry.bufferView, f"bufferView of {what}")
        data = self.entry(self._buffers, view.buffer, f"buffer of {what}")
        size, about = n * dtype.itemsize, f"offsets and lengths of {what}"
        stride, begin, length, offset = (
            self._size(about, value or 0)
            for value in (view.byteStride, view.byteOffset, view.byteLength, entry.byteOffset)
        )
        stride, first = stride or size, begin + offset
        last = first + (count - 1) * stride + size
        have = min(begin + length, len(data))
        if not size <= stride < 256 or (count and last > have):
            expected = f"{what}: {count} elements up to byte {last} of buffer {view.buffer}"
            fail(self.path, expected, have)
        if count == 0:
            return np.zeros((0, n), dtype)
        return np.ndarray((count, n), dtype, data, first, strides=(stride, dtype.itemsize))
