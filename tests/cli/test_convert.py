"""``clradar convert``: between native captures and recordings, in both directions."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import command_line
import maroon_files as files
import numpy as np
import pytest
from comparisons import same_capture, tree

import clradar
from measurement_io import check_file, open_capture, save_capture

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command; return exit status, stdout and stderr."""

    return partial(command_line.run, capsys, "convert")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """<object>/<distance> with two frames of both variants, and a mesh."""
    distance = tmp_path / "hand" / "30"
    files.write_recording(distance, n_frames=2)
    (distance / "metadata.json").write_bytes(b'{"distance_meters":  0.3}')
    (distance / "photogrammetry").mkdir()
    (distance / "photogrammetry" / "mesh.obj").write_bytes(b"v 1 2 3\n")
    return distance


def native(path: Path, seed: int = 0, n_freq: int = 2, **meta: object) -> Path:
    data = files.expected_data(files.random_frame(n_freq, seed=seed))
    waveform = clradar.Waveform.sfcw(72e9, 82e9, n_freq)
    save_capture(path, clradar.Capture(data, clradar.arrays.qar50(), waveform, meta))
    return path


def one_error_line(outcome: tuple[int, str, str], *parts: str) -> None:
    status, _, err = outcome
    assert status == 1, err
    assert len(err.splitlines()) == 1, err
    for part in parts:
        assert part in err


def test_all_frames(run, recording, tmp_path):
    before = tree(recording)
    (tmp_path / "a").mkdir()
    status, out, err = run(recording, "-o", tmp_path / "a" / "b", "--all-frames")
    assert (status, err) == (0, "")
    assert "2 raw, 2 emptyfiltered frames" in out
    names = sorted(p.name for p in (tmp_path / "a" / "b").iterdir())
    assert names == [
        "000000.h5",
        "000000_emptyfiltered.h5",
        "000001.h5",
        "000001_emptyfiltered.h5",
    ]
    for name in names:
        recorded = open_capture(
            recording / "radar_72.0_82.0_2/calibrated_data" / (name[:-3] + ".npy")
        )
        capture = open_capture(tmp_path / "a" / "b" / name)
        assert same_capture(capture, recorded)
        assert capture.meta["timestamp_us"] == recorded.meta["timestamp_us"]
        assert capture.meta["variant"] == recorded.meta["variant"]
        assert [i["file"] for i in capture.meta["inputs"]] == [name[:-3] + ".npy"]
    assert tree(recording) == before


def test_all_frames_of_one_variant(run, recording, tmp_path):
    status, _, _ = run(
        recording, "-o", tmp_path / "a", "--all-frames", "--variant", "emptyfiltered"
    )
    assert status == 0
    assert [p.name[6:] for p in sorted((tmp_path / "a").iterdir())] == ["_emptyfiltered.h5"] * 2
    for path in (recording / "radar_72.0_82.0_2" / "calibrated_data").glob("*_emptyfiltered*"):
        path.unlink()
    one_error_line(
        run(recording, "-o", tmp_path / "b", "--all-frames", "--variant", "emptyfiltered"),
        "emptyfiltered",
    )


def test_all_frames_keeps_what_is_there(run, recording, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "000001.h5").write_bytes(b"precious")
    one_error_line(run(recording, "-o", tmp_path / "a", "--all-frames"), "000001.h5", "--force")
    assert tree(tmp_path / "a") == {"000001.h5": b"precious"}
    assert run(recording, "-o", tmp_path / "a", "--all-frames", "--force")[0] == 0
    assert len(tree(tmp_path / "a")) == 4


