"""Small valid files of every kind that is read, always the same."""

import base64
import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import layout_files
import maroon_files
import mesh_files
import numpy as np
import trimesh

import clradar
from clradar.files.meshes.ply_parts import ply_of_parts
from measurement_io import open_capture


def frames() -> list[bytes]:
    """Recorded frames: every protocol, both channel counts, the numpy of old and of today."""
    frame = maroon_files.random_frame(1, channels=94)
    rich = frame | {"gain": np.float32(0.5), "phase": 1 + 2j, "note": "hand"}
    rich |= {"list": [1, 2.5, ("a", None)], "objects": np.array([1, "a"], dtype=object)}
    pickles = [
        maroon_files.pickled(rich, protocol, spelling)
        for protocol in maroon_files.PROTOCOLS
        for spelling in maroon_files.SPELLINGS
    ]
    pickles += [maroon_files.pickled(maroon_files.random_frame(1))]
    return [maroon_files.npy(content) for content in pickles]


RADAR = "radar_72.0_82.0_2"
FROZEN = Path(__file__).parents[1] / "files" / "frozen" / "2026-11"


def frozen(*names: str) -> list[bytes]:
    """Files as they were once saved."""
    return [(FROZEN / name).read_bytes() for name in names]


def native_captures() -> list[bytes]:
    """Native captures: as saved, by another writer in every generation of HDF5, long text."""
    return [
        *frozen("capture-1.h5", "capture-2.h5"),
        *(_by_hand(options) for options in _GENERATIONS),
        *(_by_hand(options, crowd=30) for options in _GENERATIONS[:2]),
    ]


def native_volumes() -> list[bytes]:
    """Native volumes: one on a relative scale, one on an absolute one."""
    return [*frozen("volume-1.h5"), *in_both_forms(*frozen("volume-2.h5"))]


_GENERATIONS: tuple[dict[str, Any], ...] = (
    {"libver": "earliest"},
    {"libver": "latest"},
    {"libver": ("earliest", "v108"), "track_order": True},
)


def in_both_forms(content: bytes) -> list[bytes]:
    """An HDF5 file, and the same in the earliest form, whose structures have no checksums."""
    stream = io.BytesIO()
    with h5py.File(io.BytesIO(content)) as old, h5py.File(stream, "w", libver="earliest") as new:
        for name in old:
            old.copy(name, new)
        new.attrs.update(old.attrs)
    return [content, stream.getvalue()]


def _by_hand(options: dict[str, Any], crowd: int = 0) -> bytes:
    """A capture with other storage: contiguous, chunked with every kind of index, many names."""
    capture = open_capture(FROZEN / "capture-1.h5")
    stream = io.BytesIO()
    with h5py.File(stream, "w", **options) as file:
        file.attrs["clradar_format"], file.attrs["clradar_version"] = "capture", 1
        file.attrs["created"] = "2024-05-06T07:08:09+00:00"
        file.attrs["provenance"] = json.dumps(dict(capture.meta))
        for i in range(crowd):  # so many that HDF5 stores them another way
            file.attrs[f"attribute {i}"] = f"value {i}"
        group = file.create_group("entry/data")
        group.attrs["array_name"] = np.bytes_(capture.array.name)
        for i in range(crowd):
            group.create_group(f"group {i}")
        group.create_dataset("data", data=capture.data, chunks=(1, 2, 5), shuffle=True)
        group.create_dataset("tx_m", data=capture.array.tx_m, chunks=(1, 3), maxshape=(None, 3))
        group.create_dataset("rx_m", data=capture.array.rx_m, maxshape=(None, None))
        group["frequency_hz"] = capture.waveform.frequencies_hz
    return stream.getvalue()


def calibrations() -> list[bytes]:
    """calibration.json of a recording: without a frame, with one, and with one of old."""
    tree = json.loads(*frozen(f"recording/30/{RADAR}/calibration.json"))
    old = {"000000": tree["000000"] | {"depth": {"transform": np.eye(4).tolist()}}}
    none = {key: value for key, value in tree.items() if key != "000000"}
    return [json.dumps(one, indent=1).encode() for one in (none, tree, none | old)]


