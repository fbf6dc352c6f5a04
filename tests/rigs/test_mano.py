"""MANO models: files read without running them, and the model's equations."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mano_files import ORDER, PARENTS, mano_model, mano_pickle, regressor
from scipy.spatial.transform import Rotation

from clradar.errors import ModelError, RigError
from clradar.hand import JOINT_NAMES, pose_by_name, posed_skeleton
from clradar.hand.joints import CHAINS
from clradar.rigs import read_rig, rotations_of_theta
from clradar.rigs.mano import TIP_VERTICES

TOLERANCE_M = 1e-13
"""float64 throughout: sums of some hundred products of numbers below 1 m, 1e-16 each."""

AT = [JOINT_NAMES.index(name) for name in ORDER]


@pytest.fixture(scope="module")
def model():
    return mano_model()


@pytest.fixture(scope="module")
def path(model, tmp_path_factory):
    file = tmp_path_factory.mktemp("mano") / "MANO_RIGHT.pkl"
    file.write_bytes(mano_pickle(model))
    return file


@pytest.fixture(scope="module")
def rig(path):
    return read_rig(path)


def reference(model, betas, theta):
    """Vertices and 16 joints of the model: the paper's equations, one vertex at a time, with 4x4
    matrices as in SMPL: G_k = prod [R | J], G'_k = G_k with G_k J_k taken off."""
    shaped = model["v_template"] + np.einsum("vcb,b->vc", model["shapedirs"], betas)
    joints = model["J_regressor"].toarray() @ shaped
    rotations = Rotation.from_rotvec(theta.reshape(16, 3)).as_matrix()
    feature = np.concatenate([(r - np.eye(3)).ravel() for r in rotations[1:]])
    posed = shaped + np.einsum("vcp,p->vc", model["posedirs"], feature)
    chain: list[np.ndarray] = []
    for k, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, :3] = rotations[k]
        local[:3, 3] = joints[k] - (joints[parent] if parent >= 0 else 0.0)
        chain.append(local if parent < 0 else chain[parent] @ local)
    places = np.array([g[:3, 3] for g in chain])
    vertices = np.zeros_like(posed)
    for k, g in enumerate(chain):
        moved = (posed - joints[k]) @ g[:3, :3].T + g[:3, 3]
        vertices += model["weights"][:, [k]] * moved
    return vertices, places


@pytest.mark.parametrize(("side", "seed"), [("right", 0), ("left", 1)])
def test_theta_and_beta_give_the_models_own_surface(tmp_path, side, seed):
    made = mano_model(side)
    file = tmp_path / "model.pkl"
    file.write_bytes(mano_pickle(made))
    rng = np.random.default_rng(seed)
    betas, theta = rng.normal(size=10) * seed, 0.6 * rng.normal(size=48)
    rig = read_rig(file, betas=betas, handedness=side)
    assert rig.handedness == side
    posed = rig.turned(rotations_of_theta(rig, theta))
    vertices, joints = reference(made, betas, theta)
    # Into our frame: the orthogonal matrix of the rig, the mirror of a left hand, the wrist.
    mirror = np.diag([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    expected = (vertices - joints[0]) @ rig.axes.T @ mirror
    found = posed.vertices_m - posed.joints_m[0]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE_M, rtol=0)
    expected = (joints - joints[0]) @ rig.axes.T @ mirror
    found = posed.joints_m[AT] - posed.joints_m[0]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE_M, rtol=0)
    assert np.linalg.det(rig.axes @ mirror) == pytest.approx(1.0)
    assert posed.to_trimesh().volume > 0


def test_pose_files_pose_it(tmp_path):
    file = tmp_path / "hand.pkl"
    file.write_bytes(mano_pickle(mano_model("left")))
    rig = read_rig(file, handedness="left")
    assert rig.unit_m == 1.0
    unknown = {n for n, known in zip(JOINT_NAMES, rig.known, strict=True) if not known}
    assert unknown == {n for n in JOINT_NAMES if n.endswith(("tip", "finger-metacarpal"))}
    for pose in ("F", "L"):
        posed = rig.posed(pose)
        expected = posed_skeleton(pose_by_name(pose)).joints_m[AT]
        found = (posed.joints_m[AT] - posed.joints_m[0]) * [-1.0, 1.0, 1.0]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_parameters_that_are_refused(path, rig):
    with pytest.raises(RigError, match=r"RIGHT\.pkl: betas: expected at most 10, got 11"):
        read_rig(path, betas=np.zeros(11))
    with pytest.raises(ModelError, match="betas"):
        read_rig(path, betas=[np.nan])
    with pytest.raises(ModelError, match="theta_rad"):
        rotations_of_theta(rig, np.zeros(45))


