"""Skinned glTF hands: joints, unit, side and pose; and the errors of invalid files."""

import json
import pickle
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pygltflib import GLTF2, Attributes, Sparse
from rig_files import TIPS, RigMaker
from scipy.spatial.transform import Rotation

from clradar import Scene
from clradar.errors import ClradarWarning, ModelError, RigError
from clradar.hand import (
    JOINT_NAMES,
    HandPose,
    JointAngles,
    hand_mesh,
    pose_by_name,
    posed_skeleton,
    write_pose,
)
from clradar.hand.flesh import PART_NAMES
from clradar.rigs import UNITS_M, read_rig

JOINT_TOLERANCE_M = 1e-12
"""Joints go through about ten products of 4x4 matrices of float64 with entries up to 4 m in the
file's unit, each good to 1e-16 of that: some 1e-14 m."""

VERTEX_TOLERANCE_M = 2e-6
"""Vertices and inverse bind matrices are float32 in the file: 6e-8 of coordinates up to 4 m, once
in the vertex and once in each of the matrix's products and translation."""

NEAR_MEAN_M, NEAR_95_M = 1e-3, 4e-3
"""How far skinned surfaces are from one grown in that pose, for poses in which no finger folds onto
the palm: linear blending thins bent joints, and the weights come from distances to the bones. An
eighth of the wavelength in the mean, a wavelength at the worst twentieth. Skin that followed the
wrong bone would be centimetres off: a bent finger's last joint moves by 40 mm."""

TURN = Rotation.from_rotvec([0.5, -1.2, 2.0]).as_matrix()
MIRROR = np.diag([-1.0, 1.0, 1.0])
FLAT = {"turn": np.diag([1.0, 1.0, 1e-3]), "local_turns": False}
"""Squeezed into a plane, thumb and all, a hand is its own mirror image."""
TIP_NAMES = tuple(JOINT_NAMES[i] for i in TIPS)
METACARPALS = tuple(n for n in JOINT_NAMES if n.endswith("finger-metacarpal"))