def antenna_files() -> list[bytes]:
    """Antenna files with 96 and with 94 rows."""
    rows = np.zeros((96, 3))
    rows[1:95] = clradar.arrays.qar50().rx_m
    texts = [[f"{x},{y},{z}" for x, y, z in part] for part in (rows, rows[1:95])]
    return ["\n".join(["x,y,z", *text, ""]).encode() for text in texts]


def alignments() -> list[bytes]:
    """alignment.json with transforms in both directions, scales, and a key that is none."""
    turned = [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]
    scaled = (np.diag([1e-3, 1e-3, 1e-3, 1.0])).tolist()
    trees = [
        {"photogrammetry2radar": turned, "kinect2radar": scaled},
        {"radar2photogrammetry": turned, "zed2photogrammetry": np.eye(4).tolist(), "note": "x"},
    ]
    return [json.dumps(tree).encode() for tree in trees]


def metadata() -> list[bytes]:
    """metadata.json, as saved and with a box that lacks bounds and has two in the wrong order."""
    box = {"xmin": -0.1, "xmax": 0.1, "zmin": 0.5, "zmax": 0.2}
    tree = {"mask_bb": box, "empty_measurement": "empty", "mask_erosion": 2}
    return [*frozen("recording/30/metadata.json"), json.dumps(tree).encode(), b"{}"]


_IMAGES = ("depth/000000.png", "maxproj/000000.png")


def products() -> dict[str, bytes]:
    """The files of one small recorded image, in its radar folder."""
    names = [f"{RADAR}/{name}" for name in ("calibration.json", *_IMAGES)]
    return dict(zip(names, frozen(*(f"recording/30/{name}" for name in names)), strict=True))


LAYOUT = b"""
data = { key = "s", axes = ["tx", "rx", "freq"] }
tx.key = "tx"
rx.key = "rx"
antennas.unit = "mm"
frequency = { key = "f", unit = "GHz" }
meta.keys = ["note"]
"""


def containers(*kinds: str) -> list[bytes]:
    """A lab's capture in files of these kinds."""
    capture = layout_files.random_capture()
    sides = {"tx": 1e3 * capture.array.tx_m, "rx": 1e3 * capture.array.rx_m}
    f_ghz = capture.waveform.frequencies_hz / 1e9
    tree = {"s": capture.data, **sides, "f": f_ghz, "note": "a note"}
    found = []
    with TemporaryDirectory() as folder:
        for i, kind in enumerate(kinds):
            found.append(layout_files.write(kind, Path(folder) / f"{i}", tree).read_bytes())
    return found


ROOT = Path(__file__).resolve().parents[2]


def layouts() -> list[bytes]:
    """Layouts: the small one above, and those that are shipped."""
    shipped = ROOT / "examples" / "layouts"
    return [LAYOUT, *(path.read_bytes() for path in sorted(shipped.glob("*.toml")))]


def of_page(page: str) -> bytes:
    """The longest TOML file of a page of the documentation."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return max((part.split("```")[0] for part in text.split("```toml\n")[1:]), key=len).encode()


def arrays() -> list[bytes]:
    """Arrays with gains, poses and patterns."""
    text = b"""
