"""Samples of data sets: from a recipe, from rigs, made again, and read by xarray and PyTorch."""

import json
import os
import pickle
import shutil
import subprocess
import sys
import types
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from dataset_plans import DEVICE, PLAN, digests, light_file, plan_of
from rig_files import RigMaker
from scipy.spatial.transform import Rotation

import clradar
from clradar.dataset import (
    PlanError,
    Sample,
    TorchDataset,
    make_sample,
    open_dataset,
    read_plan,
    read_sample,
    recipe,
    replay,
    run,
)
from clradar.dataset.contact_sheet import contact_sheet
from clradar.dataset.folder import MANIFEST, check_dataset
from clradar.dataset.runs import ShardMaker, estimate
from clradar.dataset.sample import _rig, placed_hand, read_recipe, rotation
from clradar.dataset.shards import arrays_of, labels_of
from clradar.errors import ClradarError, ModelError
from clradar.hand import JOINT_NAMES, POSES, HandShape, hand_mesh
from clradar.jobs.outcome import silent

POINT_ERROR_M = 1e-9
"""Rotations and translations of decimetres in float64: rounding is some 1e-16 m."""

SIZE_SHARE = 0.25  # as far may the estimate of bytes be off: samples compress differently

HALF_FLOAT_M = 2e-8
"""float32 of lengths below 0.5 m: half of 2**-24 of 0.5 m is 1.5e-8 m."""

# What a sample is


def test_a_sample_equals_its_stages_run_one_by_one(made):
    wanted = recipe(PLAN, 2)
    hands, place = wanted["hands"], wanted["placement"]
    assert wanted["poses"]["resolved"][0]["name"] == "F"
    (shape,) = hands["shapes"]
    shape = HandShape(**{**shape, "finger_lengths": tuple(shape["finger_lengths"])})
    mesh = hand_mesh(POSES["F"], 4e-3, hands["handedness"], (0.0, 0.0, 0.0), shape)
    # About y alone, as the plan has it.
    turn = Rotation.from_euler("y", place["rotation_y_deg"], degrees=True).as_matrix()
    mesh = mesh.moved(turn, [place[f"{axis}_mm"] / 1e3 for axis in "xyz"])
    alpha = {name: wanted["alpha"].get(name, wanted["alpha"]["others"]) for name in mesh.part_names}
    array, every = clradar.arrays.qar50(), slice(None, None, 8)
    capture = clradar.simulate(
        clradar.Scene.from_mesh(mesh, alpha=alpha),
        array.part(every, every), clradar.Waveform.sfcw(72e9, 82e9, 16), device=DEVICE,
        samples_per_mm2=0.05, rays_per_sample=160, estimator="expected",
        seed=wanted["simulation"]["seed"],
    )  # fmt: skip
    faults = wanted["impairments"]
    capture = clradar.impair(capture, seed=faults["seed"], snr_db=faults["snr_db"])
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 0.01)
    volume = clradar.backproject(capture, grid, device=DEVICE)

    sample = read_sample(made, 2)
    assert sample.recipe == wanted
    found = sample.arrays
    np.testing.assert_allclose(found["joints"], mesh.joints_m, rtol=0, atol=POINT_ERROR_M)
    np.testing.assert_allclose(found["mesh_vertices"], mesh.vertices_m, rtol=0, atol=HALF_FLOAT_M)
    np.testing.assert_array_equal(found["mesh_faces"], mesh.faces)
    np.testing.assert_array_equal(found["mesh_part"], mesh.part)
    # The turned vertices differ in their last bits, by which borderline rays may go otherwise.
    peak = np.abs(capture.data).max()
    assert np.abs(found["capture"] - capture.data).max() < 1e-4 * peak
    peak = np.abs(volume.data).max()
    assert np.abs(found["volume"] - volume.data).max() < 1e-4 * peak
    image = np.abs(found["volume"]).max(axis=0)
    np.testing.assert_array_equal(found["max_projection"], image)
    depth = clradar.Volume(found["volume"], grid).depth_map().depth_m
    np.testing.assert_array_equal(found["depth_map"], depth.astype(np.float32))


