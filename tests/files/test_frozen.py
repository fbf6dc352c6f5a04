"""Files that were written earlier are read as they were meant (docs/versions.md).

Each folder of `frozen/` is named by when `support/frozen_files.py` wrote it. Nothing in them is
ever changed; whoever changes what is written adds a folder.
"""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from comparisons import same_record
from frozen_files import capture, channels, counted, volume

import clradar
import clradar.dataset
from calibration.hand_fit.frame_fit import FrameFit
from calibration.hand_fit.starts import read_start
from clradar.dataset.folder import check_dataset
from clradar.hand import HandShape, read_pose
from measurement_io import (
    check_file,
    open_capture,
    open_channels,
    open_recording,
    open_volume,
    read_transform,
)

FROZEN = sorted(path for path in Path(__file__).with_name("frozen").iterdir() if path.is_dir())

KINDS = {
    "capture": (open_capture, capture, "patterns"),
    "volume": (open_volume, volume, "scale"),
    "channels": (open_channels, channels, "patterns"),
}
"""How to read native files, how they were made, and what version 2 has besides."""

NATIVE = tuple(f"{kind}-{v}.h5" for kind in KINDS for v in (1, 2))
OTHERS = (
    *("recording", "movement", "data-set", "data-set-stopped"),
    *("pose.toml", "pose.json", "materials.toml", "materials.json"),
    *("fit.json", "frame-fit.json", "frame-nothing.json", "joints.json"),
    "transform.json",
)


def folders_with(name):
    """Try a test with each folder that holds a file: a folder has what was new when it was made."""
    found = [path for path in FROZEN if (path / name).exists()]
    return pytest.mark.parametrize("frozen", found, ids=lambda path: path.name)


def test_what_is_frozen():
    """Every kind of file, and nothing that no test reads."""
    assert {path.name for path in FROZEN[0].iterdir()} == {*NATIVE, *OTHERS}
    for folder in FROZEN[1:]:
        assert {path.name for path in folder.iterdir()} <= {*NATIVE, *OTHERS}


@folders_with("capture-1.h5")
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_native_files(frozen, kind, version):
    read, made, besides = KINDS[kind]
    path = frozen / f"{kind}-{version}.h5"
    with h5py.File(path) as file:
        assert file.attrs["clradar_version"] == version
    assert same_record(read(path), made(**{besides: version == 2}))
    assert check_file(path).ok


@folders_with("recording")
def test_recordings(frozen):
    folder = frozen / "recording" / "30"
    recording = open_recording(folder)
    assert (len(recording), recording.timestamps_us) == (1, (1000,))
    expected = np.zeros((94, 94, 2), np.complex64)
    expected[0, 0], expected[3, 5], expected[93, 93] = counted(3, 2)
    np.testing.assert_array_equal(recording[0].data, expected)
    np.testing.assert_array_equal(recording.with_variant("emptyfiltered")[0].data, expected / 2)
    assert recording[0].waveform.frequencies_hz.tolist() == [72e9, 82e9]
    assert recording[0].meta["gain"] == 0.5
    assert recording.metadata["distance_meters"] == 0.3
    np.testing.assert_array_equal(
        recording.alignment.to_antenna("photogrammetry"), np.diag([1.0, 1, 1, 1])
    )
    largest = np.abs(counted(3, 2)).max()
    depth = recording.depth_map(0)
    wanted = 2 * largest * np.abs(counted(5, 3, 4)).max(axis=0)  # times the number of frequencies
    assert np.abs(depth.amplitude - wanted).max() < 1  # stored without its fraction
    assert np.nanmax(depth.depth_m) == 0.32
    assert check_file(folder).ok


@folders_with("data-set")
def test_data_sets(frozen):
    folder = frozen / "data-set"
    with clradar.dataset.open_dataset(folder) as view:
        assert (view.attrs["complete"], view.sizes["sample"]) == (1, 2)
        assert view.pose.values.tolist() == ["A", "F"]
        assert view.frequency_hz.values.tolist() == np.linspace(72e9, 82e9, 4).tolist()
        for i, path in enumerate(sorted((folder / "shards").iterdir())):
            with h5py.File(path) as file:
                for name in ("capture", "volume", "max_projection", "depth_map", "joints"):
                    stored = file[f"entry/{name}/data"][0]
                    np.testing.assert_array_equal(view[name].values[i], stored)
        largest = np.abs(view.volume.values).max(axis=1)
        np.testing.assert_allclose(view.max_projection.values, largest, rtol=1e-6)
        palm = view.joints.sel(joint="wrist", coordinate="z").values
        assert ((palm > 0.25) & (palm < 0.35)).all()
    mesh = clradar.dataset.read_sample(folder, 1).arrays
    assert mesh["mesh_faces"].max() + 1 == len(mesh["mesh_vertices"])
    assert check_dataset(folder).ok


