"""A rig from a skinned mesh of glTF 2.0 (specification, sections 3.5 to 3.7).

pygltflib reads the document; what is in it is checked where it is used.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import unquote

import numpy as np
from pydantic import Field
from pygltflib import DATA_URI_HEADER, GLTF2
from scipy.spatial.transform import Rotation

from clradar.errors import RigError
from clradar.files import limits
from clradar.files.confined.process import forbid_opening
from clradar.files.failures import read_bytes, reading
from clradar.files.meshes.gltf_document import (
    EXPECTED,
    GLB_MAGIC,
    bytes_beside,
    check_document,
    glb_text,
    parents_and_order,
)
from clradar.files.records import FileRecord, checked, read_record, record_of
from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS, WRIST
from clradar.hand.pose_record import JointName
from clradar.model import checks
from clradar.rigs.names import FoundJoints, hand_by_mapping, hands_by_name, side_in
from clradar.rigs.rig import MAX_VERTICES, Surface, rig_of

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MAX_SETS = 16

Entry = TypeVar("Entry")


Node = Annotated[
    str | int,
    checked("the name or number of a node", lambda v: type(v) in (str, int)),
]


class MappingFile(FileRecord):
    """What a mapping file says: WebXR name = name or number of a node."""

    joints: dict[JointName, Node] = Field(description="a table [joints]: WebXR name = node")


def nodes_of(
    mapping: str | os.PathLike[str] | Mapping[str, str | int], rig: Path
) -> dict[str, str | int]:
    """Return the node of each joint of a mapping or of its file."""
    if isinstance(mapping, Mapping):
        return record_of({"joints": dict(mapping)}, MappingFile, rig, error=RigError).joints
    expected = "a TOML file with a table [joints]: WebXR name = node"
    return read_record(Path(mapping), MappingFile, expected, error=RigError).joints


def plain_gltf(
    path: Path,
    mapping: Mapping[str, str | int] | None,
    unit_m: float,
    handedness: str | None,
) -> dict[str, Any]:
    """Return the rig of a glTF file, in plain types; called in the confined process.

    The rest pose is that of the file's nodes, as viewers show it; the skin is that of the bind pose
    of the inverse bind matrices, which may differ.
    """
    content = read_bytes(path, EXPECTED, limits.MAX_MESH_BYTES, error=RigError)
    # Overflows are checked for where the numbers are used.
    with reading(path, EXPECTED, error=RigError), np.errstate(over="ignore", invalid="ignore"):
        file = _File(path, content)
        if mapping is not None:
            hands = [hand_by_mapping(file.names, mapping)]
        else:
            skinned = {joint for skin in file.document.skins for joint in skin.joints}
            hands = hands_by_name(file.names, skinned)
        hand, side = _chosen(hands, handedness, side_in(path.stem))
        surface, ignored = _surface(file, hand)
        world = np.full((len(JOINT_NAMES), 4, 4), np.nan)
        world[list(hand.nodes)] = file.world[list(hand.nodes.values())]
        joints, local = world[:, :3, 3], world[:, :3, :3]
        norm = np.linalg.norm(local, axis=1, keepdims=True)
        local = local / np.where(norm > 0.0, norm, 1.0)
        return rig_of(str(path), joints, local, surface, side, unit_m, ignored=ignored).plain()


def _chosen(
    hands: list[FoundJoints], handedness: str | None, side_of_file: str | None
) -> tuple[FoundJoints, str | None]:
    """Return the one hand of the requested side, and its side as far as it is given or named."""
    if len(hands) > 1 and handedness is not None:
        hands = [hand for hand in hands if (hand.side or side_of_file) == handedness]
    if len(hands) != 1:
        expected = "one hand, or one of each side and --rig-hand"
        checks.fail("joints", expected, f"{len(hands)} {handedness or ''} hands, by their names")
    (hand,) = hands
    side = handedness or hand.side or side_of_file
    if hand.side not in (None, side):
        checks.fail("hand", f"a {side} hand", f"a {hand.side} one, by the names of its joints")
    return hand, side


def _surface(file: _File, hand: FoundJoints) -> tuple[Surface, tuple[str, ...]]:
    """Return the surface of the hand in scene coordinates, and the names of other meshes."""
    # A tip is the end of the last bone and moves with it.
    last = {chain[-1]: chain[-2] for chain in CHAINS}
    own_joint = {node: last.get(joint, joint) for joint, node in hand.nodes.items()}
    nearest: list[int | None] = [None] * len(file.names)
    for at in file.order:
        parent = file.parents[at]
        nearest[at] = own_joint.get(at, None if parent < 0 else nearest[parent])
    moved_by = np.array([WRIST if joint is None else joint for joint in nearest])
    pieces, ignored = [], []
    for at, node in enumerate(file.document.nodes):
        if node.mesh is None:
            continue
        mesh = _entry(f"mesh of node {at}", file.document.meshes, node.mesh)
        name, skinned = str(mesh.name or file.names[at]), node.skin is not None
        bones, matrices = file.skin(node.skin) if skinned else (np.array([at]), file.world[[at]])
        if all(nearest[bone] is None for bone in bones):
            ignored.append(name)
            continue
        for number, primitive in enumerate(mesh.primitives):
            what = f"mesh '{name}', primitive {number}"
            if primitive.mode in (_STRIP, _FAN):
                checks.fail(what, "a plain list of triangles", "a strip or a fan")
            if primitive.mode not in (None, _TRIANGLES):
                continue
            positions, faces = file.triangles(what, primitive)
            if not len(faces):
                continue
            own, weights = file.weights(what, primitive, len(positions), skinned)
            moving = weights != 0
            checks.indices(f"{what}: JOINTS", own[moving], len(matrices))
            vertex, column = np.nonzero(moving)
            bone = own[vertex, column]
            turned = np.einsum("nij,nj->ni", matrices[bone][:, :3, :3], positions[vertex])
            pieces.append(
                Surface.grouped(
                    what, faces, vertex, moved_by[bones[bone]],
                    weights[vertex, column], turned + matrices[bone][:, :3, 3],
                )
            )  # fmt: skip
    if not pieces:
        checks.fail("meshes", "one with triangles that the hand's joints move", "none")
    return Surface.joined(pieces), tuple(ignored)


def _entry(what: str, entries: Sequence[Entry], index: Any) -> Entry:
    """Return the entry of an index in the file, which is checked."""
    return entries[checks.whole(what, index, 0, len(entries) - 1)]


class _File:
    """A document, its buffers, and its nodes: their names, parents (-1: a root) and transforms
    (N, 4, 4) to the scene, in the file's unit.

    Once the buffers are read, the confined process that this runs in can open nothing any more.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        self._numbers_left = limits.MAX_GLTF_NUMBERS
        text = glb_text(content) if content.startswith(GLB_MAGIC) else content
        if (count := text.count(b"{")) > limits.MAX_GLTF_OBJECTS:
            checks.fail("its JSON", f"at most {limits.MAX_GLTF_OBJECTS} objects", f"{count}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pygltflib asks for reports of what it does not know
            if content.startswith(GLB_MAGIC):
                document = GLTF2.load_from_bytes(content)
            else:
                document = GLTF2.gltf_from_json(content.decode("utf-8-sig"))
        if document is None:
            checks.fail("GLB file", "a JSON chunk", "none")
        check_document(document.asset.version, document.extensionsRequired)
        self.document = document
        self._buffers: list[bytes] = []
        for at, buffer in enumerate(document.buffers):
            data = self._buffer(path, f"buffer {at}", buffer.uri)
            if len(data) < buffer.byteLength:
                got = f"{len(data)}: the file is cut short"
                checks.fail(f"buffer {at}", f"{buffer.byteLength} bytes", got)
            self._buffers.append(data[: buffer.byteLength])
        forbid_opening()
        nodes = document.nodes
        self.names = [str(n.name or f"node {at}") for at, n in enumerate(nodes)]
        self.parents, self.order = parents_and_order([node.children or [] for node in nodes])
        self.world = np.empty((len(nodes), 4, 4))
        for at in self.order:
            own, parent = self._matrix(at), self.parents[at]
            self.world[at] = own if parent < 0 else self.world[parent] @ own
        if not any(None not in (node.mesh, node.skin) for node in nodes):
            got = "a mesh that no joint moves (not skinned)" if document.meshes else "no mesh"
            checks.fail("nodes", "a mesh with a skin", got)

    def _buffer(self, path: Path, what: str, uri: Any) -> bytes:
        if uri is None:
            data = self.document.binary_blob() if what == "buffer 0" else None
            if data is None:
                checks.fail(what, "a uri or a binary chunk", "neither")
            return bytes(data)
        if uri.startswith("data:"):
            if ";base64," not in uri:
                checks.fail(what, "base64", uri[:40])
            return bytes(GLTF2.decode_data_uri(DATA_URI_HEADER + unquote(uri.partition(",")[2])))
        left = limits.MAX_MESH_BUFFERS_BYTES - sum(map(len, self._buffers))
        return bytes_beside(path, what, unquote(uri), left, RigError)

    def _matrix(self, at: int) -> np.ndarray:
        def numbers(name: str, count: int) -> np.ndarray:
            return checks.read_only(f"{name} of node {at}", getattr(node, name), float, (count,))

        node = self.document.nodes[at]
        if node.matrix is not None:
            # glTF stores matrices column by column.
            return numbers("matrix", 16).reshape(4, 4).T
        matrix = np.eye(4)
        if node.rotation is not None:
            quaternion = numbers("rotation", 4)
            if not 0.0 < np.linalg.norm(quaternion) < np.inf:
                got = "zeros" if not quaternion.any() else "an overflow"
                checks.fail(f"rotation of node {at}", "a quaternion", got)
            matrix[:3, :3] = Rotation.from_quat(quaternion.copy()).as_matrix()
        if node.scale is not None:
            matrix[:3, :3] *= numbers("scale", 3)
        if node.translation is not None:
            matrix[:3, 3] = numbers("translation", 3)
        return matrix

    def skin(self, index: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return a skin's nodes, and for each the matrix from the mesh to the scene at rest."""
        skin = _entry("skin of a node", self.document.skins, index)
        bones = checks.read_only("joints of a skin", skin.joints, np.int64, (None,))
        checks.indices("joints of a skin", bones, len(self.names))
        if skin.inverseBindMatrices is None:
            return bones, self.world[bones]
        columns = self.array("inverseBindMatrices", skin.inverseBindMatrices)[: len(bones)]
        inverse = checks.read_only("inverseBindMatrices", columns, np.float64, (len(bones), 16))
        return bones, self.world[bones] @ inverse.reshape(-1, 4, 4).swapaxes(1, 2)

    def triangles(self, what: str, primitive: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3), float64, and faces (m, 3)."""
        name, any_n = f"{what}: POSITION", {"allow_empty": True}
        raw = self.array(name, primitive.attributes.POSITION)
        if len(raw) > MAX_VERTICES:
            checks.fail(name, f"at most {MAX_VERTICES} vertices", len(raw))
        positions = checks.read_only(name, raw, np.float64, (None, 3), **any_n)
        corners = np.arange(len(positions))
        if primitive.indices is not None:
            raw = self.array(f"{what}: indices", primitive.indices)
            corners = checks.read_only(f"{what}: indices", raw, np.int64, (None, 1), **any_n)[:, 0]
        if len(corners) % 3 or len(corners) > 3 * limits.MAX_MESH_FACES:
            most = f"three for each of at most {limits.MAX_MESH_FACES} triangles"
            checks.fail(f"{what}: indices", most, len(corners))
        checks.indices(f"{what}: indices", corners, len(positions))
        return positions, corners.reshape(-1, 3)

    def weights(
        self, what: str, primitive: Any, n_vertices: int, skinned: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bones and weights (V, 4 k) of all k sets of a primitive; (V, 1) without a skin."""
        if not skinned:
            return np.zeros((n_vertices, 1), np.int64), np.ones((n_vertices, 1))
        sets: list[list[np.ndarray]] = []
        while len(sets) < _MAX_SETS:
            names = [f"{name}_{len(sets)}" for name in ("JOINTS", "WEIGHTS")]
            given = [getattr(primitive.attributes, name, None) for name in names]
            if None in given:
                break
            sets.append([
                checks.read_only(
                    f"{what}: {name}", self.array(f"{what}: {name}", at), dtype, (n_vertices, 4),
                    allow_empty=True,
                )
                for name, at, dtype in zip(names, given, (np.int64, np.float64), strict=True)
            ])  # fmt: skip
        if not sets or given.count(None) == 1:
            checks.fail(f"{what}: {', '.join(names)}", "both, of a skin", "none, or one of the two")
        bones, weights = (np.concatenate(arrays, axis=1) for arrays in zip(*sets, strict=True))
        return bones, weights

    def array(self, what: str, accessor: Any) -> np.ndarray:
        """Return the numbers (count, n) of an accessor of the file, normalised if it is flagged."""
        entry = _entry(f"accessor of {what}", self.document.accessors, accessor)
        code, n = _TYPES.get(entry.componentType), _NUMBERS.get(entry.type)
        if code is None or n is None:
            got = f"type {entry.type} of component type {entry.componentType}"
            checks.fail(what, "numbers of a known type", got)
        if entry.sparse is not None:
            checks.fail(what, "numbers of a buffer", "sparse ones")
        dtype, count = np.dtype(code), checks.whole(f"count of {what}", entry.count, 0)
        self._numbers_left -= count * n
        if self._numbers_left < 0:
            most = f"at most {limits.MAX_GLTF_NUMBERS} numbers, with all uses of them"
            checks.fail("mesh", most, f"{count} elements more for {what}")
        values = np.zeros((count, n), dtype)
        if entry.bufferView is not None:
            view = _entry(f"bufferView of {what}", self.document.bufferViews, entry.bufferView)
            data = _entry(f"buffer of {what}", self._buffers, view.buffer)
            size, about = n * dtype.itemsize, f"offsets and lengths of {what}"
            stride, begin, length, offset = (
                checks.whole(about, value or 0, 0, 2**40)
                for value in (view.byteStride, view.byteOffset, view.byteLength, entry.byteOffset)
            )
            stride, first = stride or size, begin + offset
            last = first + (count - 1) * stride + size
            have = min(begin + length, len(data))
            if not size <= stride < 256 or (count and last > have):
                expected = f"{count} elements up to byte {last} of buffer {view.buffer}"
                checks.fail(what, expected, have)
            if count:
                strides = (stride, dtype.itemsize)
                values = np.ndarray((count, n), dtype, data, first, strides=strides)
        if dtype.kind == "f" or not entry.normalized:
            return values
        # glTF 2.0, 3.6.2.2: the most negative signed value means -1, too.
        return np.maximum(values / np.iinfo(dtype).max, -1.0)
