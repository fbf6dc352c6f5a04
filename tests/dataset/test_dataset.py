"""Data sets: what is in them, going on after a kill, replay, verification, how they are read."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from dataset_plans import tiny
from rig_files import RigMaker

import clradar
from clradar.cli import main
from clradar.dataset import PlanError, TorchDataset, make_sample, open_dataset, recipe, replay, run
from clradar.dataset.engine.estimate import estimate
from clradar.dataset.engine.serial import Outcome, PartMaker, Serial
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.reader import plan_from
from clradar.dataset.sample import _rig, rotation
from clradar.dataset.store.check import check_dataset, describe_dataset
from clradar.dataset.store.fields import FIELDS, LABELS
from clradar.dataset.store.folder import (
    CONTACT_SHEET,
    MANIFEST,
    STATISTICS,
    SUMMARIES,
    TABLE,
    Aside,
    DatasetFolder,
    read_manifest,
)
from clradar.dataset.store.shard_reader import opened, sample_of
from clradar.dataset.summary.contact_sheet import contact_sheet
from clradar.errors import ClradarError, MeasurementError, ModelError, OutputError
from clradar.hand import JOINT_NAMES, POSES, HandShape, hand_mesh

DEVICE = "pocl"

POINT_ERROR_M = 1e-9
"""Rotations and translations of decimetres in float64: rounding is some 1e-16 m."""

HALF_FLOAT_M = 2e-8
"""float32 of lengths below 0.5 m: half of 2**-24 of 0.5 m is 1.5e-8 m."""

SIZE_SHARE = 0.25
"""How far the estimate of bytes may be off: samples compress differently."""


def plan_of(**tables: Any) -> Plan:
    return plan_from(tiny(**tables), "plan", Path())


PLAN = plan_of()
LIGHT = plan_of(
    samples=7,
    impairments=None,
    output={"shard_size": 3, "products": ["joints"]},
    poses={"names": ["A", "B"]},
)
"""Hands alone: nothing is simulated."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of `PLAN`, whole; not to be changed."""
    folder = tmp_path_factory.mktemp("dataset") / "made"
    result = run(PLAN, folder, device=DEVICE)
    assert (result.made, result.samples, result.aside) == (5, 5, ())
    return folder


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of `LIGHT`, whole; not to be changed."""
    folder = tmp_path_factory.mktemp("dataset") / "light"
    run(LIGHT, folder, device=DEVICE)
    return folder


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    """A data set that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "copy"))


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file but the lock, by name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


class Counting(Serial):
    """An engine in some order that counts what it makes, and may stop before the end."""

    def __init__(self, *, backwards: bool = False, stop_after: int | None = None) -> None:
        super().__init__(DEVICE)
        self.backwards, self.stop_after = backwards, stop_after
        self.made: list[int] = []

    def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
        for sample in reversed(samples) if self.backwards else samples:
            if self.stop_after is not None and len(self.made) == self.stop_after:
                raise KeyboardInterrupt
            make(sample)
            self.made.append(sample)
            yield sample


def failing(bad: int, error: Exception) -> Serial:
    """Return an engine for which one sample fails."""

    class Failing(Serial):
        def outcomes(self, samples: Sequence[int], make: Any) -> Iterator[Outcome]:
            def tried(sample: int) -> int:
                if sample == bad:
                    raise error
                return make(sample)

            return Serial.outcomes(self, samples, tried)  # type: ignore[arg-type]

    return Failing(DEVICE)


# What a sample is


