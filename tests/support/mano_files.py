"""Small hand models of the form of MANO's files; the real ones may not be passed on.

The surface is the hand of this package, the blend shapes are drawn at random.
"""

import io
import pickle
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np
from rig_files import bone_weights
from scipy.sparse import csc_matrix

from clradar.hand import JOINT_NAMES, hand_mesh, pose_by_name, posed_skeleton

# MANO's order: wrist, then three joints each of index, middle, little, ring finger and thumb.
ORDER = [
    "wrist",
    *(
        f"{finger}-finger-phalanx-{bone}"
        for finger in ("index", "middle", "pinky", "ring")
        for bone in ("proximal", "intermediate", "distal")
    ),
    "thumb-metacarpal",
    "thumb-phalanx-proximal",
    "thumb-phalanx-distal",
]
PARENTS = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]
# The model's right hand has its fingers along -x and its palm towards -y, or nearly so.
TURN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


def mano_model(side: str = "right") -> dict[str, Any]:
    """Return the fields of a model, in the types that the released files have."""
    rng = np.random.default_rng(5)
    mesh = hand_mesh("flat", edge_length_m=4e-3)
    bones = posed_skeleton(pose_by_name("flat")).joints_m
    vertices, triangles = _coarser(mesh.vertices_m - mesh.joints_m[0] + bones[0], mesh.faces)
    wide = bone_weights(vertices, bones)
    weights = np.stack([wide[:, JOINT_NAMES.index(name)] for name in ORDER], axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    joints = np.stack([bones[JOINT_NAMES.index(name)] for name in ORDER])
    mirror = np.diag([1.0 if side == "right" else -1.0, 1.0, 1.0])
    place = lambda points: points @ TURN.T @ mirror + [0.09, 0.006, 0.006]  # noqa: E731
    faces = triangles if side == "right" else triangles[:, [0, 2, 1]]
    template = place(vertices)
    # Smooth shapes: a quadratic of the place, some millimetres at beta = 1.
    x = (template - template.mean(axis=0)) / 0.1
    terms = np.concatenate([x, x**2, x[:, [0]] * x[:, [1]]], axis=1)
    shapedirs = 2e-3 * np.einsum("vt,tcb->vcb", terms, rng.normal(size=(7, 3, 10)))
    posedirs = 2e-4 * np.einsum("vt,tcb->vcb", terms, rng.normal(size=(7, 3, 135)))
    components, _ = np.linalg.qr(rng.normal(size=(45, 45)))
    return {
        "v_template": template,
        "shapedirs": shapedirs,
        "posedirs": posedirs,
        "J_regressor": csc_matrix(regressor(template, place(joints))),
        "kintree_table": np.array([PARENTS, range(16)], dtype=np.int64).astype(np.uint32),
        "weights": weights,
        "f": faces.astype(np.uint32),
        "hands_components": components,
        "hands_mean": 0.1 * rng.normal(size=45),
        "hands_coeffs": rng.normal(size=(12, 45)),
        "J": place(joints),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


def _coarser(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh of about as many vertices as MANO's: those of a cell of 6.5 mm become one."""
    _, cell = np.unique(np.round(vertices / 6.5e-3), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    count = np.bincount(cell)
    means = np.stack([np.bincount(cell, column) / count for column in vertices.T], axis=1)
    corners = cell[faces]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    used, corners = np.unique(corners[whole], return_inverse=True)
    return means[used], corners.reshape(-1, 3)


def regressor(vertices: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the matrix (16, V) that makes the joints of the vertices, which sums to 1."""
    at, wanted = (np.column_stack([points, np.ones(len(points))]) for points in (vertices, joints))
    found: np.ndarray = np.linalg.lstsq(at.T, wanted.T, rcond=None)[0].T
    return found


class _Writer(pickle._Pickler):
    """Writes bytes as strings, as Python 2 did."""

    dispatch: ClassVar[dict[type, Any]] = dict(pickle._Pickler.dispatch)

    def _string(self, value: bytes) -> None:
        if self.bin:
            self.write(pickle.BINSTRING + len(value).to_bytes(4, "little") + value)
        else:
            self.write(pickle.STRING + repr(value)[1:].encode("ascii") + b"\n")
        self.memoize(value)

    dispatch[bytes] = _string


class _Holder:
    """Placeholder of a class of chumpy while a pickle is written."""

    def __init__(self, **state: Any) -> None:
        self.__dict__.update(state, _dirty_vars={"x"}, dterms=("x",))


@contextmanager
def chumpy_classes() -> Iterator[tuple[type, type]]:
    """Yield `chumpy.ch.Ch` and `chumpy.reordering.Select`, of modules that exist here only."""
    made = {}
    for module, name in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")):
        sys.modules[module] = types.ModuleType(module)
        made[name] = type(name, (_Holder,), {"__module__": module})
        setattr(sys.modules[module], name, made[name])
    sys.modules["chumpy"] = types.ModuleType("chumpy")
    try:
        yield made["Ch"], made["Select"]
    finally:
        for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
            del sys.modules[name]


def mano_pickle(model: dict[str, Any], protocol: int = 2, python_2: bool = True) -> bytes:
    """Return the pickle of a model, its shapedirs behind two objects of chumpy as in the files."""
    with chumpy_classes() as (Ch, Select):
        content = dict(model)
        directions = np.asarray(model["shapedirs"])
        # The files have more directions than are used; a Select takes the first ten.
        more = np.concatenate([directions, np.full_like(directions, 7.0)], axis=2)
        at = np.arange(more.size).reshape(more.shape)[:, :, : directions.shape[2]].reshape(-1)
        content["shapedirs"] = Select(a=Ch(x=more), idxs=at, preferred_shape=directions.shape)
        content["posedirs"] = Ch(x=model["posedirs"])
        stream = io.BytesIO()
        writer = _Writer if python_2 else pickle.Pickler
        writer(stream, protocol).dump(content)
        return stream.getvalue()
