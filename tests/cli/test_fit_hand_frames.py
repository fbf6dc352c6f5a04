"""``clradar fit-hand --frames``: folders that resume, tables, figures, workers.

The fits are made up.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import dask
import made_up_frames
import numpy as np
import pytest
from command_line import GRID, Run, one_error_line
from made_up_frames import MOVEMENT, made_up_fit_hands, no_figure

import calibration
import clradar.plot
from calibration.hand_fit.starts import read_start
from calibration.registration.mesh_pose import depth_for_mesh
from clradar.cli.hand_sequence import FIGURE, OWN_NAMES, RESULT, SHEET, TABLE
from clradar.hand import read_pose
from clradar.model import DepthMap
from clradar.plot import save_figure
from measurement_io import open_capture, save_recording

FIT = ("fit-hand", "--pose", "F", "--fit-shape", *GRID)
N = 4


@pytest.fixture(scope="module")
def recordings(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two recordings of four frames, one of them without an echo."""
    folder = tmp_path_factory.mktemp("recordings")
    capture = open_capture(made / "sim.h5")
    frames = [capture] * N
    frames[1] = replace(capture, data=np.zeros_like(capture.data))
    for name in ("one", "other"):
        stamps_us = [1 + 125_000 * i for i in range(N)]
        save_recording(folder / name, frames, timestamps_us=stamps_us)
    return folder


@pytest.fixture(autouse=True)
def _made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "fit_hands", made_up_fit_hands)
    monkeypatch.setattr(clradar.plot, "save_figure", no_figure)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_folder_with_frames_table_and_figures(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clradar.plot, "save_figure", save_figure)
    folder = tmp_path / "fit"
    outcome = run(*FIT, recordings / "one", "--frames", "all", "-o", folder)
    assert outcome.status == 0, outcome.err
    # 16 frequencies may be few for this grid: said once at most, not of every frame.
    assert outcome.err.count("warning") == outcome.err.count("unambiguous") <= 1
    assert {path.name for path in folder.iterdir()} == set(OWN_NAMES) - {"work"}
    assert "4 frames, 2 followed, 2 searched" in outcome.out
    assert "the misfit per cell is 1.30" in outcome.out
    frame = json.loads((folder / "frames/000003.json").read_text())
    assert (frame["how"], frame["start"]) == ("followed", "frame 2")
    assert frame["time_s"] == pytest.approx(0.375001)
    # A pose file, a transform and a start for other commands.
    assert read_pose(folder / "frames/000003.toml").joints.keys() == MOVEMENT.poses[3].joints.keys()
    start = read_start(folder / "frames/000003.json")
    assert np.array_equal(start.transform, MOVEMENT.transforms[3])
    rows = list(csv.DictReader((folder / TABLE).read_text().splitlines()))
    assert [row["how"] for row in rows] == ["searched", "followed", "searched", "followed"]
    tip_mm = [float(rows[3][f"index tip {axis} mm"]) for axis in "xyz"]
    np.testing.assert_allclose(tip_mm, 1e3 * MOVEMENT.joints_m(3)[9], rtol=0, atol=5.1e-4)
    record = json.loads((folder / RESULT).read_text())
    assert record["frames"][3] == frame
    assert record["options"]["frames"] == "all"
    for name in (FIGURE, SHEET):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    before = contents(folder)
    again = run(*FIT, recordings / "one", "--frames", "all", "-o", folder)
    assert again.status == 0, again.err
    assert contents(folder) == before


