"""``clradar export``: what goes where."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import Run, one_error_line

import clradar
from measurement_io import save_capture, save_volume


@pytest.fixture
def volume(tmp_path: Path) -> Path:
    grid = clradar.VoxelGrid([-0.1, 0.2, 0.3], [1e-3, 2e-3, 5e-3], (5, 3, 4))
    data = np.arange(60).reshape(grid.shape) + 1j
    save_volume(tmp_path / "volume.h5", clradar.Volume(data, grid, {"method": "exact"}))
    return tmp_path / "volume.h5"


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    array = clradar.AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    made = clradar.Capture([[[1, 2j]]], array, clradar.Waveform([76e9, 77e9]))
    save_capture(tmp_path / "capture.h5", made)
    return tmp_path / "capture.h5"


def test_a_volume_and_its_depth_map(run: Run, tmp_path: Path, volume: Path) -> None:
    done = run("export", volume, "-o", tmp_path / "v.npz")
    assert done.out == f"{tmp_path / 'v.npz'}: Volume, 4 x 3 x 5\n"
    with np.load(tmp_path / "v.npz") as file:
        assert file["data"][3, 2, 4] == 59 + 1j
        provenance = json.loads(str(file["provenance"]))
    assert (provenance["method"], provenance["command"]) == ("exact", "export")
    assert run("export", volume, "-o", tmp_path / "v.vti").status == 0
    done = run("export", volume, "--dynamic-range-db", "1", "-o", tmp_path / "v.ply")
    assert done.out.endswith("v.ply: DepthMap, 3 x 5\n")
    # 20 log10(45 / 59) = -2.4 dB and 52 / 59 = -1.1 dB: seven pixels are brighter than -1 dB.
    assert len(trimesh.load(tmp_path / "v.ply", process=False).vertices) == 7
    assert run("export", volume, "--depth-map", "-o", tmp_path / "d.npz").status == 0
    with np.load(tmp_path / "d.npz") as read:
        assert read["depth_m"].shape == (3, 5)
        assert float(read["depth_m"][0, 0]) == 0.315


def test_a_capture(run: Run, tmp_path: Path, capture: Path) -> None:
    done = run("export", capture, "-o", tmp_path / "c.mat")
    assert done.out == f"{tmp_path / 'c.mat'}: Capture, 1 x 1 x 2\n"
    one_error_line(run("export", capture, "-o", tmp_path / "c.vti"), "c.vti", "clradar image")
    one_error_line(run("export", capture, "-o", tmp_path / "c.ply"), "c.ply", "clradar image")
    refused = run("export", capture, "--depth-map", "-o", tmp_path / "c.npz")
    assert refused.status == 2
    assert "expected a volume" in " ".join(refused.err.split())


def test_names_that_are_refused(run: Run, tmp_path: Path, volume: Path) -> None:
    one_error_line(run("export", volume, "-o", tmp_path / "v.csv"), ".vti, .ply", "'.csv'")
    nowhere = tmp_path / "nowhere" / "v.npz"
    one_error_line(run("export", volume, "-o", nowhere), "an existing folder")