def make(tmp_path, name="hand.glb", **settings):
    return RigMaker(**settings).save(tmp_path / name)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The rig without peculiarities."""
    return read_rig(make(tmp_path_factory.mktemp("plain")))


def joints_about_wrist(mesh, side="right"):
    joints_m = mesh.joints_m - mesh.joints_m[0]
    return joints_m * ([-1.0, 1.0, 1.0] if side == "left" else 1.0)


def about_wrist(mesh):
    return np.asarray(mesh.vertices_m - mesh.joints_m[0])


TURNED = HandPose("turned", {"wrist": JointAngles.from_degrees(flexion_deg=30.0)})

# --- hands that are posed rightly however they come

KINDS = {
    "centimetres": {"units": 100.0, "turn": TURN, "shift": (1.0, -2.0, 3.0)},
    "scaled armature": {"scale": 0.01, "turn": TURN, "bones": True},
    "millimetres, left": {"units": 1e3, "turn": TURN @ MIRROR, "called": "{}_l".format},
    "inches, upper case": {
        "units": 1 / 25.4e-3,
        "turn": TURN.T,
        "called": lambda n: f"B_R_{n.upper().replace('-', '_')}_17",
    },
    "scaled twice": {"units": 0.01},
    "siblings": {"siblings": True, "bones": True, "turn": TURN},
    "bound flat, standing as F": {"standing": "F", "turn": TURN},
    "bound as L": {"pose": "L", "turn": TURN},
    "camel case": {
        "called": lambda n: "Right" + "".join(w.title() for w in n.split("-")),
        "weight_type": "<u1",
        "index_type": "<u2",
        "sets": 2,
        "joint_type": "<u2",
    },
}
UNITS = {"centimetres": "cm", "millimetres, left": "mm", "inches, upper case": "inch"}
UNITS["scaled twice"] = "100 m"


def read_kind(folder, kind):
    return read_rig(make(folder, **KINDS[kind]), unit=UNITS.get(kind))


@pytest.mark.parametrize("kind", KINDS)
def test_joints_are_those_of_the_posed_skeleton(tmp_path, kind):
    rig = read_kind(tmp_path, kind)
    side = "left" if "left" in kind else "right"
    assert rig.handedness == side
    assert rig.unit_m == UNITS_M[UNITS.get(kind, "m")]
    assert rig.known.all()
    for pose in (*(pose_by_name(name) for name in ("flat", "F", "A", "W")), TURNED):
        found = joints_about_wrist(rig.posed(pose), side)
        expected = posed_skeleton(pose).joints_m
        np.testing.assert_allclose(found, expected, atol=JOINT_TOLERANCE_M, rtol=0)


@pytest.mark.parametrize(
    ("kind", "pose"), [("millimetres, left", "F"), ("bound flat, standing as F", "W")]
)
def test_the_surface_is_close_to_that_of_the_pose(tmp_path, kind, pose):
    rig = read_kind(tmp_path, kind)
    ours = hand_mesh(pose, edge_length_m=4e-3, handedness=rig.handedness)
    posed = rig.posed(pose)
    moved = posed.vertices_m - posed.joints_m[0] + ours.joints_m[0]
    away_m = np.abs(trimesh.proximity.closest_point(ours.to_trimesh(), moved)[1])
    assert away_m.mean() < NEAR_MEAN_M
    assert np.percentile(away_m, 95) < NEAR_95_M
    assert posed.to_trimesh().volume > 0  # outside out
    middle_m = 0.5 * (posed.vertices_m.min(axis=0) + posed.vertices_m.max(axis=0))
    np.testing.assert_allclose(middle_m, [0.0, 0.0, 0.3], atol=1e-12)


def test_at_rest_the_surface_is_the_files_own(tmp_path):
    for settings in ({"bones": True, "scale": 0.01, "turn": TURN}, {"primitives": 3}):
        rig = read_rig(make(tmp_path, **settings))
        ours = hand_mesh("flat", edge_length_m=4e-3)
        posed = rig.posed("flat", center_m=(0.0, 0.01, 0.4))
        np.testing.assert_allclose(about_wrist(posed), about_wrist(ours), atol=VERTEX_TOLERANCE_M)
        # Turned by nothing, every vertex is where its weights have it at rest, to the last bits.
        same = rig.turned(np.broadcast_to(np.eye(3), (25, 3, 3)))
        rest_m = same.texture_m - rig.joints_m[0]
        np.testing.assert_allclose(about_wrist(same), rest_m, atol=1e-15)
        np.testing.assert_array_equal(rig.posed("A").texture_m, same.texture_m)
        np.testing.assert_array_equal(Scene.from_mesh(posed).texture_m, same.texture_m)
        assert posed.part_names == ours.part_names
        for part in range(1, 6):
            shares = [m.to_trimesh().area_faces[m.part == part].sum() for m in (posed, ours)]
            assert shares[0] == pytest.approx(shares[1], rel=0.35)
    left = read_rig(make(tmp_path, turn=MIRROR), handedness="left").posed("A")
    right = read_rig(make(tmp_path)).posed("A")
    np.testing.assert_allclose(left.texture_m, right.texture_m, atol=VERTEX_TOLERANCE_M)


def test_a_bent_finger_has_its_closed_form(tmp_path):
    """Index finger bent by 60 degrees at the knuckle, in a plane rolled by 8 degrees."""
    straight = HandPose("straight")
    sixty = JointAngles.from_degrees(flexion_deg=60.0)
    bent = HandPose("bent", {"index-finger-phalanx-proximal": sixty})
    path = make(tmp_path, pose=straight, units=100.0, turn=TURN, shift=(1.0, 1.0, 1.0))
    rig = read_rig(path, unit="cm")
    before, after = rig.posed(straight), rig.posed(bent)
    knuckle, last = (JOINT_NAMES.index(f"index-finger-phalanx-{b}") for b in ("proximal", "distal"))
    roll, angle = np.deg2rad(8.0), np.deg2rad(60.0)
    along = [-np.sin(roll) * np.sin(angle), np.cos(angle), -np.cos(roll) * np.sin(angle)]
    reach = np.linalg.norm(before.joints_m[last] - before.joints_m[knuckle])
    at = after.joints_m[last] - after.joints_m[knuckle]
    np.testing.assert_allclose(at, reach * np.array(along), atol=JOINT_TOLERANCE_M)
    # Vertices that only the last bone moves turn about the bending axis with it.
    rows = rig.skin
    alone = rows.point[(rows.bone == last) & (rows.weight > 1 - 1e-6)]
    assert len(alone) > 20
    axis = np.array([np.cos(roll), 0.0, -np.sin(roll)])
    turn = Rotation.from_rotvec(-angle * axis).as_matrix()
    knuckle_m = before.joints_m[knuckle] - before.joints_m[0]
    expected = knuckle_m + (about_wrist(before)[alone] - knuckle_m) @ turn.T
    np.testing.assert_allclose(about_wrist(after)[alone], expected, atol=VERTEX_TOLERANCE_M)
    # The rest of the hand stands still.
    still = np.setdiff1d(np.arange(len(rig.skin)), rows.point[np.isin(rows.bone, range(6, 10))])
    expected = about_wrist(before)[still]
    np.testing.assert_allclose(about_wrist(after)[still], expected, atol=1e-14)


def test_a_rig_keeps_its_own_proportions(tmp_path):
    """A hand stretched by 1.3 along the fingers: other lengths, the same directions."""

    rig = read_rig(make(tmp_path, turn=np.diag([1.0, 1.3, 1.0]), local_turns=False))
    found = rig.posed("L").joints_m
    expected = posed_skeleton(pose_by_name("L")).joints_m
    for begin in (6, 7, 8, 11, 12, 21, 22, 23):
        along, wanted = (j[begin + 1] - j[begin] for j in (found, expected))
        cosine = along @ wanted / np.linalg.norm(along) / np.linalg.norm(wanted)
        assert cosine == pytest.approx(1.0, abs=1e-12), JOINT_NAMES[begin]
    assert np.linalg.norm(found[7] - found[6]) == pytest.approx(1.3 * 39.8e-3, rel=0.01)


def test_tips_and_metacarpals_may_be_missing(tmp_path, plain):
    skip = (*TIP_NAMES, *METACARPALS)
    whole = plain.posed("F")
    rig = read_rig(make(tmp_path, skip=skip, turn=TURN))
    posed = rig.posed("F")
    assert {n for n, known in zip(JOINT_NAMES, rig.known, strict=True) if not known} == set(skip)
    found, expected = joints_about_wrist(posed), joints_about_wrist(whole)
    assert np.array_equal(np.isnan(found).all(axis=1), ~rig.known)
    near = {"atol": JOINT_TOLERANCE_M}
    np.testing.assert_allclose(found[rig.known], expected[rig.known], **near)
    # The last bones lie along the same axis of their nodes as those before, as in this rig.
    np.testing.assert_allclose(about_wrist(posed), about_wrist(whole), atol=VERTEX_TOLERANCE_M)


def test_a_last_bone_without_tip_and_axes_points_to_its_flesh(tmp_path):
    """Upright nodes do not define the direction of a bent finger's last bone."""
    rig = read_rig(make(tmp_path, pose="L", skip=TIP_NAMES, local_turns=False))
    exact = posed_skeleton(pose_by_name("L"))
    for name in ("middle-finger-phalanx-distal", "thumb-phalanx-distal"):
        at = JOINT_NAMES.index(name)
        cosine = rig.frames[at][:, 1] @ exact.frames[at][:, 1]
        assert np.rad2deg(np.arccos(cosine)) < 10.0, name  # it bends by more than 40 here


