"""MANO hand models: Romero, Tzionas and Black, "Embodied Hands", ACM Trans. Graphics 36(6), 2017.

The licence of the model files forbids their distribution; users bring their own. The equations are
those of the paper and of SMPL (Loper et al., 2015), on which it builds:

    T(beta, theta) = template + shapedirs beta + posedirs (R(theta) - I)
    J(beta) = J_regressor (template + shapedirs beta)

and linear blend skinning about the joints J with the weights of the file.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.confined.process import forbid_opening
from clradar.files.limits import MAX_MESH_BYTES
from clradar.files.pickles import UnsafePickle
from clradar.hand.joints import JOINT_INDEX, JOINT_NAMES
from clradar.model import checks
from clradar.rigs.anatomy import check_joints, check_side
from clradar.rigs.failures import fail, file_bytes, reading
from clradar.rigs.mano_pickle import as_array, load_mano
from clradar.rigs.names import side_in
from clradar.rigs.rig import PoseBlend, Rig
from clradar.rigs.rigging import Surface, rig_of

EXPECTED = "a MANO hand model (.pkl or .npz)"

_FINGER_JOINTS = ("phalanx-proximal", "phalanx-intermediate", "phalanx-distal")
_THUMB_JOINTS = ("metacarpal", "phalanx-proximal", "phalanx-distal")
MANO_JOINTS: tuple[int, ...] = (
    JOINT_INDEX["wrist"],
    *(
        JOINT_INDEX[f"{f}-finger-{b}"]
        for f in ("index", "middle", "pinky", "ring")
        for b in _FINGER_JOINTS
    ),
    *(JOINT_INDEX[f"thumb-{bone}"] for bone in _THUMB_JOINTS),
)
"""The model's 16 joints, in its order, as indices into `JOINT_NAMES`."""

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

N_VERTICES = 778
TIP_VERTICES = {
    "thumb-tip": 744,
    "index-finger-tip": 320,
    "middle-finger-tip": 443,
    "ring-finger-tip": 554,
    "pinky-finger-tip": 671,
}
"""Vertices of the 778 at the fingertips, as in the package smplx (vertex_ids.py)."""

_N_ANGLES = 3 * (len(MANO_JOINTS) - 1)

_SHAPES = {
    "v_template": "(V, 3)",
    "shapedirs": "(V, 3, B)",
    "posedirs": f"(V, 3, {3 * _N_ANGLES})",
    "J_regressor": f"({len(MANO_JOINTS)}, V)",
    "kintree_table": f"(2, {len(MANO_JOINTS)})",
    "weights": f"(V, {len(MANO_JOINTS)})",
    "f": "(F, 3)",
}
_OPTIONAL = {"hands_mean": f"({_N_ANGLES},)", "hands_components": f"(N, {_N_ANGLES})"}


def plain_mano(
    path: Path, betas: list[float], unit: str | float | None, handedness: str | None
) -> dict[str, Any]:
    """Return the rig of a MANO model, in plain types; called in the confined process."""
    content = file_bytes(path, "a MANO model")
    forbid_opening()
    with reading(path, EXPECTED):
        try:
            model = (_npz if content[:2] == b"PK" else _pickled)(path, content)
        except UnsafePickle as error:
            fail(path, EXPECTED, error)
        return mano_rig(path, checked_fields(path, model), betas, unit, handedness).plain()


def mano_rig(
    path: Path,
    fields: dict[str, np.ndarray],
    betas: Sequence[float],
    unit: str | float | None,
    handedness: str | None,
) -> Rig:
    """Return the rig of the fields of a model, of a shape."""
    shapedirs, weights = fields["shapedirs"], fields["weights"]
    if len(betas) > shapedirs.shape[2]:
        fail(path, f"at most {shapedirs.shape[2]} betas", len(betas))
    shaped = fields["v_template"] + shapedirs[:, :, : len(betas)] @ np.array(betas, np.float64)
    joints = np.full((len(JOINT_NAMES), 3), np.nan)
    joints[list(MANO_JOINTS)] = fields["J_regressor"] @ shaped
    if len(shaped) == N_VERTICES:
        joints[[JOINT_INDEX[name] for name in TIP_VERTICES]] = shaped[[*TIP_VERTICES.values()]]
    check_joints(str(path), joints)
    side = check_side(str(path), joints, handedness or side_in(path.stem))
    rows, column = np.nonzero(weights)
    surface = Surface.grouped(
        path, "weights", fields["f"], rows, np.array(MANO_JOINTS)[column],
        weights[rows, column], shaped[rows],
    )  # fmt: skip
    used = np.unique(fields["f"])  # vertices without faces are dropped
    blend = PoseBlend(
        joints=MANO_JOINTS[1:],
        directions=np.ascontiguousarray(fields["posedirs"][used]),
        hands_mean=fields.get("hands_mean", np.zeros(_N_ANGLES)),
        hands_components=fields.get("hands_components", np.zeros((0, _N_ANGLES))),
    )
    local = np.broadcast_to(np.eye(3), (len(JOINT_NAMES), 3, 3))
    return rig_of(str(path), joints, local, surface, side, unit, blend=blend)


def _pickled(path: Path, content: bytes) -> dict[str, np.ndarray]:
    model = load_mano(content)
    if not isinstance(model, dict):
        fail(path, EXPECTED, f"a pickle of {type(model).__name__}")
    return {name: as_array(model[name]) for name in (*_SHAPES, *_OPTIONAL) if name in model}


