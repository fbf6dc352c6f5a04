"""The scripts of calibration: their results are the library's, their errors one line."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure
from recorded_targets import HALF, SMALL, instrument

import clradar
from calibration import FlatPlate, correct, estimate_channels, range_gate, subtract_background
from measurement_io import open_capture, open_channels, save_capture

FOLDER = Path(__file__).resolve().parents[3] / "calibration" / "scripts"


@pytest.fixture
def start(monkeypatch, capsys, tmp_path):
    """Run a script in this process, as by its file elsewhere: success, output and errors."""
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.chdir(tmp_path)
    # The figure and images of 2 mm voxels would take most of the time.
    monkeypatch.setattr("calibration.roughness.figures.sweep_figure", lambda _: Figure())
    from_extent = clradar.VoxelGrid.from_extent
    monkeypatch.setattr(
        clradar.VoxelGrid, "from_extent", lambda x, y, z, _: from_extent(x, y, z, 4e-3)
    )

    def run(name: str, *arguments: object) -> tuple[bool, str, str]:
        path = FOLDER / f"{name}.py"
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, arguments)])
        code: object = 0
        try:
            runpy.run_path(str(path), run_name="__main__")
        except SystemExit as ended:
            code = ended.code
        printed = capsys.readouterr()
        return code in (0, None), printed.out, code if isinstance(code, str) else printed.err

    return run


def recorded(seed: int) -> clradar.Capture:
    """A plate 30 cm away, by an instrument whose channels differ."""
    return instrument(seed, SMALL, n_freq=16).record_target(FlatPlate(0.3))


def test_background(start, tmp_path):
    hand, empty = recorded(1), recorded(2)
    save_capture(tmp_path / "hand.h5", hand)
    save_capture(tmp_path / "empty.h5", empty)
    clean = tmp_path / "clean.h5"
    files = (tmp_path / "hand.h5", "--empty", tmp_path / "empty.h5", "-o", clean)
    fine, _, err = start("background", *files, "--near-mm", 80, "--far-mm", 140)
    assert fine, err
    expected = subtract_background(hand, empty, scaling="common")
    expected = range_gate(expected, near_m=0.08, far_m=0.14)
    assert np.array_equal(open_capture(clean).data, expected.data)
    # A second time it would overwrite.
    fine, _, err = start("background", *files)
    assert not fine
    assert err.startswith("background.py: error: ")
    assert len(err.splitlines()) == 1


def test_channels(start, tmp_path):
    plate, other = recorded(3), recorded(4)
    save_capture(tmp_path / "plate.h5", plate)
    save_capture(tmp_path / "other.h5", other)
    fine, out, err = start(
        "channels", tmp_path / "plate.h5", "-o", tmp_path / "channels.h5", "--distance-mm", 300,
        "--correct", tmp_path / "other.h5", "--corrected", tmp_path / "corrected.h5",
    )  # fmt: skip
    assert fine, err
    channels = estimate_channels(plate, FlatPlate(0.3))
    assert np.array_equal(
        open_channels(tmp_path / "channels.h5").response.tx_gain, channels.response.tx_gain
    )
    expected = correct(other, channels)
    assert np.array_equal(open_capture(tmp_path / "corrected.h5").data, expected.data)
    assert "of the echoes is left" in out


@pytest.fixture
def plate_files(tmp_path):
    """A rough plate in its place: a mesh and a capture."""
    corners = [[-0.03, -0.03, 0.3], [0.03, -0.03, 0.3], [0.03, 0.03, 0.3], [-0.03, 0.03, 0.3]]
    faces = [[0, 1, 2], [0, 2, 3]]
    trimesh.Trimesh(corners, faces, process=False).export(tmp_path / "plate.ply")
    waveform, scene = clradar.Waveform.sfcw(72e9, 82e9, 32), clradar.Scene(corners, faces, 0.5)
    rays = {"samples_per_mm2": 5.0, "estimator": "stochastic", "device": "pocl"}
    capture = clradar.simulate(scene, HALF, waveform, **rays)
    save_capture(tmp_path / "capture.h5", capture)


def test_sweep(start, plate_files, tmp_path):
    place = {"transform": np.eye(4).tolist()}
    (tmp_path / "transform.json").write_text(json.dumps(place))
    fine, out, err = start(
        "sweep", tmp_path / "capture.h5", tmp_path / "plate.ply", "-o", tmp_path / "sweep.png",
        "--transform", tmp_path / "transform.json", "--alphas", 3, "--samples-per-mm2", 0.5,
        "--seeds", 2,
    )  # fmt: skip
    assert fine, err
    assert out.startswith("alpha: 0.")
    assert (tmp_path / "sweep.png").read_bytes().startswith(b"\x89PNG")


def test_align(start, plate_files, tmp_path):
    output = tmp_path / "transform.json"
    arguments = ("align", tmp_path / "capture.h5", tmp_path / "plate.ply", "-o", output, "--quick")
    fine, out, err = start(*arguments)
    assert fine, err
    found = np.array(json.loads(output.read_text())["transform"])
    at_m = np.array([0.0, 0.0, 0.3])
    # The mesh is in place already, and the bias of a fit without correction is a few millimetres.
    assert np.linalg.norm(found[:3, :3] @ at_m + found[:3, 3] - at_m) < 3e-3
    assert "The mesh is shifted by" in out