# --- how files hold it


def interleaved(path):
    """Positions between other bytes: 12 of 20 belong to them, from the fifth on."""
    maker = RigMaker()
    document = maker.build()
    wide = np.zeros((len(maker.positions), 20), np.uint8)
    wide[:, 4:16] = maker.positions.astype("<f4").view(np.uint8).reshape(-1, 12)
    place = document.meshes[0].primitives[0].attributes.POSITION
    at = maker.accessor(wide, "<u1")
    accessor = document.accessors[place]
    accessor.bufferView = document.accessors[at].bufferView
    accessor.byteOffset = 4
    document.bufferViews[accessor.bufferView].byteStride = 20
    return rewritten(document, maker, path / "wide.glb")


def unindexed(maker):
    """Corners at one place with one skin are one vertex."""
    corners = maker.faces.reshape(-1)
    maker.positions = maker.positions[corners]
    maker.weights_out, maker.joints_out = maker.weights_out[corners], maker.joints_out[corners]


@pytest.mark.parametrize(
    ("save", "unit", "tolerance_m"),
    [
        pytest.param(lambda at: RigMaker().save(at / "x.gltf", "data"), None, 0.0, id="inside"),
        pytest.param(lambda at: RigMaker().save(at / "x.gltf", "file"), None, 0.0, id="beside"),
        pytest.param(interleaved, None, 0.0, id="interleaved"),
        pytest.param(lambda at: make(at, index_type=None, edit=unindexed), None, None, id="lists"),
        pytest.param(lambda at: make(at, units=5.0), 0.2, VERTEX_TOLERANCE_M, id="unit"),
    ],
)
def test_a_hand_is_read_however_the_file_holds_it(tmp_path, plain, save, unit, tolerance_m):
    rig = read_rig(save(tmp_path), unit=unit)
    assert rig.unit_m == (unit or 1.0)
    assert len(rig.skin) == len(plain.skin)
    np.testing.assert_allclose(rig.skin.weights.sum(axis=1), 1.0, atol=1e-15)
    found, expected = (one.posed("F") for one in (rig, plain))
    assert found.to_trimesh().is_watertight
    if tolerance_m is not None:  # else the vertices have another order
        assert np.abs(found.vertices_m - expected.vertices_m).max() <= tolerance_m