def test_a_sample_is_what_its_parts_give_by_themselves(made: Path) -> None:
    wanted = recipe(PLAN, 2)
    hand, place = wanted["hand"], wanted["placement"]
    assert wanted["pose"]["name"] == "F"
    shape = HandShape(**{**hand["shape"], "finger_lengths": tuple(hand["shape"]["finger_lengths"])})
    mesh = hand_mesh(POSES["F"], 4e-3, hand["handedness"], (0.0, 0.0, 0.0), shape)
    # About y alone, as the plan has it.
    angle = place["rotation_rad"][1]
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    vertices_m = mesh.vertices_m @ turn.T + place["center_m"]
    joints_m = mesh.joints_m @ turn.T + place["center_m"]
    alpha = {name: wanted["alpha"][name] for name in mesh.part_names}
    scene = clradar.Scene(
        vertices_m, mesh.faces, 0.5, mesh.part, mesh.part_names, mesh.normals @ turn.T
    ).with_alpha(alpha)
    array = clradar.arrays.qar50()
    array = clradar.AntennaArray(array.tx_m[::8], array.rx_m[::8], "thinned")
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    capture = clradar.simulate(
        scene,
        array,
        waveform,
        samples_per_mm2=0.05,
        rays_per_sample=160,
        seed=wanted["simulation"]["seed"],
        estimator="expected",
        device=DEVICE,
    )
    faults = wanted["impairments"]
    capture = clradar.impair(capture, seed=faults["seed"], snr_db=faults["snr_db"])
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 0.01)
    volume = clradar.backproject(capture, grid, device=DEVICE)

    with opened(made / "shards" / "shard-00001.h5") as file:
        sample = sample_of(file, 0)
    assert sample.recipe == wanted
    found = sample.arrays
    np.testing.assert_allclose(found["joints"], joints_m, rtol=0, atol=POINT_ERROR_M)
    np.testing.assert_allclose(found["mesh_vertices"], vertices_m, rtol=0, atol=HALF_FLOAT_M)
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


def test_turns_are_about_the_fixed_axes_x_then_y_then_z() -> None:
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


def test_samples_do_not_depend_on_what_was_made_before() -> None:
    first = make_sample(recipe(PLAN, 0), DEVICE)
    second = make_sample(recipe(PLAN, 1), DEVICE)
    for sample in (second, first):
        again = make_sample(sample.recipe, DEVICE)
        for name, array in sample.arrays.items():
            assert again.arrays[name].tobytes() == array.tobytes(), name


def test_a_recipe_may_be_its_text(made: Path) -> None:
    text = open_dataset(made).recipe.values[1]
    wanted = make_sample(recipe(PLAN, 1), DEVICE)
    for given in (text, text.encode()):
        again = make_sample(given, DEVICE)
        assert again.recipe == wanted.recipe
        for name, array in wanted.arrays.items():
            assert again.arrays[name].tobytes() == array.tobytes(), name


def test_what_a_recipe_leaves_out_is_none_or_one_error() -> None:
    whole = {**recipe(PLAN, 1), "products": ["capture"]}
    clean = make_sample({**whole, "impairments": None}, DEVICE).arrays["capture"]
    bare = {key: value for key, value in whole.items() if key not in ("impairments", "image")}
    for without in (bare, {**whole, "impairments": {}}):
        assert make_sample(without, DEVICE).arrays["capture"].tobytes() == clean.tobytes()
    noisy = make_sample({**whole, "impairments": {"snr_db": 3.0}}, DEVICE).arrays["capture"]
    assert noisy.tobytes() != clean.tobytes()
    for given, words in (
        ({**whole, "hand": {}}, "got no 'edge_length_m'"),
        ({}, "'products'"),
        ("{", "no JSON"),
        ("[1]", "got list"),
        (3, "got int"),
    ):
        with pytest.raises(ModelError, match=words):
            make_sample(given, DEVICE)  # type: ignore[arg-type]


THREADS = """
import hashlib, json, sys
from pathlib import Path
from clradar.dataset import make_sample
for text in json.load(open(sys.argv[1])):
    arrays = make_sample(text, "pocl").arrays
    print({name: hashlib.sha256(array.tobytes()).hexdigest() for name, array in arrays.items()})
"""