def test_rotations_are_about_the_fixed_axes_x_then_y_then_z():
    quarter = np.pi / 2
    x, y, z = np.eye(3)
    for angles, point, expected in (
        ((quarter, 0, 0), y, z),
        ((0, quarter, 0), z, x),
        ((0, 0, quarter), x, y),
        ((quarter, quarter, 0), y, x),  # y to z by the first, z to x by the second
        ((quarter, 0, quarter), z, x),  # z to -y, -y to x
    ):
        np.testing.assert_allclose(rotation(angles) @ point, expected, atol=1e-15)


def test_what_a_recipe_leaves_out_is_a_default_or_one_error():
    whole = {**recipe(PLAN, 1), "output": {"products": ["capture"]}}
    clean = make_sample({**whole, "impairments": {}}, DEVICE).arrays["capture"]
    bare = {key: value for key, value in whole.items() if key not in ("impairments", "image")}
    text = json.dumps(bare).encode()
    assert make_sample(text, DEVICE).arrays["capture"].tobytes() == clean.tobytes()
    given = {"seed": 3, "gain_db": 2.0, "dead_rx": [1]}
    uneven = make_sample({**whole, "impairments": {"channels": given}}, DEVICE).arrays["capture"]
    array, waveform = PLAN.radar.antennas, PLAN.radar.waveform
    channels = clradar.draw_channels(array, waveform, **given)
    wanted = clradar.impair(clradar.Capture(clean, array, waveform), channels=channels).data
    assert uneven.tobytes() == wanted.tobytes() != clean.tobytes()
    for wrong, words in (
        ({**whole, "hands": {"edge_mm": 9}}, "recipe: hands.edge_mm: expected a number from 0.5"),
        ({**whole, "hand": {}}, "recipe: hand: unknown key"),
        ({**whole, "version": 2}, "recipe: expected version 3, got 2; older ones follow"),
        ({}, "samples: expected a value"),
        ("{", "no JSON"),
        (3, "got int"),
    ):
        with pytest.raises(ModelError, match=words):
            make_sample(wrong, DEVICE)


HASHES = """
import hashlib, sys
from clradar.dataset import make_sample
arrays = make_sample(sys.argv[1], "pocl").arrays
print({name: hashlib.sha256(array.tobytes()).hexdigest() for name, array in arrays.items()})
"""


@pytest.mark.slow
def test_bits_do_not_depend_on_the_number_of_threads(capsys, monkeypatch):
    """In this process, and in one with one thread of OpenCL and several of BLAS."""
    # More pairs and voxels than work for one thread; sizes for which BLAS takes several.
    plan = plan_of(
        radar={"every": 3, "steps": 32},
        image={"step_mm": [4, 4, 10], "x_mm": [-60, 60], "y_mm": [-88, 88]},
        impairments={"channels": {}, "adc_bits": 12, "coupling_db": 10},
    )
    text = json.dumps(recipe(plan, 1))
    monkeypatch.setattr(sys, "argv", ["", text])
    exec(HASHES, {})
    threads = {
        **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "4"),
        **dict.fromkeys(("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"), "1"),
    }
    other = subprocess.run(
        [sys.executable, "-c", HASHES, text],
        env={**os.environ, **threads},
        capture_output=True,
        text=True,
        check=True,
    )
    assert other.stdout == capsys.readouterr().out != ""


RIG_PLAN = """samples = 2
poses.names = ['B']
hands = { rigs = ['hand.gltf'], handedness = 'both' }
output.products = ['mesh', 'joints']
"""


