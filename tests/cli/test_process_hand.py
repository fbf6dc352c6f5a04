"""``clradar process --fit-hand``: folders that resume, tables, figures.

The fits are made up.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID, Run, one_error_line
from made_up_frames import MOVEMENT, TIMES_S, made_up_fit_hands
from quick_figures import Levels, no_figure, seek_no_lobes

import calibration
import clradar.plot
from calibration.hand_fit.starts import read_start
from calibration.registration.mesh_pose import depth_for_mesh
from clradar.cli.frames import RECORDS
from clradar.cli.recordings import MOVEMENT as FIGURE
from clradar.cli.recordings import SHEET
from clradar.hand import read_pose
from clradar.plot import save_figure
from measurement_io import open_capture, save_recording

FIT = ("process", "--fit-hand", "F", "--fit-shape", *GRID)
N = 4


@pytest.fixture(scope="module")
def recording(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of four frames, one of them without an echo."""
    folder = tmp_path_factory.mktemp("recordings")
    whole = open_capture(made / "sim.h5")
    few = slice(None, None, 6)
    array = clradar.AntennaArray(whole.array.tx_m[few], whole.array.rx_m[few])
    capture = replace(whole, data=whole.data[few, few], array=array)
    frames = [capture] * N
    frames[1] = replace(capture, data=np.zeros_like(capture.data))
    stamps_us = [1 + 125_000 * i for i in range(N)]
    save_recording(folder / "one", frames, timestamps_us=stamps_us)
    return folder / "one"


class _Numbers(list[int]):
    """Numbers of images, for fits that know the truth; the images are looked at."""

    def __init__(self, images: Any) -> None:
        super().__init__(images.frame_numbers)
        self.frame_numbers = images.frame_numbers
        self.time_us = images.time_us
        self._images = images

    def __getitem__(self, index: Any) -> Any:
        depth_for_mesh(self._images[index], None)  # raises where nothing is seen
        return self.frame_numbers[index]


def fits(images: Any, **settings: Any) -> Iterator[Any]:
    return made_up_fit_hands(_Numbers(images), **settings)


@pytest.fixture(autouse=True)
def _made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "fit_hands", fits)
    monkeypatch.setattr(clradar.plot, "save_figure", no_figure)
    monkeypatch.setattr("clradar.plot.frames.FramePictures", Levels)
    seek_no_lobes(monkeypatch)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_folder_with_frames_table_and_figures(
    run: Run, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clradar.plot, "save_figure", save_figure)
    whole, folder = tmp_path / "out", tmp_path / "out" / "hand"
    outcome = run(*FIT, recording, "-o", whole)
    assert outcome.status == 0, outcome.err
    # 16 frequencies may be few for this grid: said once at most, not of every frame.
    assert outcome.err.count("warning") == outcome.err.count("unambiguous") <= 1
    assert {path.name for path in folder.iterdir()} == {FIGURE, SHEET, RECORDS}
    assert "4 frames, 1 followed, 2 searched, 1 without a hand" in outcome.out
    assert "the misfit per cell is 1.30" in outcome.out
    frame = json.loads((folder / "frames/000003.json").read_text())
    assert (frame["how"], frame["start"]) == ("followed", "frame 2")
    assert frame["time_s"] == pytest.approx(0.375001)
    # A pose file, a transform and a start for other commands.
    assert (
        read_pose(folder / "frames/000003.toml").joints.keys()
        == MOVEMENT.pose(TIMES_S[3]).joints.keys()
    )
    start = read_start(folder / "frames/000003.json")
    assert np.array_equal(start.transform, MOVEMENT.transform(TIMES_S[3]))
    fitted = [one["hand"] for one in json.loads((whole / "recording.json").read_text())["frames"]]
    assert [one["how"] for one in fitted] == ["searched", "nothing found", "searched", "followed"]
    assert fitted[3] == frame
    for name in (FIGURE, SHEET):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    overall = list(csv.DictReader((whole / "frames.csv").read_text().splitlines()))
    tip_mm = [float(overall[3][f"hand index tip {axis} mm"]) for axis in "xyz"]
    np.testing.assert_allclose(tip_mm, 1e3 * MOVEMENT.joints_m(TIMES_S[3])[9], rtol=0, atol=5.1e-4)
    assert overall[1]["hand index tip x mm"] == ""  # nothing is seen there
    before = contents(whole)
    again = run(*FIT, recording, "-o", whole)
    assert again.status == 0, again.err
    assert contents(whole) == before


def test_an_interrupted_run_goes_on_where_it_was(
    run: Run, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It gives every byte of an uninterrupted one, though the last frame was half written."""
    command = (*FIT, recording, "-o")
    assert run(*command, tmp_path / "whole").status == 0

    def interrupted(*arguments: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in fits(*arguments, **settings):
            if fit.frame == 2:
                raise KeyboardInterrupt
            yield fit, track

    cut = tmp_path / "cut"
    monkeypatch.setattr(calibration, "fit_hands", interrupted)
    assert run(*command, cut).status == 130
    assert not (cut / "recording.json").exists()
    (cut / "hand/frames/000002.json").write_text("{}")
    (cut / "hand/frames/.000003.json.0123.tmp").touch()
    tried: list[int] = []

    def resumed(*arguments: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in fits(*arguments, **settings):
            tried.append(fit.frame)
            yield fit, track

    monkeypatch.setattr(calibration, "fit_hands", resumed)
    one_error_line(run(*command, cut, "--seed", "1"), "seed 0, now 1")
    outcome = run(*command, cut)
    assert outcome.status == 0, outcome.err
    assert tried == [2, 3]
    assert contents(cut) == contents(tmp_path / "whole")