def test_fingertips_are_vertices_of_the_released_mesh(tmp_path):
    """A mesh of 778 vertices has its tips at the vertices that are in use everywhere."""
    made = {k: v for k, v in mano_model().items() if isinstance(v, np.ndarray)}
    made["J_regressor"] = mano_model()["J_regressor"].toarray()
    assert len(made["v_template"]) > 778
    # As many as there are in the released files; the faces of the rest are left out.
    cut = {**made, **{k: made[k][:778] for k in ("v_template", "shapedirs", "posedirs", "weights")}}
    cut["f"] = made["f"][(made["f"] < 778).all(axis=1)]
    cut["J_regressor"] = regressor(cut["v_template"], made["J"])
    np.savez(tmp_path / "m.npz", **cut)
    rig = read_rig(tmp_path / "m.npz", handedness="right")
    assert rig.known[JOINT_NAMES.index("thumb-tip")]
    for chain, vertex in zip(CHAINS, TIP_VERTICES, strict=True):
        expected = (cut["v_template"][vertex] - made["J"][0]) @ rig.axes.T
        np.testing.assert_allclose(rig.joints_m[chain[-1]], expected, atol=1e-12)


# --- files


def as_npz(model):
    plain = {k: v.toarray() if hasattr(v, "toarray") else v for k, v in model.items()}
    stream = io.BytesIO()
    np.savez(stream, **plain)
    return stream.getvalue()


KINDS = {
    "protocol 0": lambda model: mano_pickle(model, 0, True),
    "protocol 5": lambda model: mano_pickle(model, 5, False),
    "npz": as_npz,
}


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_every_kind_are_read(tmp_path, rig, model, kind):
    file = tmp_path / ("model.npz" if kind == "npz" else "model.pkl")
    file.write_bytes(KINDS[kind](model))
    np.testing.assert_array_equal(read_rig(file).posed("F").vertices_m, rig.posed("F").vertices_m)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x80\x02cbuiltins\neval\n.", "the name builtins.eval, which no hand model needs"),
        (b"\x80\x02cchumpy.ch\nCh\n)R]b.", "an object whose state is no dictionary"),
    ],
)
def test_invalid_pickles_are_refused(tmp_path, content, message):
    file = tmp_path / "model.pkl"
    file.write_bytes(content)
    with pytest.raises(RigError, match=message):
        read_rig(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": None}, "an array 'weights', got only .'J_regressor', 'f'"),
        ({"weights": lambda w: 0.5 * w}, "weights: expected a sum of 1 .* got 0.5 at vertex 0"),
        ({"weights": lambda w: w[:-1]}, r"weights: expected shape \(\d+, 16\), got shape"),
        ({"v_template": lambda v: v * np.nan}, "v_template: expected finite numbers"),
        ({"f": lambda f: f + np.uint32(10**6)}, r"f: expected indices in \[0, "),
        ({"kintree_table": lambda k: k[:, ::-1]}, "expected the hierarchy of MANO's 16 joints"),
        ({"J_regressor": lambda j: j * 0.0}, "at the same place"),
        ({"J_regressor": lambda j: j.astype(object)}, "Object arrays cannot be loaded"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_wrong_models_are_named(tmp_path, model, change, message):
    ((name, function),) = change.items()
    changed = dict(model)
    if function is None:
        del changed[name]
    else:
        value = model[name]
        changed[name] = function(value.toarray() if hasattr(value, "toarray") else value)
    file = tmp_path / "model.npz"
    file.write_bytes(as_npz(changed))
    with pytest.raises(RigError, match=message) as caught:
        read_rig(file)
    assert str(caught.value).startswith(f"{file}: ")


# --- command line


def test_the_command_poses_a_model(cli, path, rig):
    line = f"hand --rig {path}"
    outcome = cli.ok(f"{line} L --betas 1,-0.5 -o a.ply")
    assert "right hand, unit m, 16 of 25 joints, 'L'" in outcome.out
    theta = 0.2 * np.arange(48) / 48
    Path("t.json").write_text(json.dumps(theta.tolist()))
    cli.ok(f"{line} --theta t.json -o b.ply")
    for name, expected in (
        ("a.ply", read_rig(path, betas=[1.0, -0.5]).posed("L")),
        ("b.ply", rig.turned(rotations_of_theta(rig, theta))),
    ):
        mesh = trimesh.load_mesh(name, process=False)
        np.testing.assert_allclose(mesh.vertices, expected.vertices_m, atol=1e-7)
    Path("t.json").write_text("[1, 2]")
    wanted = "t.json: expected a JSON list of 48 numbers, got 2"
    cli.fails(f"{line} --theta t.json -o x.ply", wanted)
    cli.fails(f"{line} --mapping t.json -o x.ply", "mapping: expected none for a MANO model")
    cli.fails(f"{line} --betas x -o x.ply", "--betas", status=2)
    assert not Path("x.ply").exists()