def test_rigs_are_hands_too(cli, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there" / "deep"
    for folder in (here, there):
        folder.mkdir(parents=True)
        RigMaker().save(folder / "hand.gltf", "file")
        (folder / "plan.toml").write_text(RIG_PLAN)
    plan, moved = (read_plan(folder / "plan.toml") for folder in (here, there))
    assert run(plan, tmp_path / "out", device=DEVICE).aside == ()
    assert check_dataset(tmp_path / "out").ok
    view = open_dataset(tmp_path / "out")
    assert view.rig.values.tolist() == ["hand.gltf"] * 2
    assert np.isnan(view["shape"].values).all()

    one = recipe(plan, 0)
    sides = [{**one, "hands": {**one["hands"], "handedness": side}} for side in ("right", "left")]
    hands = (placed_hand(read_recipe(side), DEVICE, rigs=here) for side in sides)
    place = read_recipe(one).plan.placement
    turn, centre_m = rotation(place.radians), place.metres
    right_m, left_m = ((hand.joints_m - centre_m) @ turn for hand in hands)
    np.testing.assert_allclose(left_m, right_m * [-1.0, 1.0, 1.0], atol=POINT_ERROR_M)

    # The folder's name is in none of the bytes.
    run(moved, tmp_path / "other", device=DEVICE)
    assert digests(tmp_path / "other") == digests(tmp_path / "out")
    assert run(moved, tmp_path / "out", device=DEVICE).made == 0

    (here / "hand.gltf").unlink()
    _rig.cache_clear()
    assert "sample 0: the same bits" in cli.ok(f"dataset --replay out 0 --rigs {there}").out
    for begun in (
        lambda: make_sample(one, DEVICE),
        lambda: replay(tmp_path / "out", 0, device=DEVICE),
        lambda: run(plan, tmp_path / "more", device=DEVICE),
    ):
        with pytest.raises(ModelError, match=r"hand\.gltf: expected the file of .* nothing there"):
            begun()
    RigMaker().save(here / "hand.gltf", "file")
    buffer = here / "hand.bin"
    buffer.write_bytes(buffer.read_bytes()[::-1])
    with pytest.raises(ModelError, match=r"expected the file of the plan .* got another"):
        make_sample(one, DEVICE, rigs=here)
    with pytest.raises(PlanError, match=r"hands.rigs\[0\]"):
        read_plan(here / "plan.toml")


# Replay


def test_the_command_replays(cli, made):
    copy, shard = Path(shutil.copytree(made, "copy")), "shards/shard-00002.h5"
    said = f"sample 4: the same bits as in {made / shard}"
    assert said in cli.ok(f"dataset --replay {made} 4").out
    cli.fails(f"dataset --replay {made} 5", "expected a sample that is stored, got 5, of 5")
    # The stored recipe counts, and not what the plan would be today.
    manifest = json.loads((copy / MANIFEST).read_text())
    manifest["plan"]["seed"] = 9
    (copy / MANIFEST).write_text(json.dumps(manifest))
    with h5py.File(copy / shard, "r+") as file:
        file["joints"][0, 0, 0] += 1.0
    status, out, err = cli("dataset --replay copy 4")
    assert (status, "joints: 1 of 75 numbers differ" in out) == (1, True)
    assert "1 difference" in err


def test_a_shard_made_of_what_it_stored_has_the_same_bytes(made, tmp_path):
    folder = Path(shutil.copytree(made, tmp_path / "copy"))
    made_now = ShardMaker(folder, PLAN).run(1, clradar.open_device(DEVICE), silent)
    assert (made_now.count, digests(folder)) == (0, digests(made))


# What sums up a data set


@pytest.mark.parametrize("products", [["volume"], ["capture"], ["mesh", "joints"]])
def test_every_product_is_drawn_on_contact_sheets(made, monkeypatch, products):
    whole = read_sample(made, 2)
    few = {name: whole.arrays[name] for name in arrays_of(products)}
    read = "clradar.dataset.contact_sheet.stored_sample"
    monkeypatch.setattr(read, lambda *_: (Sample(whole.recipe, few), {}))
    axes, *others = contact_sheet(made).axes
    drawn = len(axes.images) + len(axes.lines)
    assert (drawn, len(others)) == (5 if products == ["mesh", "joints"] else 1, 4)
    if products == ["volume"]:  # whose outer voxels end half a step beyond their centres
        assert axes.images[0].get_extent() == pytest.approx([-0.105, 0.105, -0.105, 0.105])


def test_the_estimate_is_near_what_is_written(made):
    seconds, size, _ = estimate(PLAN, device=DEVICE)
    made_bytes = sum(path.stat().st_size for path in (made / "shards").iterdir())
    assert abs(size - made_bytes) < SIZE_SHARE * made_bytes
    assert seconds > 0


def test_a_dry_run_writes_nothing(cli):
    light_file(Path(), samples=100000)
    assert "all 100000 samples: " in cli.ok("dataset plan.toml --dry-run -o out").out
    assert [path.name for path in Path().iterdir()] == ["plan.toml"]


def test_xarray_has_the_numbers_axes_units_and_labels(made):
    view = clradar.open_dataset(made)
    assert view.sizes["sample"] == 5
    assert view.sample.values.tolist() == list(range(5))
    assert view.pose.values.tolist() == ["A", "B", "F", "A", "B"]
    for sample in (0, 3):
        again = read_sample(made, sample).arrays
        one = view.sel(sample=sample)
        for name in ("capture", "volume", "max_projection", "depth_map", "joints"):
            np.testing.assert_array_equal(one[name].values, again[name])
        faces = again["mesh_faces"]
        assert (faces.min(), faces.max() + 1) == (0, len(again["mesh_vertices"]))
        assert json.loads(one.recipe.values.item()) == recipe(PLAN, sample)
        assert one.alpha.sel(part="palm") == recipe(PLAN, sample)["alpha"]["palm"]
    assert isinstance(json.loads(view.made_with.values[1]), dict)
    assert view.depth_map.attrs == {"units": "m", "long_name": "depth of the maximum; NaN: nothing"}
    assert view.joint.values.tolist() == list(JOINT_NAMES)
    assert view.capture.dims == ("sample", "tx", "rx", "frequency_hz")
    assert view.tx_m.shape == (12, 3)
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 0.01)
    np.testing.assert_array_equal(view.z_m.values, grid.z_m)
    labels = labels_of(PLAN)
    assert {name for name, label in labels.items() if label.axes} <= set(view.data_vars)
    assert view.attrs["complete"] == 1
    own = xarray.open_mfdataset(sorted(str(path) for path in (made / "shards").iterdir()))
    xarray.testing.assert_equal(own, view)
    assert own.joints.attrs == view.joints.attrs


