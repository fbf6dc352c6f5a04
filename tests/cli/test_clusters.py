"""Images of several captures: clusters whose Tx are measured with their own Rx only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import two_devices
from command_line import Run, one_error_line
from nightly import nightly

import clradar
from clradar.arrays import read_clusters
from clradar.cli.commands import simulate
from clradar.cli.commands.simulate import ClusterSteps, Item
from clradar.errors import ModelError
from measurement_io import open_capture, open_volume

RULES = """
pairs = "cluster"
[[tx]]
line = { first_m = [-0.03, 0, 0], last_m = [0.03, 0, 0], n = 5 }
[[rx]]
line = { first_m = [0, -0.03, 0], last_m = [0, 0.03, 0], n = 6 }
[[pose]]
line = { first_m = [-0.1, 0, 0], last_m = [0.1, 0, 0], n = 2 }
[[pose]]
points_m = [[0, 0.1, 0]]
rotation_deg = [10, 0, 0]
"""
BAND = clradar.Waveform.sfcw(76e9, 80e9, 12)
GRID = clradar.VoxelGrid.from_extent((-0.02, 0.04), (-0.03, 0.02), (0.27, 0.33), 2.5e-3)
POINTS_M = [[0.01, 0, 0.3], [0, -0.01, 0.31], [0.02, 0.01, 0.29]]


@pytest.fixture
def radar(tmp_path: Path) -> Path:
    path = tmp_path / "wall.toml"
    path.write_text(RULES, encoding="utf-8")
    return path


def test_the_image_is_the_sum_over_the_pairs_of_all_clusters(radar: Path) -> None:
    """That of one array of all antennas, whose other pairs are zero, over their share of pairs."""
    clusters = read_clusters(radar)
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
    assert len(got.meta["capture"]) == 3
    assert got.scale is None
    (alone,) = (clradar.backproject([captures[0]], GRID),)
    single = clradar.backproject(captures[0], GRID, check_grid=False)
    np.testing.assert_array_equal(alone.data, single.data)
    with pytest.raises(ModelError, match="at least one capture"):
        clradar.backproject([], GRID)


@pytest.mark.parametrize(("estimator", "tolerance"), [("expected", 1e-4), ("physical", 1e-3)])
def test_a_cluster_sees_at_its_pose_what_it_sees_in_its_own_frame(
    radar: Path, estimator: str, tolerance: float
) -> None:
    """Balls of which one hides a part of the other: only coordinates are rounded elsewhere."""
    pose = trimesh.transformations.rotation_matrix(np.radians(10), [1, 0, 0])
    pose[:3, 3] = [0, 0.1, 0]
    balls = [trimesh.creation.icosphere(subdivisions=3, radius=0.01) for _ in range(2)]
    balls[0].apply_translation([0.002, 0, 0.25])
    balls[1].apply_translation([0.008, 0.003, 0.3])
    own = clradar.Scene.combine(clradar.Scene.from_mesh(ball) for ball in balls)
    placed = read_clusters(radar)[2]
    alone = clradar.AntennaArray(
        *((side - pose[:3, 3]) @ pose[:3, :3] for side in (placed.tx_m, placed.rx_m))
    )
    np.testing.assert_allclose(alone.tx_m[:, 1:], 0, atol=1e-12)
    settings = {"estimator": estimator, "samples_per_mm2": 4.0}
    want = clradar.simulate(own, alone, BAND, **settings).data
    got = clradar.simulate(own.transformed(pose), placed, BAND, **settings).data
    assert np.sqrt(np.mean(np.abs(want) ** 2)) > 0
    error = np.sqrt(np.mean(np.abs(got - want) ** 2) / np.mean(np.abs(want) ** 2))
    assert error < tolerance, error


@pytest.fixture
def command(radar: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`clradar simulate` of a ball by clusters, but for the folder."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")  # files of equal bytes
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.015)
    ball.apply_translation([0.01, 0, 0.3]).export(radar.parent / "ball.ply")
    words = ["simulate", radar.parent / "ball.ply", "--array", radar, "--band", "76:80:12"]
    return [str(word) for word in (*words, "--estimator", "expected")]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


NAMES = ["cluster_001.h5", "cluster_002.h5", "cluster_003.h5", "settings.json"]


@pytest.mark.usefixtures("quickly")
def test_from_the_simulation_to_one_image_on_the_command_line(
    run: Run, tmp_path: Path, radar: Path, command: list[str]
) -> None:
    made = tmp_path / "made"
    outcome = run(*command, "-o", made)
    assert outcome.status == 0, outcome.err
    assert sorted(contents(made)) == NAMES
    files = sorted(made.glob("cluster_*.h5"))
    captures = [open_capture(path) for path in files]
    scene = clradar.Scene.from_mesh(tmp_path / "ball.ply")
    again = clradar.simulate(scene, read_clusters(radar)[1], BAND, estimator="expected")
    np.testing.assert_array_equal(captures[1].data, again.data)
    volume = tmp_path / "volume.h5"
    grid = ["--x-mm", "-20:40:2.5", "--y-mm", "-30:20:2.5", "--z-mm", "270:330:2.5"]
    outcome = run("image", *files, "-o", volume, "--png", tmp_path / "image.png", *grid)
    assert outcome.status == 0, outcome.err
    want = clradar.backproject(captures, GRID)
    np.testing.assert_array_equal(open_volume(volume).data, want.data)
    outcome = run("image", files[0], volume, "-o", tmp_path / "no.h5", *grid)
    assert outcome.status == 2
    assert "expected captures, got the volume" in outcome.err
    outcome = run("demo", "-o", tmp_path / "demo", "--array", radar)
    assert "3 clusters, which simulate and image take" in outcome.err


@pytest.mark.parametrize("how", [["--workers", "2"], *nightly([["--device", "all"]])])
def test_workers_and_devices_make_the_same_files(
    run: Run, tmp_path: Path, command: list[str], how: list[str]
) -> None:
    pytest.importorskip("distributed")
    here, there = tmp_path / "here", tmp_path / "there"
    assert run(*command, "-o", here).status == 0
    if "--workers" in how:
        assert run(*command, "-o", there, *how).status == 0
    else:  # in a process of its own, which sees the CPU as two devices
        done = subprocess.run(
            [sys.executable, "-m", "clradar", *command, "-o", there, *how],
            env={**os.environ, **two_devices.ENVIRONMENT}, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert sorted(contents(here)) == NAMES
    assert contents(there) == contents(here)


def test_a_mesh_that_changes_between_clusters_is_refused(
    run: Run, tmp_path: Path, command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = ClusterSteps.run

    def changing(self: ClusterSteps, item: Item, progress: Any = None) -> str:
        ball = trimesh.creation.icosphere(subdivisions=1, radius=0.015)
        ball.apply_translation([0.01, 0, 0.3]).export(tmp_path / "ball.ply")
        simulate._scenes.clear()  # as in another process
        return one(self, item, progress)

    monkeypatch.setattr(ClusterSteps, "run", changing)
    outcome = run(*command, "-o", tmp_path / "made")
    one_error_line(outcome, "ball.ply: changed while clusters were simulated")
    assert not (tmp_path / "made").exists()