def rewritten(document, maker, path):
    document.buffers[0].byteLength = len(maker.blob)
    document.set_binary_blob(maker.blob)
    document.save_binary(str(path))
    return path


def test_a_rigid_mesh_below_a_joint_moves_with_it(tmp_path):
    maker = RigMaker(called="{}.R".format)
    document = maker.build()
    count = len(document.nodes)
    document.nodes += [document.nodes[0].__class__(name="ring", mesh=1)]
    document.nodes += [document.nodes[0].__class__(name="table", mesh=1, translation=[0, -5, 0])]
    bone = next(n for n in document.nodes if n.name == "ring-finger-phalanx-proximal.R")
    bone.children.append(count)
    document.scenes[0].nodes.append(count + 1)
    small = 1e-3 * np.array([[0, 0, 12], [1, 0, 12], [0, 1, 12]])
    primitive = document.meshes[0].primitives[0].__class__()
    primitive.attributes.POSITION = maker.accessor(small, "<f4")
    document.meshes.append(document.meshes[0].__class__(name="gem", primitives=[primitive]))
    with pytest.warns(ClradarWarning, match=r"ring\.glb: .* does not move .*: 'gem'$"):
        rig = read_rig(rewritten(document, maker, tmp_path / "ring.glb"))
    assert rig.ignored == ("gem",)  # the one that stands beside the hand
    skeleton = posed_skeleton(pose_by_name("A"))
    at = JOINT_NAMES.index("ring-finger-phalanx-proximal")
    expected = skeleton.joints_m[at] + small @ skeleton.frames[at].T
    posed = rig.posed("A")
    vertices = posed.vertices_m - posed.joints_m[0]
    gap = np.linalg.norm(vertices[:, None] - expected, axis=2).min(axis=0)
    assert gap.max() < VERTEX_TOLERANCE_M


def test_one_of_two_hands_in_a_file_is_chosen(tmp_path):
    """Flat ones, whose side is in the names: all else may be the same."""
    maker = RigMaker(called="{}.R".format, **FLAT)
    document = maker.build()
    count = len(document.nodes)
    for node in deepcopy(document.nodes):
        node.name = node.name.replace(".R", ".L")
        node.children = [child + count for child in node.children]
        node.skin = None if node.mesh is None else 1
        document.nodes.append(node)
    document.skins.append(deepcopy(document.skins[0]))
    document.skins[1].joints = [joint + count for joint in document.skins[0].joints]
    document.scenes[0].nodes += [count, 2 * count - 1]
    path = rewritten(document, maker, tmp_path / "both.glb")
    with pytest.raises(RigError, match="one hand, or one of each side and --rig-hand, got 2"):
        read_rig(path)
    for side in ("right", "left"):
        with pytest.warns(ClradarWarning, match="'skin'$"):
            rig = read_rig(path, handedness=side)
        alone = read_rig(make(tmp_path, **FLAT), handedness=side)
        assert rig.handedness == side
        assert rig.ignored == ("skin",)
        np.testing.assert_allclose(rig.posed("F").joints_m, alone.posed("F").joints_m, atol=1e-6)


# --- mapping files