def test_an_interrupted_run_goes_on_where_it_was(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It gives every byte of an uninterrupted one, though the last frame was half written."""
    command = (*FIT, recordings / "one", "--frames", "all", "-o")
    assert run(*command, tmp_path / "whole").status == 0

    def interrupted(*arguments: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in made_up_fit_hands(*arguments, **settings):
            if fit.frame == 2:
                raise KeyboardInterrupt
            yield fit, track

    cut = tmp_path / "cut"
    monkeypatch.setattr(calibration, "fit_hands", interrupted)
    assert run(*command, cut).status == 130
    assert not (cut / RESULT).exists()
    (cut / "frames/000002.json").write_text("{}")
    (cut / "frames/.000003.json.0123.tmp").touch()
    tried: list[int] = []

    def resumed(*arguments: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in made_up_fit_hands(*arguments, **settings):
            tried.append(fit.frame)
            yield fit, track

    monkeypatch.setattr(calibration, "fit_hands", resumed)
    one_error_line(run(*command, cut, "--seed", "1"), "seed 0, now 1")
    outcome = run(*command, cut)
    assert outcome.status == 0, outcome.err
    assert tried == [2, 3]
    assert contents(cut) == contents(tmp_path / "whole")


def test_some_frames(run: Run, recordings: Path, tmp_path: Path) -> None:
    outcome = run(*FIT, recordings / "one", "--frames", "1:2", "-o", tmp_path / "fit")
    assert outcome.status == 0, outcome.err
    names = {path.name for path in (tmp_path / "fit/frames").iterdir()}
    assert names == {f"00000{i}.{kind}" for i in (1, 2) for kind in ("json", "toml")}


@pytest.mark.parametrize(
    ("options", "status", "part"),
    [
        (("--frames", "7"), 1, "0 to 3"),
        (("--frames", "a:b"), 2, "FIRST:LAST"),
        (("--frames", "all", "--frame", "1"), 2, "--frame"),
        (("--frames", "all", "--alpha", "0.3"), 2, "--alpha"),
        (("--workers", "2"), 2, "--frames"),
        (("other",), 2, "--frames"),
    ],
)
def test_what_does_not_go_together(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...], status: int, part: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(recordings)
    outcome = run(*FIT, "one", *options, "-o", tmp_path / "fit")
    assert outcome.status == status, outcome.err
    assert part in outcome.err
    assert not (tmp_path / "fit").exists()


@pytest.mark.slow
def test_recordings_on_workers_give_what_one_process_gives(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(
        "PYTHONPATH",
        os.pathsep.join([str(Path(made_up_frames.__file__).parent), os.environ["PYTHONPATH"]])
        if os.environ.get("PYTHONPATH")
        else str(Path(made_up_frames.__file__).parent),
    )
    monkeypatch.chdir(recordings)
    command = (*FIT, "one", "other", "--frames", "0,2", "-o")
    assert run(*command, tmp_path / "here").status == 0
    with dask.config.set({"distributed.worker.preload": ["made_up_frames"]}):
        outcome = run(*command, tmp_path / "workers", "--workers", "2")
    assert outcome.status == 0, outcome.err
    assert outcome.out.count("2 frames") == 2
    found = contents(tmp_path / "workers")
    assert found == contents(tmp_path / "here")
    assert {name.split(os.sep)[0] for name in found} == {"000-one", "001-other"}


def test_one_of_several_recordings_fails_alone(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(recordings)
    outcome = run(*FIT, "none", "one", "--frames", "0,1", "-o", tmp_path / "fits")
    assert outcome.status == 1
    assert "warning: none: " in outcome.err
    assert "1 of 2 recordings could not be fitted" in outcome.err
    assert (tmp_path / "fits/001-one" / RESULT).is_file()
    assert not (tmp_path / "fits/000-none").exists()


class _Numbers(list[int]):
    """Numbers of images, for fits that know the truth; the images are looked at."""

    def __init__(self, images: Any, seen: dict[int, DepthMap]) -> None:
        super().__init__(images.frame_numbers)
        self.frame_numbers = images.frame_numbers
        self._images, self._seen = images, seen

    def time_us(self, index: int) -> float:  # which numbers have not
        known = getattr(self._images, "time_us", lambda i: 1 + 125_000 * i)
        return float(known(index))

    def __getitem__(self, index: Any) -> Any:
        image = depth_for_mesh(self._images[index], None)  # raises where nothing is seen
        self._seen[self.frame_numbers[index]] = image
        return self.frame_numbers[index]


def test_process_fits_what_fit_hand_fits(
    run: Run, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The images, results and times of both commands, also where `process` was interrupted."""
    seen: dict[int, DepthMap] = {}
    cut_at: int | None = None

    def watched(images: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in made_up_fit_hands(_Numbers(images, seen), **settings):
            if fit.frame == cut_at:
                raise KeyboardInterrupt
            yield fit, track

    monkeypatch.setattr(calibration, "fit_hands", watched)
    assert run(*FIT, recordings / "one", "--frames", "all", "-o", tmp_path / "fit").status == 0
    expected, seen = seen, {}
    command = ("process", recordings / "one", *GRID, "--fit-hand", "F", "--fit-shape", "-o")
    cut_at, out = 2, tmp_path / "out"
    assert run(*command, out).status == 130
    cut_at = None
    outcome = run(*command, out)
    assert outcome.status == 0, outcome.err
    assert "4 frames, 1 followed, 2 searched, 1 without a hand" in outcome.out
    assert seen.keys() == expected.keys() == {0, 2, 3}
    for number, image in expected.items():
        assert np.array_equal(image.amplitude, seen[number].amplitude)
        assert np.array_equal(image.depth_m, seen[number].depth_m, equal_nan=True)
    for name in (TABLE, "frames/000003.json", "frames/000001.json"):
        one, other = ((folder / name).read_text() for folder in (tmp_path / "fit", out / "hand"))
        assert one == other, name
    rows = list(csv.DictReader((out / "frames.csv").read_text().splitlines()))
    tip_mm = [float(rows[3][f"hand index tip {axis} mm"]) for axis in "xyz"]
    np.testing.assert_allclose(tip_mm, 1e3 * MOVEMENT.joints_m(3)[9], rtol=0, atol=5.1e-4)
    assert rows[1]["hand index tip x mm"] == ""  # nothing is seen there
    record = json.loads((out / "recording.json").read_text())
    assert record["frames"][3]["hand"] == json.loads((out / "hand/frames/000003.json").read_text())
