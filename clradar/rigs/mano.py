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
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import RigError
from clradar.files.confined.process import file_bytes
from clradar.files.failures import reading
from clradar.files.limits import MAX_MESH_BYTES
from clradar.hand import JOINT_NAMES
from clradar.model import checks
from clradar.rigs.anatomy import TIPS, check_joints, check_side
from clradar.rigs.mano_pickle import as_array, load_mano
from clradar.rigs.names import side_in
from clradar.rigs.rig import MANO_JOINTS, PoseBlend, Rig, Surface, rig_of

EXPECTED = "a MANO hand model (.pkl or .npz)"

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

N_VERTICES = 778
TIP_VERTICES = (744, 320, 443, 554, 671)
"""Vertices of the 778 at the tips, thumb first, as in the package smplx (vertex_ids.py)."""

_N_ANGLES = 3 * (len(MANO_JOINTS) - 1)

_OPTIONAL = {"hands_mean": (_N_ANGLES,), "hands_components": (None, _N_ANGLES)}


def _shapes(n_vertices: int) -> dict[str, tuple[int | None, ...]]:
    """Return the shapes of the arrays of a model."""
    n = len(MANO_JOINTS)
    return {
        "v_template": (n_vertices, 3),
        "shapedirs": (n_vertices, 3, None),
        "posedirs": (n_vertices, 3, 3 * _N_ANGLES),
        "J_regressor": (n, n_vertices),
        "kintree_table": (2, n),
        "weights": (n_vertices, n),
        "f": (None, 3),
    }


def plain_mano(
    path: Path, betas: list[float], unit_m: float, handedness: str | None
) -> dict[str, Any]:
    """Return the rig of a MANO model, in plain types; called in the confined process."""
    content = file_bytes(path, "a MANO model", MAX_MESH_BYTES, error=RigError)
    with reading(path, EXPECTED, error=RigError):
        fields = _checked((_npz if content[:2] == b"PK" else _pickled)(content))
        shapedirs, weights = fields["shapedirs"], fields["weights"]
        if len(betas) > shapedirs.shape[2]:
            checks.fail("betas", f"at most {shapedirs.shape[2]}", len(betas))
        shaped = fields["v_template"] + shapedirs[:, :, : len(betas)] @ np.array(betas, np.float64)
        joints = np.full((len(JOINT_NAMES), 3), np.nan)
        joints[list(MANO_JOINTS)] = fields["J_regressor"] @ shaped
        if len(shaped) == N_VERTICES:
            joints[list(TIPS)] = shaped[list(TIP_VERTICES)]
        check_joints(joints)
        side = check_side(joints, handedness or side_in(path.stem))
        rows, column = np.nonzero(weights)
        surface = Surface.grouped(
            "model", fields["f"], rows, np.array(MANO_JOINTS)[column],
            weights[rows, column], shaped[rows],
        )  # fmt: skip
        used = np.unique(fields["f"])  # vertices without faces are dropped
        blend = PoseBlend(
            directions=np.ascontiguousarray(fields["posedirs"][used]),
            hands_mean=fields.get("hands_mean", np.zeros(_N_ANGLES)),
            hands_components=fields.get("hands_components", np.zeros((0, _N_ANGLES))),
        )
        local = np.broadcast_to(np.eye(3), (len(JOINT_NAMES), 3, 3))
        return rig_of(str(path), joints, local, surface, side, unit_m, blend=blend).plain()


def _pickled(content: bytes) -> dict[str, np.ndarray]:
    model = load_mano(content)
    if not isinstance(model, dict):
        checks.fail("pickle", "a dictionary", type(model).__name__)
    return {name: as_array(model[name]) for name in (*_shapes(0), *_OPTIONAL) if name in model}


def _npz(content: bytes) -> dict[str, np.ndarray]:
    stream = io.BytesIO(content)
    with zipfile.ZipFile(stream) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_MESH_BYTES:
        checks.fail("archive", f"at most {MAX_MESH_BYTES} bytes", size)
    with np.load(stream, allow_pickle=False) as arrays:
        names = [name for name in (*_shapes(0), *_OPTIONAL) if name in arrays]
        return {name: np.asarray(arrays[name]) for name in names}


def _checked(model: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    if missing := [name for name in _shapes(0) if name not in model]:
        checks.fail("model", f"an array '{missing[0]}'", f"only {sorted(model)}")
    n_vertices = len(np.atleast_1d(model["v_template"]))
    fields = {}
    for name, shape in {**_shapes(n_vertices), **_OPTIONAL}.items():
        if name in model:
            dtype = np.int64 if name == "f" else np.float64
            checks.read_only(name, model[name], dtype, shape)
            fields[name] = model[name].astype(dtype)
    tree = fields["kintree_table"]
    checks.indices("f", fields["f"], n_vertices)
    # The root's parent is -1, written as an unsigned number.
    parents = [-1 if p < 0 or p >= len(MANO_JOINTS) else int(p) for p in tree[0]]
    if tuple(parents) != PARENTS or tree[1].tolist() != list(range(len(MANO_JOINTS))):
        checks.fail("kintree_table", "the hierarchy of MANO's 16 joints", parents)
    return fields


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

    _check_model(rig)
    theta = checks.read_only("theta_rad", theta_rad, np.float64, (3 * len(MANO_JOINTS),))
    # SciPy takes no array that is read-only.
    own = Rotation.from_rotvec(theta.reshape(-1, 3).copy()).as_matrix()
    absolute: list[np.ndarray] = []
    for parent, rotation in zip(PARENTS, own, strict=True):
        absolute.append(rotation if parent < 0 else absolute[parent] @ rotation)
    rotations = np.broadcast_to(absolute[0], (len(JOINT_NAMES), 3, 3)).copy()
    rotations[list(MANO_JOINTS)] = absolute
    return rig.axes @ rotations @ rig.axes.T


def _check_model(rig: Rig) -> None:
    if rig.blend is None:
        checks.fail("rig", "a MANO model", rig.label)


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

    _check_model(rig)
    absolute = (rig.axes.T @ rotations @ rig.axes)[list(MANO_JOINTS)]
    own = [r if p < 0 else absolute[p].T @ r for p, r in zip(PARENTS, absolute, strict=True)]
    return Rotation.from_matrix(np.stack(own)).as_rotvec().reshape(-1)
