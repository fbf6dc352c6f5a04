"""``clradar demo``: the whole chain at a small size, and its files."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from quick_figures import draw_quickly, seek_nothing_else

import clradar
from clradar.arrays.array_file import array_text
from clradar.cli.commands import demo
from clradar.cli.options.measured import RadarOptions
from clradar.hand import hand_mesh
from measurement_io import check_file, open_capture, open_volume

COLUMNS = ("alpha_0", "alpha_0.5", "alpha_1", "physical")
RAYS = {"samples_per_mm2": 1.0, "rays_per_sample": 2}
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)


# With so few rays the wrist, which the paper's grid cuts, is as bright as the palm.
@pytest.mark.filterwarnings("ignore:the grid cuts:clradar.ClradarWarning")
def test_files_and_metrics_are_those_of_the_library(tmp_path):
    """With every sixth antenna, an eighth of the frequencies, and a coarse hand."""
    whole = clradar.arrays.qar50()
    array = clradar.AntennaArray(whole.tx_m[::6], whole.rx_m[::6])
    (tmp_path / "array.toml").write_text(array_text(array))
    radar = RadarOptions(band=(72, 82, 17), array=str(tmp_path / "array.toml"))
    small = tmp_path / "demo"
    small.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clradar.hand.hand_mesh", partial(hand_mesh, edge_length_m=4e-3))
        seek_nothing_else(patch)
        draw_quickly(patch)
        demo.run_demo(small, radar, GRID, clradar.open_device("pocl"), **RAYS)
    images = {f"{n}_volume.h5" for n in ("measurement", *COLUMNS)}
    captures = {f"{n}.h5" for n in COLUMNS}
    rest = {"hand_f.ply", "measurement", "comparison.png", "metrics.json"}
    assert {p.name for p in small.iterdir()} == images | captures | rest
    assert all(check_file(small / name).ok for name in (*images, *captures, "measurement"))
    assert all(open_volume(small / name).grid.same_voxels(GRID) for name in images)
    record = json.loads((small / "metrics.json").read_text())
    alpha = "\N{GREEK SMALL LETTER ALPHA}"
    labels = [s["label"] for s in record["simulated"]]
    assert labels == [f"{alpha} = 0", f"{alpha} = 0.5", f"{alpha} = 1", "skin and palm"]
    assert record["clradar"] == clradar.__version__
    assert record["options"]["rays"] == RAYS
    # The measurement has the same materials, but another texture: no pixel of it is predicted.
    *of_alphas, of_materials = [s["metrics"]["overlap"] for s in record["simulated"]]
    assert of_materials > max(of_alphas) + 0.2
    scene = clradar.Scene.from_mesh(small / "hand_f.ply", alpha=0.5)
    capture = open_capture(small / "alpha_0.5.h5")
    found = clradar.simulate(scene, capture.array, capture.waveform, **RAYS, seed=0, device="pocl")
    assert np.array_equal(found.data, capture.data)
    made_of = open_capture(small / "physical.h5").meta["scene"]["materials"]
    assert [record["name"] for record in made_of] == ["skin", "palm"]


@pytest.mark.parametrize(
    ("line", "spacing_m", "voxels"),
    [("demo", 2e-3, "101 x 101 x 41"), ("demo --full", 1e-3, "201 x 201 x 81")],
)
def test_command(cli, monkeypatch, line, spacing_m, voxels):
    calls = []
    monkeypatch.setattr(demo, "run_demo", lambda *given: calls.append(given))
    assert f"{voxels} voxels" in cli.ok(line).out
    ((folder, _, grid, _),) = calls
    assert folder == Path("demo")
    assert grid.spacing_m[0] == pytest.approx(spacing_m)
    notes = Path("demo/notes.txt")
    notes.write_text("mine")
    cli.fails(line, "demo: holds files already")
    cli.ok(f"{line} --force")
    assert notes.read_text() == "mine"
