"""Rigged hands of the kinds that users bring, made of the hand of this package."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from pygltflib import (
    GLTF2,
    Accessor,
    Asset,
    Attributes,
    Buffer,
    BufferView,
    Mesh,
    Node,
    Primitive,
    Scene,
    Skin,
)

from clradar.hand import (
    JOINT_NAMES,
    HandMesh,
    HandPose,
    HandShape,
    Skeleton,
    hand_mesh,
    pose_by_name,
    posed_skeleton,
)
from clradar.hand.shape import AVERAGE

PARENTS = [
    -1 if name == "wrist" else 0 if name.endswith("metacarpal") else i - 1
    for i, name in enumerate(JOINT_NAMES)
]
TIPS = [i for i, name in enumerate(JOINT_NAMES) if name.endswith("tip")]
_KINDS = {"<f4": 5126, "<u1": 5121, "<u2": 5123, "<u4": 5125, "<i2": 5122}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def bone_weights(vertices: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return weights (V, 25) that fall with the distance to the bones; a tip has none."""
    distance = np.full((len(vertices), len(JOINT_NAMES)), np.inf)
    for end, begin in enumerate(PARENTS):
        if begin < 0:
            continue
        bone = joints[end] - joints[begin]
        share = np.clip((vertices - joints[begin]) @ bone / (bone @ bone), 0.0, 1.0)
        gap = np.linalg.norm(vertices - joints[begin] - share[:, None] * bone, axis=1)
        distance[:, begin] = np.minimum(distance[:, begin], gap)
    # The palm is moved by the wrist alone: its bones do not turn against each other here.
    for i, name in enumerate(JOINT_NAMES):
        if name.endswith("finger-metacarpal"):
            distance[:, 0] = np.minimum(distance[:, 0], distance[:, i])
            distance[:, i] = np.inf
    weights = (distance / distance.min(axis=1, keepdims=True)) ** -16.0
    order = np.argsort(weights, axis=1)[:, :-4]
    np.put_along_axis(weights, order, 0.0, axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


def posed(pose: str | HandPose, shape: HandShape = AVERAGE) -> Skeleton:
    return posed_skeleton(pose if isinstance(pose, HandPose) else pose_by_name(pose), shape)


@cache
def grown(
    pose: str | HandPose, edge_length_m: float, shape: HandShape
) -> tuple[HandMesh, Skeleton, np.ndarray]:
    """A hand, its skeleton, and the weights of its vertices: the same for many files."""
    mesh = hand_mesh(pose, edge_length_m=edge_length_m, shape=shape)
    skeleton = posed(pose, shape)
    at_m = mesh.vertices_m + skeleton.joints_m[0] - mesh.joints_m[0]
    return mesh, skeleton, bone_weights(at_m, skeleton.joints_m)


@dataclass
class RigMaker:
    """A hand of this package as a skinned glTF file; the fields choose its peculiarities.

    `units` are those of the file per metre, in the vertices; joints are in `units / scale`, the
    scale of a node above them. `turn` is orthogonal (-1: mirrored), or without `local_turns` any
    matrix, which stretches the hand. `bones` are some that are no joints: a forearm above the
    wrist, a twist bone in the index. The flesh and children of joints to `skip` go to their
    parents. `sets` are of four weights. The nodes stand in the pose `standing`, if not in that of
    the inverse bind matrices. `edit` changes the arrays before they are written.
    """

    pose: str | HandPose = "flat"
    shape: HandShape = AVERAGE
    units: float = 1.0
    scale: float = 1.0
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    called: Callable[[str], str] = str
    bones: bool = False
    skip: tuple[str, ...] = ()
    local_turns: bool = True
    weight_type: str = "<f4"
    joint_type: str = "<u1"
    index_type: str | None = "<u4"
    sets: int = 1
    primitives: int = 1
    edge_length_m: float = 4e-3
    siblings: bool = False
    standing: HandPose | str | None = None
    edit: Callable[[RigMaker], None] | None = None

    def build(self) -> GLTF2:
        mesh, skeleton, weights = grown(self.pose, self.edge_length_m, self.shape)
        shift, weights = skeleton.joints_m[0] - mesh.joints_m[0], weights.copy()
        parents = list(PARENTS)
        for name in self.skip:
            gone = JOINT_NAMES.index(name)
            parents = [parents[gone] if p == gone else p for p in parents]
            up = parents[gone]
            weights[:, up] += weights[:, gone]
            weights[:, gone] = 0.0

        self.faces = mesh.faces if np.linalg.det(self.turn) > 0 else mesh.faces[:, [0, 2, 1]]
        self.positions = self.placed(mesh.vertices_m + shift)
        world = [self.placed_node(skeleton, i) for i in range(len(JOINT_NAMES))]
        self.names = [self.called(n) for n in JOINT_NAMES]
        keep = [i for i, n in enumerate(JOINT_NAMES) if n not in self.skip]
        if self.bones:
            self._add_bones(world, parents, weights, keep)
        weights = getattr(self, "weights", weights)
        self._collect(world, parents, weights, keep)
        self.document = GLTF2(asset=Asset(version="2.0"))
        if self.edit is not None:
            self.edit(self)
        self._write(world, parents, keep)
        return self.document

    def _add_bones(self, world, parents, weights, keep) -> None:
        """Put a forearm above the wrist, and a bone between two joints of the index finger."""
        forearm, twist = len(world), len(world) + 1
        below = np.eye(4)
        below[:3, 3] = world[0][:3, 3] - 0.2 * self.units * self.turn[:, 1]
        middle = world[7].copy()
        middle[:3, 3] = 0.5 * (world[7][:3, 3] + world[8][:3, 3])
        world += [below, middle]
        parents[0] = forearm
        parents[8] = twist
        parents += [-1, 7]
        self.names += ["Forearm", "index_helper"]
        keep += [forearm, twist]
        self.weights = np.concatenate([weights, np.zeros((len(weights), 2))], axis=1)
        # Half of the phalanx's weight is the helper's, half of the wrist's the forearm's.
        for bone, own in ((twist, 7), (forearm, 0)):
            self.weights[:, bone] = 0.5 * self.weights[:, own]
            self.weights[:, own] *= 0.5

    def _stand(self, shrink, keep) -> dict[int, np.ndarray]:
        skeleton = posed(self.standing, self.shape)
        return {b: shrink @ self.placed_node(skeleton, b) for b in keep}

    def placed_node(self, skeleton, joint: int) -> np.ndarray:
        """Return the node's matrix (4, 4) in the scene, in the file's unit."""
        # A node's own axes are a rotation, also where the hand is mirrored.
        flip = np.diag([1.0, 1.0, np.linalg.det(self.turn)])
        matrix = np.eye(4)
        if self.local_turns:
            matrix[:3, :3] = self.turn @ skeleton.frames[joint] @ flip
        matrix[:3, 3] = self.placed(skeleton.joints_m[joint])
        return matrix

    def placed(self, points: np.ndarray) -> np.ndarray:
        return (points @ self.turn.T + np.array(self.shift)) * self.units

    def _collect(self, world, parents, weights, keep) -> None:
        self.joint_nodes = [i for i in keep if i not in TIPS]
        column = {bone: at for at, bone in enumerate(self.joint_nodes)}
        order = np.argsort(-weights, axis=1, kind="stable")[:, : 4 * self.sets]
        order = np.pad(order, ((0, 0), (0, 4 * self.sets - order.shape[1])))
        self.weights_out = np.take_along_axis(weights, order, axis=1)
        self.joints_out = np.array([[column.get(b, 0) for b in row] for row in order])

    def _write(self, world, parents, keep) -> None:
        document = self.document
        self.blob = b""
        node_of = {bone: 1 + at for at, bone in enumerate(keep)}
        shrink = np.diag([1 / self.scale] * 3 + [1.0])
        root = np.diag([self.scale] * 3 + [1.0])
        inside = {b: shrink @ world[b] for b in keep}
        stand = inside if self.standing is None else self._stand(shrink, keep)
        top = Node(name="Armature", scale=[self.scale] * 3, children=[])
        document.nodes = [top]
        for bone in keep:
            parent = -1 if self.siblings else parents[bone]
            own = stand[bone] if parent < 0 else np.linalg.inv(stand[parent]) @ stand[bone]
            children = [node_of[c] for c in keep if parents[c] == bone and not self.siblings]
            document.nodes.append(
                Node(name=self.names[bone], matrix=own.T.reshape(-1).tolist(), children=children)
            )
            if parent < 0:
                top.children.append(node_of[bone])
        inverse = [np.linalg.inv(root @ inside[b]).T.reshape(-1) for b in self.joint_nodes]
        matrices = self.accessor(np.array(inverse), "<f4")
        joints = [node_of[b] for b in self.joint_nodes]
        document.skins = [Skin(joints=joints, inverseBindMatrices=matrices)]
        scale = {"<f4": None, "<u1": 255, "<u2": 65535}[self.weight_type]
        weights = self.weights_out
        if scale is not None:
            weights = np.round(weights * scale)
        attributes = Attributes(POSITION=self.accessor(self.positions, "<f4"))
        for number in range(self.sets):
            part = slice(4 * number, 4 * number + 4)
            joints = self.accessor(self.joints_out[:, part], self.joint_type)
            shares = self.accessor(weights[:, part], self.weight_type, scale is not None)
            setattr(attributes, f"JOINTS_{number}", joints)
            setattr(attributes, f"WEIGHTS_{number}", shares)
        primitives = [
            Primitive(attributes=attributes, indices=self._indices(faces))
            for faces in np.array_split(self.faces, self.primitives)
        ]
        document.meshes = [Mesh(name="skin", primitives=primitives)]
        document.nodes.append(Node(name="HandMesh", mesh=0, skin=0))
        document.scenes = [Scene(nodes=[0, len(document.nodes) - 1])]
        document.scene = 0
        document.buffers = [Buffer(byteLength=len(self.blob))]
        document.set_binary_blob(self.blob)

    def accessor(self, values: np.ndarray, dtype: str, normalized: bool = False) -> int:
        data = np.ascontiguousarray(values.astype(dtype)).tobytes()
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(data))
        self.blob += data
        self.document.bufferViews.append(view)
        kind = {"type": _TYPES.get(values.shape[1], "SCALAR"), "componentType": _KINDS[dtype]}
        kind |= {"count": len(values), "normalized": normalized}
        at = len(self.document.bufferViews) - 1
        self.document.accessors.append(Accessor(bufferView=at, **kind))
        return len(self.document.accessors) - 1

    def _indices(self, faces: np.ndarray) -> int | None:
        kind = self.index_type
        return None if kind is None else self.accessor(faces.reshape(-1, 1), kind)

    def save(self, path: Path, buffers: str = "binary") -> Path:
        document = self.build()
        if path.suffix == ".glb":
            document.save_binary(str(path))
        elif buffers == "data":
            body = base64.b64encode(self.blob).decode()
            document.buffers[0].uri = f"data:application/gltf-buffer;base64,{body}"
            path.write_text(document.to_json())
        else:
            path.with_suffix(".bin").write_bytes(self.blob)
            document.buffers[0].uri = path.with_suffix(".bin").name
            path.write_text(document.to_json())
        return path