# That a sample is set aside, and, elsewhere, that the others were made on another device.
@pytest.mark.device
@pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")
@folders_with("data-set-stopped")
def test_a_data_set_that_was_stopped_is_completed(frozen, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(frozen / "data-set-stopped", folder)
    part = folder / "parts" / "00000002.h5"  # of version 1
    kept = {}
    if part.exists():
        with h5py.File(part) as file:
            kept[2] = file["entry/max_projection/data"][0]
    before = (folder / "shards" / "shard-00000.h5").read_bytes()
    plan = clradar.dataset.folder.read_manifest(folder).plan
    result = clradar.dataset.run(plan, folder, device="pocl")
    # Of five one was set aside, one is in the shard, one may be in the part.
    assert (result.made, [aside.sample for aside in result.aside]) == (3 - len(kept), [1])
    assert (folder / "shards" / "shard-00000.h5").read_bytes() == before
    with clradar.dataset.open_dataset(folder) as view:
        assert view.sample.values.tolist() == [0, 2, 3, 4]
        for sample, image in kept.items():
            np.testing.assert_array_equal(view.max_projection.sel(sample=sample).values, image)
    assert check_dataset(folder).ok
    assert sorted(path.name for path in folder.iterdir() if path.is_dir()) == ["shards"]


@folders_with("pose.toml")
@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_poses_and_materials(frozen, suffix):
    pose = read_pose(frozen / f"pose.{suffix}")
    assert pose.name == "W"
    flexed = pose.angles("thumb-phalanx-distal").degrees()[0]
    stored = json.loads((frozen / "pose.json").read_text())
    assert flexed == stored["joints"]["thumb-phalanx-distal"]["flexion_deg"]
    found = clradar.read_materials(frozen / f"materials.{suffix}")
    assert list(found) == ["palm", "metal"]
    assert found["palm"].roughness_rms_m == 0.15e-3
    assert found["palm"].coating.thickness_m == 0.14e-3
    assert found["metal"].permittivity is None


@folders_with("fit.json")
def test_fits_of_hands(frozen):
    start = read_start(frozen / "fit.json")
    assert (start.pose.name, start.handedness, start.shape) == ("F", "right", HandShape())
    assert 0.2 < start.transform[2, 3] < 0.4
    record = json.loads((frozen / "frame-fit.json").read_text())
    seen = FrameFit.from_dict(record, frozen)
    assert (seen.frame, seen.time_s, seen.how, seen.notes) == (3, 0.5, "followed", ("a note",))
    assert (seen.misfit, seen.joint_std_m.tolist()) == (12.5, 25 * [2e-3])
    again = seen.to_dict()
    assert again.keys() == record.keys()
    assert again["pose"] == record["pose"]
    assert again["transform"] == record["transform"]
    nothing = json.loads((frozen / "frame-nothing.json").read_text())
    assert FrameFit.from_dict(nothing, frozen).state is None
    assert FrameFit.from_dict(nothing, frozen).notes == ("dark",)


@folders_with("movement")
def test_truths_of_recorded_hands(frozen):
    folder = frozen / "movement" / "truth"
    truth = json.loads((folder / "truth.json").read_text())
    assert [frame["timestamp_us"] for frame in truth["frames"]] == [0, 125_000]
    for frame in truth["frames"]:
        assert read_pose(folder / frame["pose"]).name
        assert np.shape(frame["transform"]) == (4, 4)
        assert frame["joints_m"].keys() == json.loads((frozen / "joints.json").read_text()).keys()


@folders_with("transform.json")
def test_transforms(frozen):
    wanted = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.01], [0, 0, 0, 1]]
    assert read_transform(frozen / "transform.json").tolist() == wanted
