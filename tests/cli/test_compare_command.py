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
