"""MANO hand models: Romero, Tzionas and Black, "Embodied Hands", ACM Trans. Graphics 36(6), 2017.

The licence of the model files forbids their distribution; users bring their own. The equations are
those of the paper and of SMPL (Loper et al., 2015), on which it builds:

    T(beta, theta) = template + shapedirs beta + posedirs (R(theta) - I)
    J(beta) = J_regressor (template + shapedirs beta)

and linear blend skinning about the joints J with the weights of the file.
"""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from clradar.errors import RigError
from clradar.files.confined.process import file_bytes
from clradar.files.failures import reading
from clradar.files.limits import MAX_MESH_BYTES, MAX_SPARSE_ELEMENTS
from clradar.files.pickles import ARRAYS, Fixed, Names, PickledArray, array_shape, load, refuse
from clradar.hand import JOINT_NAMES
from clradar.model import checks
from clradar.rigs.anatomy import TIPS
from clradar.rigs.names import side_in
from clradar.rigs.rig import MANO_JOINTS, Rig, Surface, rig_of

EXPECTED = "a MANO hand model (.pkl or .npz)"

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

N_VERTICES = 778
TIP_VERTICES = (744, 320, 443, 554, 671)
"""Vertices of the 778 at the tips, thumb first, as in the package smplx (vertex_ids.py)."""

_N_ANGLES = 3 * (len(MANO_JOINTS) - 1)


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
        side = handedness or side_in(path.stem)
        rows, column = np.nonzero(weights)
        surface = Surface.grouped(
            "model", fields["f"], rows, np.array(MANO_JOINTS)[column],
            weights[rows, column], shaped[rows],
        )  # fmt: skip
        used = np.unique(fields["f"])  # vertices without faces are dropped
        blend = np.ascontiguousarray(fields["posedirs"][used])
        local = np.broadcast_to(np.eye(3), (len(JOINT_NAMES), 3, 3))
        return rig_of(str(path), joints, local, surface, side, unit_m, blend=blend).plain()


def _pickled(content: bytes) -> dict[str, np.ndarray]:
    model = load(content, _NAMES, "hand model")
    if not isinstance(model, dict):
        checks.fail("pickle", "a dictionary", type(model).__name__)
    return {name: as_array(model[name]) for name in _shapes(0) if name in model}


def _npz(content: bytes) -> dict[str, np.ndarray]:
    stream = io.BytesIO(content)
    with zipfile.ZipFile(stream) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_MESH_BYTES:
        checks.fail("archive", f"at most {MAX_MESH_BYTES} bytes", size)
    with np.load(stream, allow_pickle=False) as arrays:
        names = [name for name in _shapes(0) if name in arrays]
        return {name: np.asarray(arrays[name]) for name in names}


