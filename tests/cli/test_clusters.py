"""Images of several captures: clusters whose Tx are measured with their own Rx only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import Run

import clradar
from clradar.arrays import read_clusters
from clradar.errors import ModelError
from clradar.measurement_io import open_capture, open_volume

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


def test_from_the_simulation_to_one_image_on_the_command_line(
    run: Run, tmp_path: Path, radar: Path
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.015)
    ball.apply_translation([0.01, 0, 0.3]).export(tmp_path / "ball.ply")
    made = tmp_path / "made"
    words = ["--array", radar, "--band", "76:80:12", "--estimator", "expected"]
    outcome = run("simulate", tmp_path / "ball.ply", "-o", made, *words)
    assert outcome.status == 0, outcome.err
    files = sorted(made.iterdir())
    assert [path.name for path in files] == [f"cluster_00{i}.h5" for i in (1, 2, 3)]
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
    outcome = run("simulate", tmp_path / "ball.ply", "-o", made, *words)
    assert "holds files already" in outcome.err
    outcome = run("record-hand", "flat", "-o", tmp_path / "moving", "--array", radar)
    assert "3 clusters, which simulate and image take" in outcome.err