pairs = "cluster"
[[tx]]
line = { first_m = [-0.03, 0, 0], last_m = [0.03, 0, 0], n = 3 }
gain_db = [0, -6, -3]
[[rx]]
plane = { size_m = [0.1, 0.1], n = [2, 3] }
boresight = [0, 0.1, 1]
[[pose]]
line = { first_m = [0, 0, 0], last_m = [0.3, 0, 0], n = 2 }
[rx_pattern]
angle_deg = [0.0, 90.0, 180.0]
field = [1.0, 0.7, 0.0]
"""
    return [text, b'copy_of = "qar50"\n']


def _hand_model() -> dict[str, Any]:
    """A MANO model of 48 vertices, three at each joint."""
    from mano_files import ORDER, PARENTS, TURN
    from scipy.sparse import csc_matrix

    from clradar.hand import JOINT_NAMES, pose_by_name, posed_skeleton

    bones = posed_skeleton(pose_by_name("flat")).joints_m
    joints = bones[[JOINT_NAMES.index(name) for name in ORDER]] @ TURN.T
    corners = np.array([[0, 0, 0], [-8e-3, 0, 0], [-8e-3, 4e-3, 0]])
    n = 3 * len(joints)
    return {
        "v_template": (joints[:, None] + corners).reshape(n, 3),
        "shapedirs": np.zeros((n, 3, 2)),
        "posedirs": np.zeros((n, 3, 135), np.float32),
        "J_regressor": csc_matrix(np.kron(np.eye(16), [[1.0, 0.0, 0.0]])),
        "kintree_table": np.array([PARENTS, range(16)]).astype(np.uint32),
        "weights": np.repeat(np.eye(16), 3, axis=0),
        "f": np.arange(n, dtype=np.uint32).reshape(-1, 3),
        "bs_style": "lbs",
    }


def hand_models() -> list[bytes]:
    """`_hand_model` pickled by Python 2 and 3."""
    from mano_files import mano_pickle

    model = _hand_model()
    kinds = ((2, True), (0, True), (2, False), (5, False))
    return [mano_pickle(model, protocol, python_2) for protocol, python_2 in kinds]


def _obj_meshes() -> list[bytes]:
    """Two groups, with what photogrammetry programs write, and a single triangle."""
    lines = ["# metres", "mtllib mesh.mtl", "usemtl skin", "vt 0.0 0.0", "vn 0 0 1", "g a"]
    lines += [f"v {x} {y} {z}" for z in (0.0, 0.1) for y in (0.0, 0.2) for x in (0.0, 0.3)]
    lines += ["f 1/1/1 2/1/1 3/1/1", "f 2/1 4/1 3/1", "g b", "f 5//1 6//1 8//1 7//1", "f 8 7 6"]
    return ["\n".join(lines).encode(), "\n".join([*lines[6:14], "f 1 2 4"]).encode()]


def named_meshes(ending: str) -> list[bytes]:
    """A small mesh in the forms that a format has to hold one."""
    if ending == "obj":
        return _obj_meshes()
    if ending in ("glb", "gltf"):
        nodes = [{"children": [1], "scale": [1, 2, 1]}, {"mesh": 0, "rotation": [0, 0, 0, 1]}]
        document = mesh_files.tetrahedron(nodes=nodes)
        if ending == "glb":
            return [mesh_files.glb(document)]
        content = base64.b64encode(mesh_files.binary()).decode("ascii")
        document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
        return [json.dumps(document, indent=1).encode()]
    ball = trimesh.creation.icosphere(subdivisions=0, radius=0.1)
    if ending == "ply":
        part, names = np.arange(20) // 10, ("a", "b c")
        return [ply_of_parts(ball.vertices, ball.faces, part, names, 2 * ball.vertices)]
    content = ball.export(file_type=ending)
    return [content.encode() if isinstance(content, str) else content]


def rigs() -> list[bytes]:
    """The hand of this package as a rig, in one primitive and in two."""
    from rig_files import RigMaker

    with TemporaryDirectory() as folder:
        return [RigMaker(primitives=n).save(Path(folder) / "hand.glb").read_bytes() for n in (1, 2)]


def hand_archives() -> list[bytes]:
    """The models of `hand_models` as a `numpy` archive."""
    stream = io.BytesIO()
    model = _hand_model()
    model["J_regressor"] = model["J_regressor"].toarray()
    np.savez(stream, **{name: value for name, value in model.items() if name != "bs_style"})
    return [stream.getvalue()]
