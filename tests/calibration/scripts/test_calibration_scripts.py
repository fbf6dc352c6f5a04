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
from shapes import plate

import clradar
from calibration import FlatPlate, correct, estimate_channels, range_gate, subtract_background
from measurement_io import open_capture, open_channels, save_capture, save_channels

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


@pytest.fixture
def files(tmp_path):
    """Plates 30 cm away by two instruments, and a rough one with its mesh, which is in place."""
    for i, name in enumerate(("plate", "other")):
        truth = instrument(i, SMALL, n_freq=16)
        save_capture(tmp_path / f"{name}.h5", truth.record_target(FlatPlate(0.3)))
    known = estimate_channels(open_capture(tmp_path / "plate.h5"), FlatPlate(0.3))
    save_channels(tmp_path / "known.h5", known)
    scene = clradar.Scene(*plate(0.06, 0.3), 0.5)
    trimesh.Trimesh(scene.vertices_m, scene.faces, process=False).export(tmp_path / "plate.ply")
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
    rays = {"samples_per_mm2": 5.0, "estimator": "stochastic", "device": "pocl"}
    save_capture(tmp_path / "rough.h5", clradar.simulate(scene, HALF, waveform, **rays))
    (tmp_path / "transform.json").write_text(json.dumps({"transform": np.eye(4).tolist()}))


def cleaned(folder):
    """What is in the file, and what the library gives."""
    hand, empty = (open_capture(folder / f"{name}.h5") for name in ("plate", "other"))
    found = subtract_background(hand, empty, scaling="common")
    gated = range_gate(found, near_m=0.08, far_m=0.14)
    expected = correct(gated, open_channels(folder / "known.h5")).data
    return open_capture(folder / "clean.h5").data, expected


def estimated(folder):
    found, known = (open_channels(folder / f"{name}.h5") for name in ("channels", "known"))
    return found.response.tx_gain, known.response.tx_gain


def aligned(folder):
    """To some millimetres, the bias of a fit without correction."""
    found = np.array(json.loads((folder / "found.json").read_text())["transform"])
    at_m = np.array([0.0, 0.0, 0.3])
    moved_m = np.linalg.norm(found[:3, :3] @ at_m + found[:3, 3] - at_m)
    return moved_m < 3e-3, True


@pytest.mark.parametrize(
    ("line", "said", "result"),
    [
        (
            "background plate.h5 --empty other.h5 --gate-mm 80 140 --channels known.h5 -o clean.h5",
            "",
            cleaned,
        ),
        ("channels plate.h5 -o channels.h5 --distance-mm 300", "residual", estimated),
        (
            "sweep rough.h5 plate.ply -o sweep.png --transform transform.json --alphas 3 "
            "--samples-per-mm2 0.5 --seeds 2",
            "alpha: 0.",
            lambda folder: ((folder / "sweep.png").read_bytes()[:4], b"\x89PNG"),
        ),
        ("align rough.h5 plate.ply -o found.json --quick", "The mesh is shifted by", aligned),
    ],
    ids=["background", "channels", "sweep", "align"],
)
def test_a_script_does_what_the_library_does(start, files, tmp_path, line, said, result):
    fine, out, err = start(*line.split())
    assert fine, err
    assert said in out
    found, expected = result(tmp_path)
    np.testing.assert_array_equal(found, expected)


def test_an_error_is_one_line(start, files):
    fine, _, err = start("background", "plate.h5", "--empty", "none.h5", "-o", "clean.h5")
    assert not fine
    assert err.startswith("background.py: error: ")
    assert len(err.splitlines()) == 1
