"""``clradar compare --frames``: recordings and folders, frame by frame."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import GRID, Run, one_error_line

from measurement_io import open_capture, save_recording


@pytest.fixture(scope="module")
def moving(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of three frames with ever less of the hand's echoes, and a noisier one."""
    folder = tmp_path_factory.mktemp("moving")
    capture = open_capture(made / "sim.h5")
    frames = []
    for i in range(3):
        data = capture.data.copy()
        data[i * 20 :] *= 0.1
        frames.append(type(capture)(data, capture.array, capture.waveform))
    save_recording(folder / "hand" / "30", frames, timestamps_us=[0, 1, 2])
    save_recording(folder / "other" / "30", [capture] * 3, timestamps_us=[0, 1, 2])
    return folder


def test_metrics_and_page_of_every_frame(
    run: Run, moving: Path, made: Path, tmp_path: Path
) -> None:
    page, record = tmp_path / "x.html", tmp_path / "x.json"
    outcome = run(
        "compare", moving / "hand/30", moving / "other/30", made / "volume.h5", "--frames", "0:2:2",
        *GRID, "--report", page, "--json", record,
    )  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert "mean of 2 frames" in outcome.out
    found = json.loads(record.read_text())["simulated"]
    assert [one["frame"] for one in found[0]["frames"]] == [0, 2]
    for frame in (0, 2):
        single = tmp_path / f"{frame}.json"
        outcome = run("compare", moving / "hand/30", made / "sim.h5", "--frame", frame, *GRID,
                      "--json", single)  # fmt: skip
        assert outcome.status == 0, outcome.err
        expected = json.loads(single.read_text())["simulated"][0]["metrics"]
        # The same capture, imaged and as a volume.
        for one in found:
            (metrics,) = (f["metrics"] for f in one["frames"] if f["frame"] == frame)
            assert metrics["overlap"] == pytest.approx(expected["overlap"], abs=1e-6)
    values = [f["metrics"]["overlap"] for f in found[0]["frames"]]
    assert found[0]["mean"]["overlap"] == pytest.approx(sum(values) / 2)
    assert "frame 2" in page.read_text(encoding="utf-8")


def test_a_folder_of_captures_is_as_good(run: Run, moving: Path, tmp_path: Path) -> None:
    assert run("convert", moving / "hand/30", "--all-frames", "-o", tmp_path / "c").status == 0
    tables = []
    for source in (moving / "hand/30", tmp_path / "c"):
        outcome = run("compare", source, moving / "other/30", "--frames", "1", *GRID)
        assert outcome.status == 0, outcome.err
        tables.append(outcome.out)
    assert tables[0] == tables[1]


def test_what_does_not_fit_is_refused(run: Run, moving: Path, made: Path, tmp_path: Path) -> None:
    both = ("compare", moving / "hand/30", moving / "other/30")
    one_error_line(run(*both, "--frames", "7"), "frames 0 to 2", "'7'")
    assert run(*both, "--frames", "0:x").status == 2
    assert run(*both, "--frames", "all", "--frame", "1").status == 2
    assert run(*both, "--frames", "all", "-o", tmp_path / "x.png").status == 2
    assert run("compare", made / "sim.h5", made / "sim.h5", "--frames", "all").status == 2
    short = tmp_path / "short" / "30"
    save_recording(short, [open_capture(made / "sim.h5")])
    outcome = run("compare", moving / "hand/30", short, "--frames", "all", *GRID)
    one_error_line(outcome, f"{short}: expected the frames of", "none of number 1, 2")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["short"]
