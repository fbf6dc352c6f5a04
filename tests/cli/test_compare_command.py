"""``clradar compare``."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID

import clradar
from clradar.cli.comparison import figure_labels
from measurement_io import open_capture, open_volume, save_recording, save_volume

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
    raw = [replace(other, meta={"frame": i}) for i in range(2)]
    save_recording("both", raw, emptyfiltered=[replace(capture, meta={"frame": 1})])

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


def test_compare_names_what_is_missing(cli):
    """Two balls were measured, the brighter one is not in the simulation."""
    grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.03, 0.03), (0.28, 0.32), 2e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    near, far = (
        np.exp(-((x - x_m) ** 2 + y**2) / radius_m**2 - ((z - 0.3) / 8e-3) ** 2)
        for x_m, radius_m in ((-0.024, 4e-3), (0.016, 9e-3))
    )
    save_volume("measured.h5", clradar.Volume(near + 0.75 * far, grid))
    save_volume("ball.h5", clradar.Volume(far, grid))
    outcome = cli.ok("compare measured.h5 ball.h5 -o c.png --json c.json --report c.html")
    remark = "missing from the simulation: the brightest object, at (-24, 0, 300) mm with 26 % of"
    assert f"ball: {remark}" in outcome.out
    assert outcome.err.count("clradar: warning: ") == 1
    assert "an overlap of 0.89 is misleading here" in outcome.err
    (simulated,) = json.loads(Path("c.json").read_text())["simulated"]
    assert simulated["metrics"]["remarks"][0].startswith(remark)
    assert simulated["metrics"]["missing"][0]["level_db"] == 0.0
    page = Path("c.html").read_text(encoding="utf-8")
    assert f'<span class="name">ball</span>: {remark}' in page


def simulated(low: float, high: float) -> dict[str, Any]:
    return {"capture": {"scene": {"alpha_min": low, "alpha_max": high}}}


PALM = {"scene": {"materials": [{"name": "palm"}, {"name": "skin"}], "alpha_min": 0.5}}


@pytest.mark.parametrize(
    ("names", "metas", "labels"),
    [
        (
            "a/1.h5 b/2.h5",
            [simulated(0, 0), simulated(0.3, 0.3)],
            [f"{ALPHA} = 0", f"{ALPHA} = 0.3"],
        ),
        ("a/1.h5 b/2.h5", [simulated(0.3, 0.3), simulated(0.3, 0.3)], ["1", "2"]),
        ("a/1.h5 b/2.h5", [simulated(0, 1), {}], ["1", "2"]),
        ("a/1.h5 b/2.h5", [PALM, {}], ["palm and skin", "2"]),
        ("a/x.h5 b/x.h5", [simulated(0, 1), {}], ["a/x.h5", "b/x.h5"]),
    ],
)
def test_labels(names, metas, labels):
    assert figure_labels([Path(name) for name in names.split()], metas) == labels