def test_bits_do_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    # More pairs and voxels than work for one thread; sizes for which BLAS takes several.
    plan = plan_of(
        hands={"edge_mm": 3},
        radar={"every": 2, "steps": 64},
        image={"step_mm": [3, 3, 5], "x_mm": [-60, 60], "y_mm": [-90, 90]},
        impairments={"channels": {}, "adc_bits": 12, "coupling_db": 10},
        simulation={"samples_per_mm2": 0.1},
    )
    path = tmp_path / "recipes.json"
    path.write_text(json.dumps([recipe(plan, 1)]))
    found = set()
    for opencl, blas in ((1, 1), (2, 4)):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        threads = {name: str(blas) for name in names}
        threads |= {"POCL_MAX_PTHREAD_COUNT": str(opencl), "POCL_CPU_MAX_CU_COUNT": str(opencl)}
        found.add(
            subprocess.run(
                [sys.executable, "-c", THREADS, str(path)],
                env={**os.environ, **threads},
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
    assert len(found) == 1


def test_rigs_are_hands_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    RigMaker().save(tmp_path / "hand.glb")
    plan_text = "samples = 2\n[poses]\nnames = ['B']\n[hands]\nrigs = ['hand.glb']\n"
    plan_text += "handedness = 'both'\n[output]\nproducts = ['mesh', 'joints']\n"
    (tmp_path / "plan.toml").write_text(plan_text)
    plan = clradar.dataset.read_plan(tmp_path / "plan.toml")  # type: ignore[attr-defined]
    result = run(plan, tmp_path / "out", device=DEVICE)
    assert result.aside == ()
    assert check_dataset(tmp_path / "out").ok
    view = open_dataset(tmp_path / "out")
    assert view.rig.values.tolist() == ["hand.glb"] * 2
    assert np.isnan(view["shape"].values).all()

    # The folder's name is in none of the bytes.
    (tmp_path / "else" / "where").mkdir(parents=True)
    for name in ("plan.toml", "hand.glb"):
        shutil.copy(tmp_path / name, tmp_path / "else" / "where" / name)
    moved = clradar.dataset.read_plan(tmp_path / "else" / "where" / "plan.toml")  # type: ignore[attr-defined]
    run(moved, tmp_path / "else" / "out", device=DEVICE)
    assert digests(tmp_path / "else" / "out") == digests(tmp_path / "out")
    assert str(tmp_path) not in (tmp_path / "out" / MANIFEST).read_text()
    assert run(moved, tmp_path / "out", device=DEVICE).made == 0

    (tmp_path / "hand.glb").rename(tmp_path / "away.glb")
    _rig.cache_clear()
    assert replay(tmp_path / "out", 0, device=DEVICE, rigs=moved.folder).differences == ()
    # In the data set's folder it is found, too; the current folder is first, if it is that file.
    shutil.copy(moved.folder / "hand.glb", tmp_path / "else" / "out")
    (tmp_path / "else" / "hand.glb").write_bytes(b"another")
    monkeypatch.chdir(tmp_path / "else")
    assert replay(tmp_path / "else" / "out", 0, device=DEVICE).differences == ()
    arguments = ["--replay", str(tmp_path / "out"), "0", "--rigs", str(moved.folder)]
    with pytest.raises(SystemExit) as ended:
        main(["dataset", "--device", DEVICE, *arguments])
    assert not ended.value.code
    assert "sample 0: the same bits" in capsys.readouterr().out
    (tmp_path / "else" / "hand.glb").unlink()
    for begun in (
        lambda: make_sample(recipe(plan, 0), DEVICE),
        lambda: replay(tmp_path / "out", 0, device=DEVICE),
        lambda: run(plan, tmp_path / "more", device=DEVICE),
    ):
        with pytest.raises(ModelError, match=r"hand\.glb: expected the file of .* nothing there"):
            begun()
    (tmp_path / "hand.glb").write_bytes(b"another file")
    with pytest.raises(ModelError, match="got another"):
        run(plan, tmp_path / "more", device=DEVICE)
    with pytest.raises(ModelError, match="expected the file of the plan"):
        make_sample(recipe(plan, 0), DEVICE, rigs=tmp_path)
    with pytest.raises(PlanError, match=r"hands.rigs\[0\]"):
        clradar.dataset.read_plan(tmp_path / "plan.toml")  # type: ignore[attr-defined]


# Runs


def test_the_order_of_making_changes_no_byte(made: Path, tmp_path: Path) -> None:
    run(PLAN, tmp_path / "other", engine=Counting(backwards=True))
    assert digests(tmp_path / "other") == digests(made)


def test_a_run_that_was_stopped_goes_on_with_what_is_missing(light: Path, tmp_path: Path) -> None:
    for stop in (0, 3, 5):
        folder = tmp_path / f"stopped-{stop}"
        first, second = Counting(stop_after=stop), Counting()
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, folder, engine=first)
        assert not (folder / CONTACT_SHEET).exists()
        # What a killed process was writing.
        (folder / "parts" / ".00000003.h5.abc.tmp").write_bytes(b"half")
        (folder / "shards" / ".shard-00001.h5.abc.tmp").write_bytes(b"half")
        run(LIGHT, folder, engine=second)
        assert sorted(first.made + second.made) == list(range(7))
        assert digests(folder) == digests(light)


@pytest.mark.parametrize("step", ["assemble", "write_manifest", "_remove_parts"])
def test_a_kill_while_a_shard_is_closed_loses_nothing(
    light: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    write_manifest = DatasetFolder.write_manifest

    def killed(*args: Any, **kwargs: Any) -> None:
        if step == "write_manifest" and not args[0].manifest.shards:
            write_manifest(args[0])  # that of the new data set
            return
        raise KeyboardInterrupt

    first, second = Counting(), Counting()
    with monkeypatch.context() as patch:
        if step == "assemble":
            patch.setattr("clradar.dataset.store.folder.assemble", killed)
        else:
            patch.setattr(DatasetFolder, step, killed)
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, tmp_path / "killed", engine=first)
    run(LIGHT, tmp_path / "killed", engine=second)
    assert sorted(first.made + second.made) == list(range(7))
    assert digests(tmp_path / "killed") == digests(light)


def test_a_sample_that_fails_is_set_aside_and_the_run_goes_on(tmp_path: Path) -> None:
    engine = failing(1, ValueError("it\nis poisoned"))
    result = run(LIGHT, tmp_path, engine=engine)
    assert result.aside == (Aside(1, "ValueError: it is poisoned", 2),)
    assert read_manifest(tmp_path).aside == {1: result.aside[0]}
    report = check_dataset(tmp_path)
    assert report.ok
    assert "set aside, with their reasons in the manifest: 1" in report.checked
    assert open_dataset(tmp_path).sample.values.tolist() == [0, 2, 3, 4, 5, 6]
    assert run(LIGHT, tmp_path, device=DEVICE).aside == result.aside


def test_a_shard_may_lose_all_its_samples(tmp_path: Path) -> None:
    class Losing(Serial):
        def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
            for sample in samples:
                yield Aside(sample, "no", 2) if sample < 3 else make(sample)

    run(LIGHT, tmp_path, engine=Losing(DEVICE))
    assert check_dataset(tmp_path).ok
    assert len(open_dataset(tmp_path).sample) == 4


def test_a_full_disk_ends_the_run(tmp_path: Path) -> None:
    error = OutputError("no space left on device")
    with pytest.raises(OutputError, match="no space left"):
        run(LIGHT, tmp_path, engine=failing(4, error))
    result = run(LIGHT, tmp_path, device=DEVICE)
    assert (result.made, result.aside) == (3, ())


def test_another_plan_is_one_error_unless_forced(copy: Path) -> None:
    other = plan_of(seed=4, samples=4)
    with pytest.raises(OutputError, match="another plan: seed 3, now 4; samples 5, now 4"):
        run(other, copy, device=DEVICE)
    (copy / "thesis.tex").write_text("mine")
    assert run(LIGHT, copy, device=DEVICE, force=True).made == 7
    assert check_dataset(copy).ok
    assert (copy / "thesis.tex").read_text() == "mine"


def test_what_differs_is_named_down_to_its_key(copy: Path) -> None:
    manifest = json.loads((copy / MANIFEST).read_text())
    rig = {"file": "/somewhere/" + 80 * "a" + "/one.glb", "handedness": "left", "sha256": 64 * "0"}
    manifest["plan"]["hands"] |= {"shape": "default", "rigs": [rig, rig]}
    (copy / MANIFEST).write_text(json.dumps(manifest))
    rigs = [rig, {**rig, "sha256": 64 * "1"}]
    content = tiny(hands={"shape": "default", "rigs": rigs})
    with pytest.raises(OutputError, match=r"another plan: hands.rigs\[1\].sha256 0+…, now 1+…\. "):
        run(plan_from(content, "plan", Path()), copy, device=DEVICE)
    rigs[1] = {**rig, "file": rig["file"].replace("one", "two")}
    with pytest.raises(OutputError, match=r"rigs\[1\].file …a+/one.glb, now …a+/two.glb\. "):
        run(plan_from(content, "plan", Path()), copy, device=DEVICE)
    rigs.pop()
    with pytest.raises(OutputError, match=r"another plan: hands.rigs of 2, now of 1\. "):
        run(plan_from(content, "plan", Path()), copy, device=DEVICE)


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match=r"holds files \(.*thesis.tex"):
        run(LIGHT, tmp_path, device=DEVICE)