def test_xarray_reads_lazily_wherever_it_goes_on(made, tmp_path, monkeypatch):
    folder = Path(shutil.copytree(made, tmp_path / "copy"))
    monkeypatch.chdir(tmp_path)
    view = pickle.loads(pickle.dumps(open_dataset("copy")))
    monkeypatch.chdir(folder)
    assert view.volume.chunks is not None
    (folder / "shards" / "shard-00001.h5").unlink()
    assert view.volume[0].values.any()
    with pytest.raises(FileNotFoundError, match="shard-00001"):
        view.volume[2].compute()


@pytest.fixture
def torch(monkeypatch):
    """Stand in for PyTorch, which is too large to be installed for this: of it `as_tensor` is used.

    What it returns is an array, so that values can be looked at.
    """
    module = types.ModuleType("torch")
    module.as_tensor = np.asarray
    monkeypatch.setitem(sys.modules, "torch", module)


@pytest.mark.usefixtures("torch")
def test_torch_gets_tensors_and_numbers_of_classes(made):
    names = ("max_projection", "joints", "alpha", "pose", "handedness", "sample")
    data = TorchDataset(made, names)
    assert len(data) == 5
    assert data.poses == ("A", "B", "F")
    view = open_dataset(made)
    for at in (0, -1, 2):
        sample = data[at]
        assert tuple(sample) == names
        np.testing.assert_array_equal(sample["joints"], view.joints[at].values)
        np.testing.assert_array_equal(sample["max_projection"], view.max_projection[at].values)
        assert data.poses[int(sample["pose"])] == view.pose[at]
        assert ("right", "left")[int(sample["handedness"])] == view.handedness[at]
        assert int(sample["sample"]) == view.sample[at]
    other = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(other[1]["alpha"], data[1]["alpha"])
    with pytest.raises(IndexError):
        data[5]
    assert TorchDataset(made, ("pose",), transform=lambda s: int(s["pose"]) + 10)[2] == 12
    with pytest.raises(ModelError, match="'mesh'"):
        TorchDataset(made, ("mesh",))


def test_what_is_not_installed_is_named(made, monkeypatch):
    for name in ("xarray", "torch"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=r"pip install xarray h5netcdf 'dask\[array\]'"):
        open_dataset(made)
    data = TorchDataset(made)
    assert len(data) == 5
    with pytest.raises(ClradarError, match="expected PyTorch"):
        data[0]