def test_all_frames_skips_damaged_frames(run, recording, tmp_path):
    data = recording / "radar_72.0_82.0_2" / "calibrated_data"
    bad = data / "000000.npy"
    bad.write_bytes(bad.read_bytes()[:-1000])
    status, out, err = run(recording, "-o", tmp_path / "a", "--all-frames")
    assert (status, out) == (1, "")
    warning, summary = err.splitlines()
    assert "warning" in warning
    assert "000000.npy" in warning
    assert "3 of 4 frames converted" in summary
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == ["000000_emptyfiltered.h5", "000001.h5", "000001_emptyfiltered.h5"]
    assert all(check_file(tmp_path / "a" / name).ok for name in names)
    read = open_capture(tmp_path / "a" / "000001.h5")
    assert same_capture(read, open_capture(data / "000001.npy"))
    for path in data.iterdir():
        path.write_bytes(b"")
    status, _, err = run(recording, "-o", tmp_path / "b", "--all-frames")
    assert status == 1
    assert len(err.splitlines()) == 5
    assert "0 of 4 frames converted" in err
    assert not (tmp_path / "b").exists()


def test_one_capture_to_a_recording_and_back(run, tmp_path):
    meta = {"note": "a hand", "rays": {"paths": 3}, "gain": 7}
    native(tmp_path / "sim.h5", **meta)
    (tmp_path / "new").mkdir()
    status, out, _ = run(tmp_path / "sim.h5", "-o", tmp_path / "new" / "30", "--to", "maroon")
    assert status == 0
    assert "1 frame" in out
    assert run(tmp_path / "new" / "30", "-o", tmp_path / "back.h5")[0] == 0
    back, capture = open_capture(tmp_path / "back.h5"), open_capture(tmp_path / "sim.h5")
    assert same_capture(back, capture)
    assert (back.meta["note"], back.meta["gain"]) == ("a hand", 7)
    record = json.loads(open_capture(tmp_path / "new" / "30").meta["provenance"])
    assert record["rays"] == {"paths": 3}
    assert record["command"] == "convert"
    assert [i["file"] for i in record["inputs"]] == ["sim.h5"]


def test_several_captures_to_a_recording(run, tmp_path):
    stamps = [1_700_000_000_000_123 - 1000 * (2 - i) for i in range(3)]
    sources = [native(tmp_path / f"{i}.h5", seed=i, timestamp_us=stamps[i]) for i in range(2)]
    sources.append(files.write_frame(tmp_path / "000009.npy", files.random_frame(seed=2)))
    status, out, err = run(*sources, "-o", tmp_path / "30", "--to", "maroon")
    assert status == 0, err
    assert "3 frames" in out
    for i, source in enumerate(sources):
        read = open_capture(tmp_path / "30", frame=i)
        assert same_capture(read, open_capture(source))
        assert read.meta["number_of_measurements"] == 3
        assert read.meta["timestamp_us"] == stamps[i]
    assert check_file(tmp_path / "30").ok, check_file(tmp_path / "30")


def test_a_recording_that_exists_is_kept(run, recording, tmp_path):
    source = native(tmp_path / "a.h5", seed=9)
    before = tree(recording)
    one_error_line(run(source, "-o", recording, "--to", "maroon"), "--force")
    (tmp_path / "file").write_bytes(b"")
    one_error_line(run(source, "-o", tmp_path / "file", "--to", "maroon"), "file")
    one_error_line(run(source, "-o", tmp_path / "file" / "30", "--to", "maroon"), "file")
    assert tree(recording) == before
    assert run(source, "-o", recording, "--to", "maroon", "--force")[0] == 0
    assert same_capture(open_capture(recording), open_capture(source))
    assert (recording / "metadata.json").read_bytes() == before["metadata.json"]


def test_provenance_grows_by_the_same_amount_with_every_conversion(run, tmp_path):
    native(tmp_path / "0.h5")
    sizes = []
    for i in range(5):
        assert run(tmp_path / f"{i}.h5", "--to", "maroon", "-o", tmp_path / f"m{i}")[0] == 0
        assert run(tmp_path / f"m{i}", "-o", tmp_path / f"{i + 1}.h5")[0] == 0
        sizes.append(len(json.dumps(dict(open_capture(tmp_path / f"{i + 1}.h5").meta))))
    growth = np.diff(sizes)
    assert growth.max() < 1.2 * growth.min() + 100