def bones_of_a_game(name):
    return f"Bone{JOINT_NAMES.index(name):03d}"


def mapping_text(skip=()):
    lines = [f'"{n}" = "{bones_of_a_game(n)}"' for n in JOINT_NAMES if n not in skip]
    return "\n".join(["[joints]", *lines])


def test_a_mapping_file_names_the_joints(tmp_path):
    path = make(tmp_path, called=bones_of_a_game, turn=TURN)
    with pytest.raises(RigError, match=r"hand.glb: .*WebXR names, or by a mapping file .*'wrist'"):
        read_rig(path)
    mapping = tmp_path / "m.toml"
    mapping.write_text(mapping_text(skip=TIP_NAMES))
    rig = read_rig(path, mapping=mapping)
    assert rig.known.sum() == 20
    by_number = {n: 1 + i for i, n in enumerate(JOINT_NAMES)}
    again = read_rig(path, mapping=by_number)
    assert again.known.all()
    expected = posed_skeleton(pose_by_name("F")).joints_m
    for each in (rig, again):
        found = joints_about_wrist(each.posed("F"))[each.known]
        np.testing.assert_allclose(found, expected[each.known], atol=JOINT_TOLERANCE_M)


def swapped(one, other):
    """The mapping with two fingers exchanged."""
    text = mapping_text().replace(f'"{one}-', '"x-').replace(f'"{other}-', f'"{one}-')
    return text.replace('"x-', f'"{other}-')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[joints]\nwrist = 'Bone000'", "a node for 'thumb-metacarpal', got none"),
        (mapping_text() + "\nhand = 'Bone001'", r"m.toml: joints.hand: expected .* got 'hand'"),
        (mapping_text().replace("Bone003", "Bone999"), "-distal: .* name or number 'Bone999'"),
        (mapping_text().replace("Bone003", "Bone002"), "a node for each joint, got 'B"),
        (mapping_text().replace('"Bone003"', "99"), "-distal: .* or number 99, got none of 27"),
        (mapping_text().replace('"Bone003"', "[1]"), "-distal: expected the name or num"),
        (swapped("index", "middle"), "the order index, middle, ring, pinky, got middle, index"),
    ],
)  # fmt: skip
def test_wrong_mappings_are_named(tmp_path, text, message):
    path = RigMaker(called=bones_of_a_game).save(tmp_path / "hand.glb")
    mapping = tmp_path / "m.toml"
    mapping.write_text(text)
    with pytest.raises(RigError, match=message):
        read_rig(path, mapping=mapping)


# --- sides and units


def test_the_side_of_a_flat_hand_is_given_or_named(tmp_path):
    assert read_rig(make(tmp_path, **FLAT), handedness="left").handedness == "left"
    assert read_rig(make(tmp_path, "hand_left.glb", **FLAT)).handedness == "left"
    assert read_rig(make(tmp_path, called="Left_{}".format, **FLAT)).handedness == "left"


# --- wrong rigs


def put(place, value):
    """Set an attribute of the document, such as ``nodes[3].rotation``."""
    owner, _, name = place.rpartition(".")

    def change(document):
        at: Any = document
        for part in filter(None, owner.split(".")):
            at = getattr(at, part.split("[")[0])
            at = at[int(part.split("[")[1][:-1])] if "[" in part else at
        old = getattr(at, name)
        setattr(at, name, value(old) if callable(value) else value)

    return change


def both(*changes):
    return lambda document: [change(document) for change in changes] and None


def cycle(document):
    for node in document.nodes:
        node.children = [child for child in node.children if child != 2]
    document.nodes[5].children.append(2)


def one_place(document):
    (node,) = (n for n in document.nodes if n.name == "index-finger-phalanx-distal")
    node.matrix = np.eye(4).reshape(-1).tolist()