def _checked(model: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    if missing := [name for name in _shapes(0) if name not in model]:
        checks.fail("model", f"an array '{missing[0]}'", f"only {sorted(model)}")
    n_vertices = len(np.atleast_1d(model["v_template"]))
    fields = {}
    for name, shape in _shapes(n_vertices).items():
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

    if rig.blend is None:
        checks.fail("rig", "a MANO model", rig.label)
    theta = checks.read_only("theta_rad", theta_rad, np.float64, (3 * len(MANO_JOINTS),))
    # SciPy takes no array that is read-only.
    own = Rotation.from_rotvec(theta.reshape(-1, 3).copy()).as_matrix()
    absolute: list[np.ndarray] = []
    for parent, rotation in zip(PARENTS, own, strict=True):
        absolute.append(rotation if parent < 0 else absolute[parent] @ rotation)
    rotations = np.broadcast_to(absolute[0], (len(JOINT_NAMES), 3, 3)).copy()
    rotations[list(MANO_JOINTS)] = absolute
    return rig.axes @ rotations @ rig.axes.T


# --- pickles of a model: numpy, scipy's sparse matrices, chumpy; see `clradar.files.pickles`

_MAX_NESTING = 6
"""Of chumpy objects; each level can have two inner ones. The models have a Select of a Ch."""


class _Object(metaclass=Fixed):
    """An object with attributes."""

    __slots__ = ("state",)

    def __init__(self, *_arguments: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        # A dictionary, or that and one of the slots.
        both = state if isinstance(state, tuple) and len(state) == 2 else (state,)
        parts = [part for part in both if part is not None]
        if not all(isinstance(part, dict) for part in parts):
            refuse("an object whose state is no dictionary")
        self.state = {name: value for part in parts for name, value in part.items()}


class ByColumns(_Object):
    """A matrix of scipy in compressed columns."""


class Ch(_Object):
    """An object of the package chumpy that holds an array `x`."""


class Select(_Object):
    """One that takes elements of `a`."""


def as_array(value: Any, depth: int = 0) -> np.ndarray:
    """Convert a value of the file to an array: dense, sparse, a number, or of chumpy."""
    if depth > _MAX_NESTING:
        refuse(f"chumpy objects nested more than {_MAX_NESTING} deep")
    if isinstance(value, PickledArray):
        if not isinstance(value.value, np.ndarray):
            refuse("an array of objects where numbers are needed")
        return value.value
    if isinstance(value, ByColumns):
        return _dense(value)
    if isinstance(value, Ch):
        return as_array(value.state.get("x"), depth + 1)
    if isinstance(value, Select):
        source, at = (as_array(value.state.get(name), depth + 1) for name in ("a", "idxs"))
        if at.dtype.kind not in "iu" or (at.size and not 0 <= at.min() <= at.max() < source.size):
            refuse("a chumpy.reordering.Select whose elements do not exist")
        shape = value.state.get("preferred_shape", at.shape)
        if isinstance(shape, PickledArray):
            shape = [int(n) for n in as_array(shape).reshape(-1)]
        shape = tuple(shape) if isinstance(shape, list) else shape
        return source.reshape(-1)[at].reshape(array_shape(at.shape if shape is None else shape))
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return np.asarray(value)
    refuse(f"{type(value).__name__} where an array is needed")


def _dense(value: ByColumns) -> np.ndarray:
    shape = value.state.get("_shape") or value.state.get("shape")
    parts = [value.state.get(name) for name in ("data", "indices", "indptr")]
    if not isinstance(shape, tuple) or not all(isinstance(p, PickledArray) for p in parts):
        refuse("a sparse matrix without data, indices, indptr and shape")
    data, indices, starts = (as_array(part) for part in parts)
    kinds = data.dtype.kind in "iuf", indices.dtype.kind in "iu", starts.dtype.kind in "iu"
    shape = array_shape(shape)
    if len(shape) != 2 or not all(kinds) or math.prod(shape) > MAX_SPARSE_ELEMENTS:
        refuse("a sparse matrix whose parts do not fit together")
    try:
        matrix = csc_matrix((data.astype(np.float64), indices, starts), shape)
        matrix.check_format(full_check=True)
    except ValueError:
        refuse("a sparse matrix whose parts do not fit together")
    return np.asarray(matrix.toarray())


class _Listed(metaclass=Fixed):
    """A set, list or tuple of a list; also `object`, the base of classes that nobody makes."""

    def __new__(cls, items: Any = ()) -> Any:
        if not isinstance(items, list | tuple):
            refuse("a collection of something else than a list")
        return items


class _Dictionary(metaclass=Fixed):
    def __new__(cls, *_arguments: Any) -> Any:
        return {}


class _Reconstructor(metaclass=Fixed):
    """What Python 2 makes objects with: of the class that it is given."""

    def __new__(cls, kind: Any, _base: Any, _state: Any) -> Any:
        if not isinstance(kind, Fixed) or not issubclass(kind, _Object | _Dictionary):
            refuse("an object without a class")
        return kind()


_BUILTINS = {"dict": _Dictionary} | dict.fromkeys(
    ("object", "set", "frozenset", "list", "tuple"), _Listed
)
_SPARSE = ("scipy.sparse", "scipy.sparse.csc", "scipy.sparse._csc")
_NAMES: Names = {
    **ARRAYS,
    ("collections", "OrderedDict"): _Dictionary,
    ("chumpy.ch", "Ch"): Ch,
    ("chumpy", "Ch"): Ch,
    ("chumpy.reordering", "Select"): Select,
    ("copy_reg", "_reconstructor"): _Reconstructor,
    ("copyreg", "_reconstructor"): _Reconstructor,
    **{(m, name): made for m in ("__builtin__", "builtins") for name, made in _BUILTINS.items()},
    **{(module, f"csc_{kind}"): ByColumns for module in _SPARSE for kind in ("matrix", "array")},
}