# Replay


def test_a_sample_made_again_has_the_same_bits(made: Path, tmp_path: Path) -> None:
    again = replay(made, 3, device=DEVICE, output=tmp_path / "sample.h5")
    assert again.stored_in == "shards/shard-00001.h5"
    assert again.differences == ()
    with opened(tmp_path / "sample.h5") as file:
        written = sample_of(file, 0)
    assert written.recipe == recipe(PLAN, 3)
    for name, array in again.sample.arrays.items():
        assert written.arrays[name].tobytes() == array.tobytes()


def test_a_bit_that_differs_is_found(copy: Path) -> None:
    with h5py.File(copy / "shards" / "shard-00001.h5", "r+") as file:
        volume = file["entry/volume/data"]
        volume[1, 2, 3, 4] = np.nextafter(volume[1, 2, 3, 4].real, np.float32(np.inf)) + 0j
    found = replay(copy, 3, device=DEVICE)
    (line,) = found.differences
    assert line.startswith("volume: 1 of 4851 numbers differ")
    assert found.made_otherwise == ()


def test_the_command_replays(
    made: Path, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def called(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main([str(a) for a in ("dataset", "--device", DEVICE, *arguments)])
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    target = tmp_path / "sample.h5"
    status, out, _ = called("--replay", made, 4, "-o", target)
    assert status == 0
    assert f"sample 4: the same bits as in {made / 'shards' / 'shard-00002.h5'}" in out
    assert target.is_file()
    status, _, err = called("--replay", made, 4, "-o", target)
    assert (status, err.count("\n")) == (1, 1)
    assert "--force replaces it" in err
    status, _, err = called("--replay", made, 5)
    assert (status, "expected a whole number in [0, 4], got 5" in err) == (1, True)

    manifest = json.loads((copy / MANIFEST).read_text())
    manifest["plan"]["seed"] = 9
    (copy / MANIFEST).write_text(json.dumps(manifest))
    status, out, err = called("--replay", copy, 4)
    assert status == 1
    assert "recipe: simulation.seed" in out
    assert "difference" in err


# Verification


def test_a_whole_data_set_is_all_right(made: Path) -> None:
    report = check_dataset(made)
    assert report.ok, report.problems
    assert describe_dataset(made).values["samples"] == {"stored": 5, "plan": 5}


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def changed(place: str, value: Any) -> Any:
    """Return a damage: a dataset of shard 1 is changed, and its checksum made right again."""

    def damage(folder: Path) -> None:
        path = folder / "shards" / "shard-00001.h5"
        with h5py.File(path, "r+") as file:
            if isinstance(value, h5py.ExternalLink):
                del file[place]
                file[place] = value
            else:
                file[place][...] = value(file[place][...])
        manifest = json.loads((folder / MANIFEST).read_text())
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        manifest["shards"][1]["sha256"] = digest
        (folder / MANIFEST).write_text(json.dumps(manifest))

    return damage


def with_nan(array: np.ndarray) -> np.ndarray:
    array[1].flat[0] = np.nan
    return array


OUTSIDE = h5py.ExternalLink("shard-00000.h5", "entry/joints/data")


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: flipped(f / "shards" / "shard-00001.h5"), "expected SHA-256"),
        (lambda f: (f / "shards" / "shard-00001.h5").unlink(), "got nothing there"),
        (lambda f: (f / "shards" / "more.h5").write_bytes(b""), "can be removed by hand"),
        (lambda f: (f / "parts" / "00000001.h5").write_bytes(b""), "left over"),
        (lambda f: (f / "parts" / "1.csv").write_bytes(b""), "1.csv: is not of this data set"),
        (lambda f: flipped(f / "shards" / "shard-00001.h5"), "delete the file, and the same"),
        (lambda f: (f / MANIFEST).write_text("{"), "manifest.json"),
        (lambda f: (f / MANIFEST).unlink(), "manifest.json"),
        (changed("entry/labels/sample", lambda a: a + 1), "expected the samples 2, 3, got 3, 4"),
        (changed("entry/labels/recipe", lambda a: a[::-1]), "recipes, got others for the samples"),
        (changed("entry/labels/alpha", lambda a: a + 0.1), "labels/alpha: expected the value"),
        (changed("entry/labels/pose", lambda a: a[::-1]), "labels/pose: expected the value"),
        (changed("entry/axes/x_m", lambda a: a + 0.001), "axes/x_m: expected the values"),
        (changed("entry/capture/data", with_nan), "finite numbers, got others in the samples 3"),
        (changed("entry/joints/data", with_nan), "joints/data: expected finite"),
        (changed("entry/joints/data", OUTSIDE), "a link of kind ExternalLink"),
    ],
)
def test_damage_is_found(copy: Path, damage: Any, words: str) -> None:
    damage(copy)
    report = check_dataset(copy)
    assert not report.ok
    assert any(words in line for line in report.problems), report.problems