PRIMITIVE = "meshes[0].primitives[0]"
ATTRIBUTES = f"{PRIMITIVE}.attributes"
NO_SKIN = "a mesh with a skin, got a mesh that no joint moves .not skinned."
DRACO = ["KHR_draco_mesh_compression"]
NEAR = "vertices of fingers: expected most within 0.5 .* inverse bind matrices missing"
MANY = "at most 67108864 numbers, with all uses of them"
VERTICES = "at most 1000000 vertices, got 3999999"
PUT = [  # in whose place, what, and what is said of it
    ("nodes[0].children", lambda old: [*old, 5], "child 5 of node .* of no other node"),
    ("nodes[0].children", lambda old: [*old, 99], "child 99 of node 0: expected one of 27 nodes"),
    ("nodes[4].matrix", lambda old: [*old[:3], np.nan, *old[4:]], "matrix of node 4: .* finite"),
    ("accessors[1].bufferView", 77, r"bufferView of .*: .* in \[0, 4\], got 77"),
    ("accessors[1].componentType", 1234, "of a known type, got type VEC3 of component type 1234"),
    ("accessors[1].count", lambda old: old + 1, r"POSITION: expected \d+ elements up to byte"),
    ("skins[0].joints", lambda old: old[:3], r"JOINTS: expected indices in \[0, 3\), got .0, \d+"),
    ("extensionsRequired", DRACO, f"expected none for the geometry, got {DRACO[0]}"),
    ("asset.version", "1.0", "asset: expected glTF 2.0, got version 1.0"),
    ("skins[0].inverseBindMatrices", None, NEAR),
    (f"{PRIMITIVE}.mode", 5, "primitive 0: .* a plain list of triangles, got a strip or a fan"),
    ("accessors[1].sparse", Sparse(count=1), "numbers of a buffer, got sparse ones"),
    (f"{ATTRIBUTES}.WEIGHTS_0", None, "'skin', primitive 0: JOINTS_0, WEIGHTS_0: .* of the two"),
    (ATTRIBUTES, lambda old: Attributes(POSITION=old.POSITION), "JOINTS_0, WEIGHTS_0: .* none"),
]
DOCUMENTS: list[tuple[Callable[[GLTF2], None], str]] = [
    *((put(place, value), message) for place, value, message in PUT),
    (both(put("skins", []), put("nodes[-1].skin", None)), NO_SKIN),
    (cycle, "nodes: expected trees, got 4 in a cycle"),
    (
        both(put("nodes[3].matrix", None), put("nodes[3].rotation", [0.0] * 4)),
        "rotation of node 3: expected a quaternion, got zeros",
    ),
    (one_place, "'index-finger-phalanx-distal' and 'index-finger-phalanx-intermediate' at the sam"),
    (put("extras", {"many": [{}] * 40_000}), "its JSON: expected at most 40000 objects, got 40"),
    # Counts that no byte backs.
    (both(put("accessors[1].bufferView", None), put("accessors[1].count", 3_999_999)), VERTICES),
    (both(put("accessors[1].bufferView", None), put("accessors[1].count", 2**35)), MANY),
]


@pytest.mark.parametrize(("change", "message"), DOCUMENTS, ids=range(len(DOCUMENTS)))
def test_wrong_documents_are_named(tmp_path, change, message):
    maker, path = RigMaker(), tmp_path / "hand.gltf"
    document = maker.build()
    change(document)
    (tmp_path / "hand.bin").write_bytes(maker.blob)
    document.buffers[0].uri = "hand.bin"
    # Not pygltflib's own writer, which refuses NaN.
    record = json.loads(document.to_json(allow_nan=True))
    path.write_text(json.dumps(record))
    with pytest.raises(RigError, match=message) as caught:
        read_rig(path)
    assert str(caught.value).startswith(f"{path}: ")


def edited(name, value, rows=5):
    def edit(maker):
        values = np.array(getattr(maker, name))
        values[rows] = value
        setattr(maker, name, values)

    return edit


def without(*names):
    return {"called": lambda name: "spare" if name in names else name}


HANDS = [
    (FLAT, None, "joints or names that tell left from right"),
    ({"units": 5.0}, None, r"50 to 400 mm .*, got 830?.* mm with a unit of 1 m"),
    ({"units": 1 / 25.4e-3}, None, "did you mean .*inch"),
    ({}, "mm", r"did you mean m\?"),
    (without("wrist", "thumb-metacarpal"), None, "none called 'wrist' and 1 more"),
    (
        {"called": lambda name: name.replace("pinky-finger-metacarpal", "Wrist_2")},
        None,
        r"wrist: expected one node .*got 'wrist' \(node 1\) and 'Wrist_2'",
    ),
]
ARRAYS = [
    (edited("weights_out", [0.5, 0.2, 0.1, 0.0], slice(5, 8)), "0.8 at vertex 5, the first of 3"),
    (edited("weights_out", np.nan), "WEIGHTS_0: expected finite numbers, got 4 of"),
    (edited("positions", np.nan), "mesh 'skin', primitive 0: POSITION: expected finite numbers"),
    (edited("positions", [0.0, -1.6, 0.0]), "remove everything but hand and forearm"),
    (edited("joints_out", 200), r"mesh 'skin', primitive 0: JOINTS: .*\[0, 20\), got .0, 200"),
    (edited("faces", 10**6), r"mesh 'skin', primitive 0: indices: .*, got .0, 1000000"),
]


