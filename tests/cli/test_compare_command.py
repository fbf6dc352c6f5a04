"""``clradar compare``, and ``clradar demo``, the whole chain at a small size."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID
from quick_figures import draw_quickly, seek_nothing_else

import clradar
from clradar.arrays.array_file import array_text
from clradar.cli.commands import simulate
from clradar.cli.images import figure_labels
from clradar.cli.options.measured import RadarOptions
from clradar.hand import hand_mesh
from measurement_io import check_file, open_capture, open_volume, save_recording, save_volume

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"


def test_compare_writes_figure_and_metrics(cli, place):
    volume = open_volume("volume.h5")
    rng = np.random.default_rng(1)
    size = float(np.abs(volume.data).max())
    noise = size * 0.05 * (rng.standard_normal((*volume.data.shape, 2)) @ [1, 1j])
    other = clradar.Volume(volume.data + noise, volume.grid, {"kind": "another program's"})
    save_volume("other.h5", other)
    # The capture is imaged on the grid of the volume, so it is the measured image itself.
    outcome = cli.ok("compare volume.h5 sim.h5 other.h5 -o c.png --json c.json")
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")
    saved = json.loads(Path("c.json").read_text())
    assert [s["label"] for s in saved["simulated"]] == [f"{ALPHA} = 0.4", "other"]
    first, second = (s["metrics"] for s in saved["simulated"])
    assert first == clradar.compare(volume, volume).to_dict()
    assert first["db_correlation"] == 1.0
    assert second == clradar.compare(volume, other).to_dict()
    assert {i["file"] for i in saved["inputs"]} == {"volume.h5", "sim.h5", "other.h5"}
    (row,) = [line for line in outcome.out.splitlines() if line.startswith("other")]
    assert f"{second['db_correlation']:.3f}" in row
    assert f"{1e3 * second['depth_rmse_m']:.2f}" in row
    cli.fails(
        "compare volume.h5 hand.ply", "hand.ply: expected a capture, got a mesh", "clradar simulate"
    )


def test_compare_chooses_from_a_recording(cli, place, monkeypatch):
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    capture = open_capture("sim.h5")
    other = clradar.Capture(np.roll(capture.data, 9, axis=0), capture.array, capture.waveform)
    radar = save_recording("both", [other, other])
    (frame,) = save_recording("filtered", [capture]).rglob("*.npy")
    frame.rename(radar / "calibrated_data/000001_emptyfiltered.npy")

    def correlation(options: str) -> float:
        cli.ok(f"compare both sim.h5 --json c.json --force {GRID} {options}")
        record = json.loads(Path("c.json").read_text())
        assert record["inputs"][1]["file"] == "sim.h5"
        return record["simulated"][0]["metrics"]["db_correlation"]

    assert correlation("--frame 1 --variant emptyfiltered") == 1.0
    inputs = json.loads(Path("c.json").read_text())["inputs"]
    assert inputs[0]["file"] == "000001_emptyfiltered.npy"
    assert correlation("--frame 1") < 0.9
    assert correlation("") < 0.9
    cli.fails("compare volume.h5 sim.h5 --frame 0", "volume.h5", "a folder of frames")


def simulated(low: float, high: float) -> dict[str, Any]:
    return {"capture": {"scene": {"alpha_min": low, "alpha_max": high}}}


PALM = {"scene": {"materials": [{"name": "palm"}, {"name": "skin"}], "alpha_min": 0.5}}


@pytest.mark.parametrize(
    ("names", "metas", "labels"),
    [
        ("a/1.h5 b/2.h5", [simulated(0.3, 0.3), simulated(0.3, 0.3)], ["1", "2"]),
        ("a/1.h5 b/2.h5", [PALM, simulated(0, 1)], ["palm and skin", "2"]),
        ("a/x.h5 b/x.h5", [simulated(0, 1), {}], ["a/x.h5", "b/x.h5"]),
    ],
)
def test_labels(names, metas, labels):
    assert figure_labels([Path(name) for name in names.split()], metas) == labels


COLUMNS = ("alpha_0", "alpha_0.5", "alpha_1", "physical")
RAYS = {"samples_per_mm2": 0.5, "rays_per_sample": 2}
COARSE = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)


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
        simulate.run_demo(small, radar, COARSE, clradar.open_device("pocl"), **RAYS)
    images = {f"{n}_volume.h5" for n in ("measurement", *COLUMNS)}
    captures = {f"{n}.h5" for n in COLUMNS}
    rest = {"hand_f.ply", "measurement", "comparison.png", "metrics.json"}
    assert {p.name for p in small.iterdir()} == images | captures | rest
    assert all(check_file(small / name).ok for name in (*images, *captures, "measurement"))
    assert all(open_volume(small / name).grid.same_voxels(COARSE) for name in images)
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

    def run_demo(folder: Path, *given: Any) -> None:
        calls.append(given)
        (folder / str(len(calls))).touch()

    monkeypatch.setattr(simulate, "run_demo", run_demo)
    assert f"{voxels} voxels" in cli.ok(line).out
    ((_, grid, _),) = calls
    assert grid.spacing_m[0] == pytest.approx(spacing_m)
    cli.fails(line, "demo: holds files already")
    cli.ok(f"{line} --force")
    assert {path.name for path in Path("demo").iterdir()} == {"1", "2"}
