"""``clradar compare``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID, Run, one_error_line

import clradar
from clradar.cli import comparison
from measurement_io import open_capture, open_volume, save_recording, save_volume


def test_compare_writes_figure_and_metrics(run: Run, made: Path, tmp_path: Path) -> None:
    volume = open_volume(made / "volume.h5")
    rng = np.random.default_rng(1)
    size = float(np.abs(volume.data).max())
    noise = size * 0.05 * (rng.standard_normal((*volume.data.shape, 2)) @ [1, 1j])
    other = clradar.Volume(volume.data + noise, volume.grid, {"kind": "another program's"})
    save_volume(tmp_path / "other.h5", other)
    png, record = tmp_path / "c.png", tmp_path / "c.json"
    # The capture is imaged on the grid of the volume, so it is the measured image itself.
    outcome = run("compare", made / "volume.h5", made / "sim.h5", tmp_path / "other.h5",
                  "-o", png, "--json", record)  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert png.read_bytes().startswith(b"\x89PNG")
    saved = json.loads(record.read_text())
    assert [s["label"] for s in saved["simulated"]] == [
        "\N{GREEK SMALL LETTER ALPHA} = 0.4",
        "other",
    ]
    first, second = (s["metrics"] for s in saved["simulated"])
    assert first == clradar.compare(volume, volume).to_dict()
    assert first["db_correlation"] == 1.0
    assert second == clradar.compare(volume, other).to_dict()
    assert {i["file"] for i in saved["inputs"]} == {"volume.h5", "sim.h5", "other.h5"}
    rows = [line for line in outcome.out.splitlines() if line.startswith("other")]
    assert f"{second['db_correlation']:.3f}" in rows[0]
    assert f"{1e3 * second['depth_rmse_m']:.2f}" in rows[0]


def test_compare_takes_what_the_help_offers_and_names_a_mesh(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = tmp_path / "c.json"
    command = ("compare", made / "volume.h5", made / "sim.h5", "--json", record)
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    for more in ((), ("--device", "all", "--force")):
        assert run(*command, *more).status == 0
    outcome = run("compare", made / "volume.h5", made / "hand.ply", "--json", record, "--force")
    one_error_line(outcome, "hand.ply: expected a capture, got a mesh", "clradar simulate")


def test_compare_chooses_from_a_recording(run: Run, made: Path, tmp_path: Path) -> None:
    capture = open_capture(made / "sim.h5")
    other = clradar.Capture(np.roll(capture.data, 9, axis=0), capture.array, capture.waveform)
    recording = tmp_path / "recording"
    raw = [replace(other, meta={"frame": i}) for i in range(2)]
    save_recording(recording, raw, emptyfiltered=[replace(capture, meta={"frame": 1})])
    record = tmp_path / "c.json"

    def correlation(*options: str) -> float:
        outcome = run("compare", recording, made / "sim.h5", "--json", record, "--force", *GRID,
                      *options)  # fmt: skip
        assert outcome.status == 0, outcome.err
        return json.loads(record.read_text())["simulated"][0]["metrics"]["db_correlation"]

    assert correlation("--frame", "1", "--variant", "emptyfiltered") == 1.0
    inputs = json.loads(record.read_text())["inputs"]
    assert [i["file"] for i in inputs] == ["000001_emptyfiltered.npy", "sim.h5"]
    assert correlation("--frame", "1") < 0.9
    assert correlation() < 0.9
    for name in ("volume.h5", "sim.h5"):
        outcome = run("compare", made / name, made / "sim.h5", "--frame", "0")
        one_error_line(outcome, name, "a folder of frames")


def test_compare_names_what_is_missing(run: Run, tmp_path: Path) -> None:
    """Two balls were measured, the brighter one is not in the simulation."""
    grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.03, 0.03), (0.28, 0.32), 2e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    near, far = (
        np.exp(-((x - x_m) ** 2 + y**2) / radius_m**2 - ((z - 0.3) / 8e-3) ** 2)
        for x_m, radius_m in ((-0.024, 4e-3), (0.016, 9e-3))
    )
    save_volume(tmp_path / "measured.h5", clradar.Volume(near + 0.75 * far, grid))
    save_volume(tmp_path / "ball.h5", clradar.Volume(far, grid))
    files = ("-o", tmp_path / "c.png", "--json", tmp_path / "c.json", "--report",
             tmp_path / "c.html")  # fmt: skip
    outcome = run("compare", tmp_path / "measured.h5", tmp_path / "ball.h5", *files)
    assert outcome.status == 0, outcome.err
    remark = "missing from the simulation: the brightest object, at (-24, 0, 300) mm with 26 % of"
    assert f"ball: {remark}" in outcome.out
    assert outcome.err.count("clradar: warning: ") == 1
    assert "an overlap of 0.89 is misleading here" in outcome.err
    (simulated,) = json.loads((tmp_path / "c.json").read_text())["simulated"]
    assert simulated["metrics"]["remarks"][0].startswith(remark)
    assert simulated["metrics"]["missing"][0]["level_db"] == 0.0
    assert f'<span class="name">ball</span>: {remark}' in (tmp_path / "c.html").read_text(
        encoding="utf-8"
    )


def test_labels() -> None:
    def simulated(low: float, high: float) -> dict[str, Any]:
        return {"capture": {"scene": {"alpha_min": low, "alpha_max": high}}}

    alpha = "\N{GREEK SMALL LETTER ALPHA}"
    paths = [Path("a/one.h5"), Path("b/two.h5")]
    metas = [simulated(0.0, 0.0), simulated(0.3, 0.3)]
    assert comparison.figure_labels(paths, metas) == [f"{alpha} = 0", f"{alpha} = 0.3"]
    metas = [simulated(0.3, 0.3), simulated(0.3, 0.3)]
    assert comparison.figure_labels(paths, metas) == ["one", "two"]
    metas = [simulated(0.0, 1.0), {}]
    assert comparison.figure_labels(paths, metas) == ["one", "two"]
    palm = {"scene": {"materials": [{"name": "palm"}, {"name": "skin"}], "alpha_min": 0.5}}
    assert comparison.figure_labels(paths, [palm, {}]) == ["palm and skin", "two"]
    same = [Path("a/x.h5"), Path("b/x.h5")]
    assert comparison.figure_labels(same, metas) == ["a/x.h5", "b/x.h5"]