def test_replay_reads_nothing_outside_the_shard(copy: Path) -> None:
    changed("entry/joints/data", OUTSIDE)(copy)
    with pytest.raises(MeasurementError, match=r"shard-00001\.h5: .* link of kind ExternalLink"):
        replay(copy, 3, device=DEVICE)


def test_a_data_set_that_is_not_complete_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(LIGHT, tmp_path, device=DEVICE, engine=Counting(stop_after=4))
    for arguments, status in (
        (["inspect", str(tmp_path)], 0),
        (["inspect", str(tmp_path), "--check"], 1),
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert (ended.value.code or 0) == status
    out, err = capsys.readouterr()
    assert "samples    3 of 7" in out
    assert "not complete: shards 1, 2 are missing" in out
    assert "1 problem found" in err
    assert len(open_dataset(tmp_path).sample) == 3


def test_inspect_of_an_empty_folder_speaks_of_data_sets_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["inspect", str(tmp_path)])
    assert ended.value.code == 1
    assert "nor is it a data set, which has manifest.json" in capsys.readouterr().err


# Reading


def test_xarray_has_the_numbers_axes_units_and_labels(made: Path) -> None:
    view = clradar.open_dataset(made)
    assert view.sizes["sample"] == 5
    assert view.sample.values.tolist() == list(range(5))
    assert view.pose.values.tolist() == ["A", "B", "F", "A", "B"]
    for sample in range(5):
        again = make_sample(recipe(PLAN, sample), DEVICE).arrays
        one = view.sel(sample=sample)
        for name in ("capture", "volume", "max_projection", "depth_map", "joints"):
            np.testing.assert_array_equal(one[name].values, again[name])
        first, end = int(one.mesh_vertices_first), int(one.mesh_vertices_end)
        np.testing.assert_array_equal(view.mesh_vertices[first:end].values, again["mesh_vertices"])
        # Counted from 0 within the sample, as the docs have it.
        faces = view.mesh_faces[int(one.mesh_faces_first) : int(one.mesh_faces_end)].values
        assert (faces.min(), faces.max()) == (0, end - first - 1)
        assert json.loads(one.recipe.values.item()) == recipe(PLAN, sample)
        assert one.alpha.sel(part="palm") == recipe(PLAN, sample)["alpha"]["palm"]
    for text in (view.recipe.values[1], view.made_with.values[1]):
        assert isinstance(text, str)
        assert isinstance(json.loads(text), dict)
    assert view.depth_map.attrs["units"] == "m"
    assert view.joint.values.tolist() == list(JOINT_NAMES)
    assert view.capture.dims == ("sample", "tx", "rx", "frequency_hz")
    assert view.tx_m.shape == (12, 3)
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 0.01)
    np.testing.assert_array_equal(view.z_m.values, grid.z_m)
    assert {name for name, label in LABELS.items() if label.axes} <= set(view.data_vars)
    assert view.attrs["complete"] == 1