@pytest.mark.parametrize(
    ("settings", "unit", "message"),
    [*HANDS, *(({"edit": edit}, None, message) for edit, message in ARRAYS)],
)
def test_wrong_hands_are_named(tmp_path, settings, unit, message):
    path = make(tmp_path, **settings)
    with pytest.raises(RigError, match=message):
        read_rig(path, unit=unit)


def test_cut_and_foreign_files_are_named(tmp_path):
    content = make(tmp_path).read_bytes()
    path = tmp_path / "cut.glb"
    path.write_bytes(content[:-1])
    with pytest.raises(RigError, match=r"cut.glb: buffer 0: .* the file is cut short"):
        read_rig(path)
    path.write_text("solid hand")
    with pytest.raises(RigError, match=r"a rigged hand: skinned glTF .*got something else"):
        read_rig(path)
    hand_mesh("flat", edge_length_m=4e-3).to_trimesh().export(path)
    with pytest.raises(RigError, match="a mesh that no joint moves"):
        read_rig(path)
    with pytest.raises(RigError, match="got nothing there"):
        read_rig(tmp_path / "none.glb")
    with pytest.raises(RigError, match="got a folder"):
        read_rig(tmp_path)
    RigMaker().save(tmp_path / "beside.gltf", "file")
    (tmp_path / "beside.bin").unlink()
    with pytest.raises(RigError, match=r"beside.bin: expected buffer 0 of beside.gltf, got noth"):
        read_rig(tmp_path / "beside.gltf")
    for unit in ("furlong", -1.0):
        with pytest.raises(ModelError, match="unit"):
            read_rig(make(tmp_path), unit=unit)


# --- command line


def test_the_command_poses_a_rig(cli):
    settings = {"units": 100.0, "turn": TURN @ MIRROR, "called": bones_of_a_game}
    make(Path(), skip=TIP_NAMES, **settings)
    Path("m.toml").write_text(mapping_text(skip=TIP_NAMES))
    write_pose("mine.toml", HandPose("mine", pose_by_name("L").joints))
    rig = "--rig hand.glb --mapping m.toml --rig-hand left --rig-unit"
    outcome = cli.ok(f"hand L {rig} cm -o hand.ply --joints j.json")
    assert "left hand, unit 10 mm, 20 of 25 joints, 'L'" in outcome.out
    mesh = trimesh.load_mesh("hand.ply", process=False)
    expected = read_rig("hand.glb", mapping="m.toml", unit="cm", handedness="left").posed("L")
    np.testing.assert_allclose(mesh.vertices, expected.vertices_m, atol=1e-7)  # float32 in the file
    joints = json.loads(Path("j.json").read_text())
    assert joints["thumb-tip"] is None
    np.testing.assert_array_equal(joints["wrist"], expected.joints_m[0])
    cli.ok(f"hand mine.toml {rig} 10 -o x.ply")
    assert Path("x.ply").read_bytes() == Path("hand.ply").read_bytes()
    cli.ok(f"hand {rig} cm -o parts.ply")
    assert set(Scene.from_mesh("parts.ply").part_names) == set(PART_NAMES)
    right = f"hand L {rig.replace('left', 'right')} cm -o no.ply"
    cli.fails(right, "expected a right hand, got a left one")
    cli.fails(f"hand L {rig} cm --betas 1 -o no.ply", "betas: expected a MANO model")


def test_rigs_go_to_other_processes(plain):
    again = pickle.loads(pickle.dumps(plain))
    np.testing.assert_array_equal(again.posed("A").vertices_m, plain.posed("A").vertices_m)
    assert not again.skin.weight.flags.writeable
    assert len(repr(plain)) < 1000