def _npz(path: Path, content: bytes) -> dict[str, np.ndarray]:
    stream = io.BytesIO(content)
    with zipfile.ZipFile(stream) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_MESH_BYTES:
        fail(path, f"an archive of at most {MAX_MESH_BYTES} bytes", size)
    with np.load(stream, allow_pickle=False) as arrays:
        names = [name for name in (*_SHAPES, *_OPTIONAL) if name in arrays]
        return {name: np.asarray(arrays[name]) for name in names}


def checked_fields(path: Path, model: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the model's arrays, checked."""
    if missing := [name for name in _SHAPES if name not in model]:
        fail(path, f"{EXPECTED}, with '{missing[0]}'", f"only {sorted(model)}")
    sizes: dict[str, int] = {}
    fields = {}
    for name, text in {**_SHAPES, **_OPTIONAL}.items():
        if name not in model:
            continue
        array, axes = model[name], text.strip("(),").split(", ")
        fits = array.ndim == len(axes) and array.dtype.kind in "iuf" and array.size > 0
        for axis, n in zip(axes, array.shape, strict=False):
            size = int(axis) if axis.isdecimal() else sizes.setdefault(axis, n)
            fits = fits and n == size
        if not fits:
            known = ", ".join(f"{k} = {v}" for k, v in sizes.items())
            fail(path, f"'{name}' of shape {text} with {known}", f"{array.dtype} {array.shape}")
        if not np.isfinite(array).all():
            fail(path, f"finite numbers in '{name}'", "NaN or infinite ones")
        fields[name] = array.astype(np.int64 if name in ("f", "kintree_table") else np.float64)
    faces, tree = fields["f"], fields["kintree_table"]
    if faces.min() < 0 or faces.max() >= sizes["V"]:
        fail(path, f"faces with vertices below {sizes['V']}", f"[{faces.min()}, {faces.max()}]")
    # The root's parent is -1, written as an unsigned number.
    parents = [-1 if p < 0 or p >= len(MANO_JOINTS) else int(p) for p in tree[0]]
    if tuple(parents) != PARENTS or tree[1].tolist() != list(range(len(MANO_JOINTS))):
        fail(path, "the hierarchy of MANO's 16 joints in 'kintree_table'", parents)
    return fields


def _blend_of(rig: Rig) -> PoseBlend:
    if rig.blend is None:
        checks.fail("rig", "a MANO model", rig.label)
    return rig.blend


def theta_of_components(
    rig: Rig, coefficients: Any, global_rad: Any = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Return a pose theta (48,) of principal components of MANO.

    theta = [global, hands_mean + coefficients @ hands_components], of up to as many coefficients as
    the model has components; `global_rad` turns the whole hand, in the model's frame.

    Examples
    --------
    >>> clradar.rigs.theta_of_components(rig, [0.5])[3:6].tolist()
    [0.5, 0.0, 0.0]
    """
    blend = _blend_of(rig)
    amounts = checks.read_only("coefficients", coefficients, np.float64, (None,), allow_empty=True)
    if len(amounts) > len(blend.hands_components):
        expected = f"at most {len(blend.hands_components)} coefficients"
        checks.fail("coefficients", expected, len(amounts))
    first = checks.read_only("global_rad", global_rad, np.float64, (3,))
    rest = blend.hands_mean + amounts @ blend.hands_components[: len(amounts)]
    return np.concatenate([first, rest])


def rotations_of_theta(rig: Rig, theta_rad: Any) -> np.ndarray:
    """Return the absolute rotations that `Rig.turned` takes, (25, 3, 3), of a pose theta (48,).

    Theta has axis times angle, radians, of each of the 16 joints against its parent, in the model's
    order and frame; the first turns the whole hand. `hands_mean` is not added. Joints that MANO
    lacks rotate with the wrist.

    Examples
    --------
    A quarter turn about x bends the index finger's first joint of a hand along +y.

    >>> theta = np.zeros(48)
    >>> theta[3] = -np.pi / 2
    >>> (clradar.rigs.rotations_of_theta(rig, theta)[6] @ [0.0, 1.0, 0.0]).round(6).tolist()
    [0.0, 0.0, -1.0]
    """
    from scipy.spatial.transform import Rotation

    _blend_of(rig)
    theta = checks.read_only("theta_rad", theta_rad, np.float64, (3 * len(MANO_JOINTS),))
    # SciPy takes no array that is read-only.
    own = Rotation.from_rotvec(theta.reshape(-1, 3).copy()).as_matrix()
    absolute: list[np.ndarray] = []
    for parent, rotation in zip(PARENTS, own, strict=True):
        absolute.append(rotation if parent < 0 else absolute[parent] @ rotation)
    rotations = np.broadcast_to(absolute[0], (len(JOINT_NAMES), 3, 3)).copy()
    rotations[list(MANO_JOINTS)] = absolute
    return rig.axes @ rotations @ rig.axes.T


def theta_of_rotations(rig: Rig, rotations: np.ndarray) -> np.ndarray:
    """Return the pose theta (48,) of absolute rotations (25, 3, 3), as of `Rig.rotations`.

    Examples
    --------
    >>> theta = np.linspace(-0.5, 0.5, 48)
    >>> rotations = clradar.rigs.rotations_of_theta(rig, theta)
    >>> bool(np.allclose(clradar.rigs.theta_of_rotations(rig, rotations), theta))
    True
    """
    from scipy.spatial.transform import Rotation

    _blend_of(rig)
    absolute = (rig.axes.T @ rotations @ rig.axes)[list(MANO_JOINTS)]
    own = [r if p < 0 else absolute[p].T @ r for p, r in zip(PARENTS, absolute, strict=True)]
    return Rotation.from_matrix(np.stack(own)).as_rotvec().reshape(-1)