def test_xarray_reads_when_asked(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "copy"))
    view = pickle.loads(pickle.dumps(open_dataset(folder)))
    assert view.volume.chunks is not None
    (folder / "shards" / "shard-00001.h5").unlink()
    assert view.volume[0].values.any()
    with pytest.raises(MeasurementError, match="shard-00001"):
        view.volume[2].compute()


def test_no_data_set_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match="nothing there"):
        open_dataset(tmp_path)


def test_without_xarray_the_error_says_what_to_install(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'clradar\[dataset\]'"):
        open_dataset(made)


@pytest.fixture
def torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in for PyTorch, which is too large to be installed for this: of it `as_tensor` is used.

    What it returns is an array, so that values can be looked at.
    """
    module = types.ModuleType("torch")
    module.as_tensor = np.asarray  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch", module)


@pytest.mark.usefixtures("torch")
def test_torch_gets_tensors_and_numbers_of_classes(made: Path) -> None:
    names = ("max_projection", "joints", "alpha", "pose", "handedness", "sample")
    data = TorchDataset(made, names)
    assert len(data) == 5
    assert data.poses == ("A", "B", "F")
    view = open_dataset(made)
    for at in (0, 3, -1, 2):
        sample = data[at]
        assert tuple(sample) == names
        np.testing.assert_array_equal(sample["joints"], view.joints[at].values)
        np.testing.assert_array_equal(sample["max_projection"], view.max_projection[at].values)
        assert data.poses[int(sample["pose"])] == view.pose[at]
        assert ("right", "left")[int(sample["handedness"])] == view.handedness[at]
        assert int(sample["sample"]) == view.sample[at]
    other = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(other[1]["alpha"], data[1]["alpha"])
    data.close()
    assert int(data[1]["pose"]) == 1
    with pytest.raises(IndexError):
        data[5]
    assert TorchDataset(made, ("pose",), transform=lambda s: int(s["pose"]) + 10)[2] == 12
    with pytest.raises(ModelError, match="'mesh'"):
        TorchDataset(made, ("mesh",))


def test_without_torch_only_samples_fail(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    data = TorchDataset(made)
    assert len(data) == 5
    with pytest.raises(ClradarError, match="expected PyTorch"):
        data[0]


# What is said of it


def test_statistics_are_those_of_the_samples(made: Path) -> None:
    view = open_dataset(made)
    record = json.loads((made / STATISTICS).read_text())
    assert record["samples"] == 5
    assert record["counts"]["pose"] == {"A": 2, "B": 2, "F": 1}
    peaks = view.max_projection.max(("y_m", "x_m")).values.astype(np.float64)
    depths = view.depth_map.values
    for name, values in (
        ("max_projection: peak", peaks),
        ("center_m: z", view.center_m.values[:, 2]),
        ("alpha: thumb", view.alpha.values[:, 1]),
        ("depth_map: share with a depth", np.isfinite(depths).mean(axis=(1, 2))),
        ("depth_map: mean depth", np.nanmean(depths.astype(np.float64), axis=(1, 2))),
    ):
        found = record["quantities"][name]
        wanted = {
            "min": values.min(),
            "mean": values.mean(),
            "std": values.std(),
            "max": values.max(),
        }
        assert found["count"] == 5
        for key, value in wanted.items():
            assert found[key] == pytest.approx(value, rel=1e-9, abs=1e-12), (name, key)
    with open(made / TABLE, newline="") as file:
        rows = {row["quantity"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(record["quantities"])
    assert float(rows["center_m: z"]["mean"]) == record["quantities"]["center_m: z"]["mean"]


def test_there_is_a_contact_sheet(made: Path) -> None:
    from PIL import Image

    with Image.open(made / CONTACT_SHEET) as picture:
        width, height = picture.size
        colours = len(np.unique(np.asarray(picture).reshape(-1, 4), axis=0))
    assert width > 2.5 * height  # five in a row
    assert colours > 100


@pytest.mark.parametrize("products", [["volume"], ["depth_map"], ["capture"], ["mesh", "joints"]])
def test_every_product_has_a_picture(products: list[str]) -> None:
    names = [name for p in products for name in FIELDS if name.partition("_")[0] == p or name == p]
    sample = make_sample({**recipe(PLAN, 2), "products": products}, DEVICE)
    assert set(sample.arrays) == set(names)
    axes = contact_sheet([sample]).axes
    assert len(axes) == 1
    drawn = len(axes[0].images) + len(axes[0].lines)
    assert drawn == (6 if products == ["mesh", "joints"] else 1)  # the cloud, and five digits


def test_summaries_that_were_lost_are_written_again(copy: Path) -> None:
    before = digests(copy)
    for name in SUMMARIES:
        (copy / name).unlink()
    run(PLAN, copy, device=DEVICE)
    assert digests(copy) == before


def test_the_estimate_is_near_what_is_written(made: Path) -> None:
    found = estimate(PLAN, device=DEVICE)
    size = sum(path.stat().st_size for path in (made / "shards").iterdir())
    assert abs(found.total_bytes - size) < SIZE_SHARE * size
    assert found.sample_s > 0
    assert found.total_s == pytest.approx(found.first_s + 4 * found.sample_s)


def test_a_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = "samples = 100000\n[poses]\nnames = ['A']\n[hands]\nedge_mm = 4\n"
    (tmp_path / "plan.toml").write_text(plan + "[output]\nproducts = ['joints']\n")
    with pytest.raises(SystemExit) as ended:
        main(["dataset", str(tmp_path / "plan.toml"), "--dry-run", "-o", str(tmp_path / "out")])
    assert not ended.value.code
    out = capsys.readouterr().out
    assert "all 100000 samples: " in out
    assert [path.name for path in tmp_path.iterdir()] == ["plan.toml"]


def test_wrong_usage_is_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (
        ["dataset"],
        ["dataset", "plan.toml", "--replay", "x", "1"],
        ["dataset", "plan.toml", "--rigs", "x", "-o", "y"],
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
    capsys.readouterr()
