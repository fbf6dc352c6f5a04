"""``clradar simulate``: its options, materials, clusters, and scenes that move."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import two_devices
import typer
from command_line import DENSITY, Cli, group_of, worker_here
from comparisons import tree
from nightly import nightly
from rig_files import RigMaker

import clradar
from clradar.arrays import read_clusters
from clradar.cli.groups import arguments_of, paths_in
from clradar.cli.options import MaterialOptions, PlacementOptions, SceneOptions, mesh_and_alpha
from clradar.errors import ClradarError, ModelError
from clradar.files.hashing import sha256_of
from measurement_io import open_capture, open_recording, open_volume


def test_simulate_writes_what_the_library_gives(made):
    capture = open_capture(made / "sim.h5")
    scene = clradar.Scene.from_mesh(made / "hand.ply", alpha=0.4)
    array, band = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 16)
    settings = {"samples_per_mm2": float(DENSITY), "seed": 7}
    expected = clradar.simulate(scene, array, band, **settings, device="pocl")
    assert np.array_equal(capture.data, expected.data)
    meta = capture.meta
    assert meta["settings"]["seed"] == 7
    assert meta["scene"]["sha256"] == scene.digest()
    assert meta["device"] == expected.meta["device"]
    assert meta["clradar"] == clradar.__version__
    assert meta["packages"]["numpy"] == np.__version__
    assert meta["command"] == "simulate"
    assert meta["options"]["band"] == [72.0, 82.0, 16]
    digest = sha256_of(made / "hand.ply")
    assert meta["inputs"] == [{"file": "hand.ply", "sha256": digest}]


def test_every_option_of_simulate_reaches_the_library(cli, place, monkeypatch):
    received: dict[str, Any] = {}

    def fake(scene: clradar.Scene, array: object, waveform: clradar.Waveform, **given: Any) -> None:
        received.update(given, array=array, waveform=waveform, scene=scene)
        raise ModelError("enough")

    monkeypatch.setattr(clradar, "simulate", fake)
    Path("lab.toml").write_text("[[antennas]]\nplane = { size_m = [0.2, 0], n = [5, 1] }")
    line = (
        "simulate hand.ply -o x.h5 --rays-per-face 3 --rays-per-sample 2 --reception-radius-mm 5 "
        "--max-bounces 4 --normals face --crease-deg 12 --facets flat --seed 9 --array lab.toml "
        "--band 24:26:11 --device pocl"
    )
    cli.fails(line, "enough")
    assert received["settings"] == clradar.SimulationSettings(
        rays_per_face=3, rays_per_sample=2, reception_radius_m=0.005, max_bounces=4,
        normals="face", crease_deg=12.0, facets="flat", seed=9,
    )  # fmt: skip
    assert (received["array"].name, received["array"].n_tx) == ("lab", 5)
    assert np.array_equal(received["waveform"].frequencies_hz, np.linspace(24e9, 26e9, 11))
    assert "portable" in received["device"].info.platform.lower()
    line = "simulate hand.ply -o x.h5 --samples-per-mm2 2"
    cli.fails(f"{line} --estimator expected", "enough")
    settings = received["settings"]
    assert (settings.estimator, settings.samples_per_mm2) == ("expected", 2.0)


def test_simulate_takes_the_materials_of_parts(cli, place):
    materials = "--material palm --material-of thumb=skin --samples-per-mm2 1.5 --band 72:82:2"
    outcome = cli.ok(f"simulate hand.ply -o x.h5 {materials}")
    assert "2 S-parameters of palm, skin," in outcome.out or "of skin, palm," in outcome.out
    outcome = cli(f"simulate hand.ply -o y.h5 {materials} --alpha 0.3 --material-of toe=skin")
    assert "--alpha: not used by --estimator physical" in outcome.err
    meta = open_capture("x.h5").meta
    assert meta["settings"]["estimator"] == "physical"
    assert {record["name"] for record in meta["scene"]["materials"]} == {"palm", "skin"}


def test_the_digest_of_an_input_that_changes_meanwhile_is_that_before(cli, place, monkeypatch):
    simulate, digest = clradar.simulate, sha256_of(place / "hand.ply")

    def changed(*arguments: Any, **given: Any) -> clradar.Capture:
        Path("hand.ply").unlink()
        Path("hand.ply").write_bytes(b"another")
        return simulate(*arguments, **given)

    monkeypatch.setattr(clradar, "simulate", changed)
    cli.ok("simulate hand.ply -o x.h5 --samples-per-mm2 0.1 --band 72:82:2")
    assert open_capture("x.h5").meta["inputs"] == [{"file": "hand.ply", "sha256": digest}]


def test_alpha_by_mesh_and_by_part(cli, place):
    meshes = ["hand.ply:0.2", "hand.ply"]
    scene = group_of(SceneOptions, meshes=meshes, alpha=["palm-2=0.6", "0.9", "thumb=0"]).load()
    alpha, part = np.asarray(scene.alpha), np.asarray(scene.part)
    # Both meshes have the parts of a hand.
    expected = {"palm": 0.2, "palm-2": 0.6, "thumb": 0.0, "thumb-2": 0.9, "index-2": 0.9}
    for name, value in expected.items():
        assert set(alpha[part == scene.part_names.index(name)]) == {value}
    assert mesh_and_alpha("a.ply") == (Path("a.ply"), None)
    assert mesh_and_alpha("c:a.ply") == (Path("c:a.ply"), None)
    Path("a.ply:1").touch()  # a file of that very name
    assert mesh_and_alpha("a.ply:1") == (Path("a.ply:1"), None)


MATRIX = [[0.0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.03], [0, 0, 0, 1]]


@pytest.mark.parametrize("form", [MATRIX, np.ravel(MATRIX).tolist(), {"transform": MATRIX}])
def test_a_transform_moves_the_mesh(made, tmp_path, form):
    path = tmp_path / "t.json"
    path.write_text(json.dumps(form))
    moved = SceneOptions(meshes=[(made / "hand.ply", None)], transform=path).load()
    assert moved.digest() == clradar.Scene.from_mesh(made / "hand.ply", transform=MATRIX).digest()


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[1, 2]", '{"matrix": []}', '["a"]', json.dumps([0] * 16)),
        "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]",
        "[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
    ],
)
def test_what_is_no_transform_is_refused(tmp_path, text):
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(ClradarError, match=r"t\.json"):
        PlacementOptions(transform=path).matrix()


# ---- materials


@pytest.fixture
def scene() -> clradar.Scene:
    mesh = trimesh.creation.icosphere(1, 0.02)
    part = np.arange(len(mesh.faces)) % 3
    return clradar.Scene(mesh.vertices, mesh.faces, part=part, part_names=("palm", "thumb", "nail"))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.toml"
    path.write_text('[resin]\npermittivity = "2.9 - 0.04j"\n[palm]\npermittivity = 3\n')
    return path


def of(**given: Any) -> MaterialOptions:
    return group_of(MaterialOptions, **given)


def names(scene: clradar.Scene) -> list[str]:
    return [scene.materials[i].name for i in np.asarray(scene.material)[:3]]


def test_materials_of_all_and_of_parts(scene, own):
    assert MaterialOptions().on(scene) is scene
    some = of(material="palm", material_of=["thumb=skin", f"nail={own}:resin"])
    assert names(some.on(scene)) == ["palm", "skin", "resin"]
    assert paths_in(arguments_of(some)) == [own]
    alone = of(material_of=["thumb=skin"]).on(scene)
    assert names(alone) == ["perfect conductor", "skin", "perfect conductor"]
    file = of(material=f"{own}:resin").on(scene)
    assert file.materials == (clradar.read_materials(own)["resin"],)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"material": "rubber"}, "expected one of metal, skin, .*got 'rubber'"),
        ({"material": "{own}:rubber"}, "expected one of resin, palm of .*own.toml, got 'rubber'"),
        ({"material": "{own}"}, "expected one of metal, .*got .*own.toml'"),
        ({"material": "gone.toml:resin"}, "gone.toml: expected"),
        ({"material_of": ["skin"]}, "expected PART=NAME, got 'skin'"),
        ({"material_of": ["thumb=skin", "thumb=palm"]}, "part 'thumb' is given twice"),
        ({"material_of": ["toe=skin"]}, r"expected parts .*\(palm, thumb, nail\), got toe"),
    ],
)
def test_wrong_names_list_what_is_known(scene, own, options, message):
    if "material" in options:
        options = {"material": str(options["material"]).format(own=own)}
    with pytest.raises((typer.BadParameter, ClradarError), match=message):
        of(**options).on(scene)


# ---- clusters, whose Tx are measured with their own Rx only

RULES = """
[[tx]]
line = { first_m = [-0.03, 0, 0], last_m = [0.03, 0, 0], n = 5 }
[[rx]]
line = { first_m = [0, -0.03, 0], last_m = [0, 0.03, 0], n = 6 }
"""
WALL = f"""
pairs = "cluster"
{RULES}
[[pose]]
line = {{ first_m = [-0.1, 0, 0], last_m = [0.1, 0, 0], n = 2 }}
[[pose]]
points_m = [[0, 0.1, 0]]
rotation_deg = [10, 0, 0]
"""
BAND = clradar.Waveform.sfcw(76e9, 80e9, 12)
GRID = clradar.VoxelGrid.from_extent((-0.02, 0.04), (-0.03, 0.02), (0.27, 0.33), 2.5e-3)
GRID_WORDS = "--x-mm -20:40:2.5 --y-mm -30:20:2.5 --z-mm 270:330:2.5"
POINTS_M = [[0.01, 0, 0.3], [0, -0.01, 0.31], [0.02, 0.01, 0.29]]


def ball(radius_m: float, *at_m: float, subdivisions: int = 2) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    return made.apply_translation(at_m)


@pytest.fixture
def walled(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The line that simulates a ball by three clusters, but for the folder."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")  # files of equal bytes
    ball(0.015, 0.01, 0, 0.3).export("ball.ply")
    Path("wall.toml").write_text(WALL)
    return "simulate ball.ply --array wall.toml --band 76:80:12 --estimator expected -o"


def test_the_image_is_the_sum_over_the_pairs_of_all_clusters(walled):
    """That of one array of all antennas, whose other pairs are zero, over their share of pairs."""
    clusters = read_clusters("wall.toml")
    captures = [clradar.room_capture(array, BAND, [], points_m=POINTS_M) for array in clusters]
    whole = clradar.AntennaArray(
        *(np.concatenate([getattr(a, side) for a in clusters]) for side in ("tx_m", "rx_m"))
    )
    data = np.zeros((whole.n_tx, whole.n_rx, BAND.n_freq), np.complex64)
    for i, capture in enumerate(captures):
        data[5 * i : 5 * i + 5, 6 * i : 6 * i + 6] = capture.data
    joined = clradar.Capture(data, whole, BAND)
    want = clradar.backproject(joined, GRID, method="exact", check_grid=False).data * 3
    got = clradar.backproject(iter(captures), GRID, method="exact")
    # -80 dB of either.
    rms = np.sqrt(np.mean(np.abs(want) ** 2))
    assert np.sqrt(np.mean(np.abs(got.data - want) ** 2)) < 2e-4 * rms
    assert (len(got.meta["capture"]), got.scale) == (3, None)
    with pytest.raises(ModelError, match="at least one capture"):
        clradar.backproject([], GRID)


FILES = {"cluster_001.h5", "cluster_002.h5", "cluster_003.h5", "settings.json"}


@pytest.mark.usefixtures("quickly")
def test_from_clusters_to_one_image(cli, walled):
    cli.ok(f"{walled} made")
    captures = [open_capture(f"made/cluster_00{i}.h5") for i in (1, 2, 3)]
    scene, second = clradar.Scene.from_mesh("ball.ply"), read_clusters("wall.toml")[1]
    again = clradar.simulate(scene, second, BAND, estimator="expected")
    np.testing.assert_array_equal(captures[1].data, again.data)
    files = " ".join(f"made/cluster_00{i}.h5" for i in (1, 2, 3))
    cli.ok(f"image {files} -o volume.h5 --png image.png {GRID_WORDS}")
    want = clradar.backproject(captures, GRID)
    np.testing.assert_array_equal(open_volume("volume.h5").data, want.data)
    line = f"image made/cluster_001.h5 volume.h5 -o no.h5 {GRID_WORDS}"
    cli.fails(line, "expected captures, got the volume", status=2)
    cli.fails("demo --array wall.toml", "3 clusters, which simulate and image take")


@pytest.mark.parametrize("how", ["--scheduler", *nightly(["--workers 2", "--device all"])])
def test_workers_and_devices_make_the_same_files(cli, walled, how):
    dask = pytest.importorskip("distributed").client.dask
    cli.ok(f"{walled} here")
    line = f"{walled} there {how}"
    if how == "--scheduler":
        # Meshes may be larger than what Dask warns of.
        few = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 B"})
        with worker_here() as address, few:
            cli.ok(f"{line} {address}")
    elif "--workers" in how:
        cli.ok(line)
    else:  # in a process of its own, which sees the CPU as two devices
        words = [sys.executable, "-m", "clradar", *line.split()]
        subprocess.run(words, env={**os.environ, **two_devices.ENVIRONMENT}, check=True)
    assert tree("here").keys() == FILES
    # One file says when the inputs were seen.
    assert tree("there", "settings.json") == tree("here", "settings.json")


# ---- scenes that move

MOTION = """
sweep.step_us = 400
[[body]]
velocity_mm_per_s = [0, 0, 50]
[[hand]]
edge_mm = 4
pose = [{ time_s = 0, pose = "S" }, { time_s = 1, pose = "flat" }]
center_mm = [0, 0, 400]
"""


def test_a_moving_scene_becomes_a_recording_with_its_truth(cli):
    ball(0.01, 0, 0, 0.2).export("ball.ply")
    Path("motion.toml").write_text(MOTION)
    Path("radar.toml").write_text(RULES)
    options = "--array radar.toml --band 72:82:2 --samples-per-mm2 0.02 --estimator expected"
    line = f"simulate ball.ply --motion motion.toml {options} -o"
    outcome = cli.ok(f"{line} moving --frames 2 --rate-hz 1")
    assert "2 frames, sweeps of 3.6 ms, samples right to -" in outcome.out
    recording = open_recording("moving")
    assert recording.timestamps_us == (0, 1_000_000)
    truth = json.loads(Path("moving/truth/truth.json").read_text())["frames"]
    middle_s = truth[1]["middle_s"]
    assert middle_s == pytest.approx(1.0018)
    assert truth[1]["bodies"][""][2][3] == pytest.approx(0.05 * middle_s)
    assert truth[1]["hands"][0]["pose"] == "flat"
    assert len(truth[0]["hands"][0]["joints_m"]) == 25
    outcome = cli.ok(f"{line} one.h5")
    one = open_capture("one.h5")
    movement = one.meta["movement"]
    assert f"samples right to {movement['sample_error_db']:.0f} dB" in outcome.out
    assert movement["instants"] >= 2
    assert np.array_equal(one.data, recording[0].data)


def test_frames_of_another_radar_and_clusters_one_after_the_other(cli):
    ball(0.01, 0, 0, 0.3).export("ball.ply")
    Path("motion.toml").write_text("body = [{ velocity_mm_per_s = [0, 0, 500] }]")
    Path("radar.toml").write_text(RULES)
    poses = "[[pose]]\npoints_m = [[0, 0, 0], [0.03, 0, 0]]"
    Path("wall.toml").write_text(f'pairs = "cluster"\n{RULES}{poses}')
    options = "--motion motion.toml --band 60:60.2:3 --estimator expected"
    line = f"simulate ball.ply {options} --frames 2 --array"
    cli.ok(f"{line} radar.toml -o frames")
    recording = open_recording("frames")
    assert recording.timestamps_us == (0, 125_000)
    assert recording[1].array.same_positions(clradar.arrays.read_array("radar.toml"))
    cli.fails(f"{line} radar.toml -o frames", "holds files already")
    cli.ok(f"{line} wall.toml -o wall")
    first, second = (open_recording(f"wall/cluster_00{i}") for i in (1, 2))
    np.testing.assert_array_equal(first[1].data, recording[1].data)
    # The second cluster begins when 5 Tx had 3 frequencies of 2.5 us each.
    motion = clradar.read_motion("motion.toml").bodies[""]
    body = clradar.MovingBody(clradar.Scene.from_mesh("ball.ply"), motion)
    own, band = read_clusters("wall.toml")[1], clradar.Waveform.sfcw(60e9, 60.2e9, 3)
    want = clradar.simulate_moving(
        clradar.MovingScene([body]), own, band, start_s=0.125 + 37.5e-6, estimator="expected"
    )
    np.testing.assert_allclose(second[1].data, want.data, rtol=1e-5)
    for missing in ("none.ply", "ball.ply:0.5 none.ply"):
        cli.fails(f"simulate {missing} {options} -o no.h5", "none.ply: no such file; expected a ")
    cli.ok(f"simulate ball.ply {options} --array wall.toml -o one")
    assert tree("one").keys() == {"cluster_001.h5", "cluster_002.h5"}


def test_a_hand_goes_from_pose_to_pose_as_a_motion(cli):
    way = "hand --from A --to bent.toml --edge-mm 4 --left --length-mm 180"
    bent = 'name = "bent"\n[joints.index-finger-phalanx-intermediate]\nflexion_deg = 80'
    Path("bent.toml").write_text(bent)
    Path("in").mkdir()
    cli.ok(f"{way} -o in/motion.toml --duration-s 0.5 --turn-deg 20")
    hand = clradar.read_motion("in/motion.toml").hands[0]
    assert (hand.handedness, hand.pose(0.5).name) == ("left", "bent")
    assert hand.shape.length_m == pytest.approx(0.18)
    assert hand.times_s.tolist() == [0, 0.5]
    turned = (np.cos(np.radians(20)), 0, -np.sin(np.radians(20)))
    assert hand.transform(0.2)[:3, :3] @ (1, 0, 0) == pytest.approx(turned)
    cli.fails(f"{way} -o way.ply", "expected a name that ends in .toml")


def test_a_rig_goes_from_pose_to_pose_in_a_motion(cli):
    Path("in").mkdir()
    RigMaker(units=100.0).save(Path("hand.glb"))
    cli.ok("hand --from flat --to A --rig hand.glb --rig-unit cm -o in/motion.toml")
    motion = clradar.read_motion("in/motion.toml")
    assert [path.name for path in motion.files] == ["motion.toml", "hand.glb"]
    hand = motion.hands[0]
    assert hand.joints_m(0.25) == pytest.approx(hand.mesh(0.25).joints_m, nan_ok=True)
    Path("hand.glb").unlink()
    cli.fails("simulate --motion in/motion.toml -o x.h5", "hand[0]: in/../hand.glb: no such file")


@pytest.mark.parametrize(("estimator", "tolerance"), [("expected", 1e-4), ("physical", 1e-3)])
def test_a_cluster_sees_at_its_pose_what_it_sees_in_its_own_frame(walled, estimator, tolerance):
    """Balls of which one hides a part of the other: only coordinates are rounded elsewhere."""
    pose = trimesh.transformations.rotation_matrix(np.radians(10), [1, 0, 0])
    pose[:3, 3] = [0, 0.1, 0]
    places_m = ((0.002, 0, 0.25), (0.008, 0.003, 0.3))
    balls = [ball(0.01, *at_m, subdivisions=3) for at_m in places_m]
    own = clradar.Scene.combine(clradar.Scene.from_mesh(mesh) for mesh in balls)
    placed = read_clusters("wall.toml")[2]
    alone = clradar.AntennaArray(
        *((side - pose[:3, 3]) @ pose[:3, :3] for side in (placed.tx_m, placed.rx_m))
    )
    np.testing.assert_allclose(alone.tx_m[:, 1:], 0, atol=1e-12)
    settings = {"estimator": estimator, "samples_per_mm2": 4.0}
    want = clradar.simulate(own, alone, BAND, **settings).data
    got = clradar.simulate(own.transformed(pose), placed, BAND, **settings).data
    error = np.sqrt(np.mean(np.abs(got - want) ** 2) / np.mean(np.abs(want) ** 2))
    assert error < tolerance, error
