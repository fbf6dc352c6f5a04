"""``clradar convert``: between native captures and recordings, in both directions."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import command_line
import maroon_files as files
import maroon_products as made
import numpy as np
import pytest
from systems import posix_only

import clradar
from measurement_io import check_file, open_capture, read_depth_map, save_capture

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command; return exit status, stdout and stderr."""

    return partial(command_line.run, capsys, "convert")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """<object>/<distance> with two frames of both variants, products of frame 1, and a mesh."""
    distance = tmp_path / "hand" / "30"
    radar = files.write_recording(distance, n_frames=2)
    made.write_products(radar, 1, made.scene([(0.05, 0.02, 0.3, 500.0)], (9, 7, 3)))
    (distance / "metadata.json").write_bytes(b'{"distance_meters":  0.3}')
    (distance / "photogrammetry").mkdir()
    (distance / "photogrammetry" / "mesh.obj").write_bytes(b"v 1 2 3\n")
    return distance


def native(path: Path, seed: int = 0, n_freq: int = 2, **meta: object) -> Path:
    data = files.expected_data(files.random_frame(n_freq, seed=seed))
    waveform = clradar.Waveform.sfcw(72e9, 82e9, n_freq)
    save_capture(path, clradar.Capture(data, clradar.arrays.qar50(), waveform, meta))
    return path


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def same_capture(a: clradar.Capture, b: clradar.Capture) -> bool:
    return same_bits(a.data, b.data) and same_bits(
        a.waveform.frequencies_hz, b.waveform.frequencies_hz
    )


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def one_error_line(outcome: tuple[int, str, str], *parts: str) -> None:
    status, _, err = outcome
    assert status == 1, err
    assert len(err.splitlines()) == 1, err
    for part in parts:
        assert part in err


# ---- every frame to a file of its own


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


@pytest.mark.parametrize("number", [0, 1])
def test_a_recording_with_a_damaged_frame_is_not_copied(run, recording, tmp_path, number):
    bad = recording / "radar_72.0_82.0_2" / "calibrated_data" / f"00000{number}.npy"
    bad.write_bytes(bad.read_bytes()[:-1000])
    outcome = run(recording, "-o", tmp_path / "copy", "--to", "maroon")
    one_error_line(outcome, bad.name, "--all-frames converts the frames that can be read")
    assert not (tmp_path / "copy").exists()


# ---- to a recording


def test_one_capture_to_a_recording_and_back(run, tmp_path):
    meta = {"note": "a hand", "rays": {"paths": 3}, "gain": 7}
    native(tmp_path / "sim.h5", **meta)
    (tmp_path / "new").mkdir()
    status, out, _ = run(tmp_path / "sim.h5", "-o", tmp_path / "new" / "30", "--to", "maroon")
    assert status == 0
    assert "1 raw frame" in out
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
    assert "3 raw frames" in out
    for i, source in enumerate(sources):
        read = open_capture(tmp_path / "30", frame=i)
        assert same_capture(read, open_capture(source))
        assert read.meta["number_of_measurements"] == 3
        assert read.meta["timestamp_us"] == stamps[i]
    assert check_file(tmp_path / "30").ok, check_file(tmp_path / "30")


def test_time_stamps_and_variant_of_captures(run, tmp_path):
    sources = [native(tmp_path / f"{i}.h5", seed=i) for i in range(2)]
    command = [*sources, "-o", tmp_path / "30", "--to", "maroon", "--variant", "emptyfiltered"]
    one_error_line(run(*command, "--timestamp-us", 5), "time stamps")
    assert not (tmp_path / "30").exists()
    assert run(*command, "--timestamp-us", 5, "--timestamp-us", 7)[0] == 0
    read = open_capture(tmp_path / "30", frame=1, variant="emptyfiltered")
    assert read.meta["timestamp_us"] == 7


@pytest.mark.parametrize("whole_folder", [False, True])
def test_all_frames_and_back(run, recording, tmp_path, whole_folder):
    data = recording / "radar_72.0_82.0_2" / "calibrated_data"
    (data / "000000_emptyfiltered.npy").unlink()
    assert run(recording, "-o", tmp_path / "frames", "--all-frames")[0] == 0
    captures = sorted((tmp_path / "frames").iterdir(), reverse=True)  # not the order of numbers
    captures.sort(key=lambda path: path.name[:6])
    sources = [tmp_path / "frames"] if whole_folder else captures
    status, out, err = run(*sources, "-o", tmp_path / "back", "--to", "maroon")
    assert (status, err) == (0, "")
    assert "2 raw, 1 emptyfiltered frames" in out
    assert sorted(p.name for p in tmp_path.glob("back/*/*/*.npy")) == sorted(os.listdir(data))
    for frame, variant in ((0, "raw"), (1, "raw"), (1, "emptyfiltered")):
        read, theirs = (
            open_capture(folder, frame=frame, variant=variant)
            for folder in (tmp_path / "back", recording)
        )
        assert same_capture(read, theirs)
        assert read.meta["timestamp_us"] == theirs.meta["timestamp_us"]
    assert check_file(tmp_path / "back").ok, check_file(tmp_path / "back")
    assert run(*sources, "-o", tmp_path / "one", "--to", "maroon", "--variant", "raw")[0] == 0
    names = sorted(p.name for p in tmp_path.glob("one/*/*/*.npy"))
    assert names == ["000000.npy", "000001.npy", "000002.npy"]


def test_variants_of_frames_and_of_captures_without_one(run, recording, tmp_path):
    data = recording / "radar_72.0_82.0_2" / "calibrated_data"
    filtered = [data / "000001_emptyfiltered.npy", data / "000000_emptyfiltered.npy"]
    raw = [native(tmp_path / "a.h5"), native(tmp_path / "odd.h5", seed=5, variant="odd")]
    target = ["-o", tmp_path / "30", "--to", "maroon"]
    assert run(filtered[0], raw[0], filtered[1], raw[1], *target)[0] == 0
    for variant, paths in (("raw", raw), ("emptyfiltered", filtered)):
        for frame, path in enumerate(paths):  # without numbers of their own: in order
            read = open_capture(tmp_path / "30", frame=frame, variant=variant)
            assert same_capture(read, open_capture(path))
    one_error_line(run(*raw, filtered[0], "-o", tmp_path / "40", "--to", "maroon"), "000001_empty")
    assert not (tmp_path / "40").exists()


def test_a_recording_to_a_recording(run, recording, tmp_path):
    before = tree(recording)
    status, out, err = run(recording, "-o", tmp_path / "copy", "--to", "maroon")
    assert status == 0, err
    assert "2 raw, 2 emptyfiltered frames" in out
    after = tree(tmp_path / "copy")
    for name, content in before.items():
        if name.endswith((".ply", ".png", ".obj", "metadata.json")):
            assert after[name] == content
    for frame in range(2):
        for variant in ("raw", "emptyfiltered"):
            assert same_capture(
                open_capture(tmp_path / "copy", frame=frame, variant=variant),
                open_capture(recording, frame=frame, variant=variant),
            )
    assert tree(recording) == before


@pytest.mark.parametrize("variant", ["raw", "emptyfiltered", None])
def test_one_frame_of_a_recording_to_a_recording(run, recording, tmp_path, variant):
    chosen = [] if variant is None else ["--variant", variant]
    command = [recording, "-o", tmp_path / "one", "--to", "maroon", "--frame", 1, *chosen]
    assert run(*command)[0] == 0
    there = sorted(p.name for p in tmp_path.glob("one/radar*/calibrated_data/*"))
    expected = {"raw": ["000000.npy"], "emptyfiltered": ["000000_emptyfiltered.npy"]}
    assert there == expected.get(variant, ["000000.npy", "000000_emptyfiltered.npy"])
    for name in [variant] if variant else ["raw", "emptyfiltered"]:
        read = open_capture(tmp_path / "one", variant=name)
        assert same_capture(read, open_capture(recording, frame=1, variant=name))
        assert read.meta["number_of_measurements"] == 1
    (radar,) = (tmp_path / "one").glob("radar*")
    theirs = read_depth_map(recording / radar.name, 1)
    assert np.array_equal(read_depth_map(radar, 0).depth_m, theirs.depth_m, equal_nan=True)
    one_error_line(
        run(recording, "-o", tmp_path / "two", "--to", "maroon", "--frame", 5, *chosen), "frame 5"
    )


# ---- refusals


def test_captures_that_do_not_belong_together(run, tmp_path):
    a = native(tmp_path / "a.h5")
    b = native(tmp_path / "b.h5", n_freq=3)
    array = clradar.AntennaArray(np.eye(3), np.eye(3), "three")
    other = clradar.Capture(
        np.ones((3, 3, 2), np.complex64), array, clradar.Waveform.sfcw(72e9, 82e9, 2)
    )
    save_capture(tmp_path / "c.h5", other)
    frame = files.write_frame(tmp_path / "000000_emptyfiltered.npy", files.random_frame())
    target = ["-o", tmp_path / "30", "--to", "maroon"]
    one_error_line(run(a, b, *target), "b.h5", "2 from 72 to 82 GHz", "3 from 72 to 82 GHz")
    one_error_line(run(a, tmp_path / "c.h5", *target), "c.h5", "qar50", "three")
    one_error_line(run(a, tmp_path / "none.h5", *target), "none.h5")
    assert not list(tmp_path.glob("**/30*"))
    assert run(a, frame, *target, "--variant", "raw")[0] == 0
    assert len(list((tmp_path / "30").glob("*/*/00000?.npy"))) == 2


def test_a_recording_with_a_hole_in_the_emptyfiltered_variant(run, recording, tmp_path):
    hole = "radar_72.0_82.0_2/calibrated_data/000000_emptyfiltered.npy"
    (recording / hole).unlink()
    status, out, err = run(recording, "-o", tmp_path / "copy", "--to", "maroon")
    assert (status, err) == (0, "")
    assert "2 raw, 1 emptyfiltered frames" in out
    assert tree(tmp_path / "copy").keys() == tree(recording).keys()
    read, theirs = (
        open_capture(folder, frame=1, variant="emptyfiltered")
        for folder in (tmp_path / "copy", recording)
    )
    assert same_capture(read, theirs)
    assert read.meta["timestamp_us"] == theirs.meta["timestamp_us"]


def test_an_emptyfiltered_frame_without_a_raw_one(run, recording, tmp_path):
    (recording / "radar_72.0_82.0_2/calibrated_data/000000.npy").unlink()
    target = ["-o", tmp_path / "copy", "--to", "maroon"]
    one_error_line(run(recording, *target), "every emptyfiltered one, got none for 0", "--variant")
    assert run(recording, *target, "--variant", "raw")[0] == 0


@posix_only
@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_recording_is_never_written_into_itself(run, recording, tmp_path, force):
    before = tree(recording)
    radar = recording / "radar_72.0_82.0_2"
    frame = radar / "calibrated_data" / "000000.npy"
    for source in (recording, radar, frame):
        for target in (recording, radar / "calibrated_data", radar / "new"):
            one_error_line(run(source, "-o", target, "--to", "maroon", *force), "30")
    for target in (radar, radar / "calibrated_data"):
        one_error_line(run(recording, "-o", target, "--all-frames", *force), "radar_72.0_82.0_2")
    link = tmp_path / "link"
    os.symlink(recording, link)
    one_error_line(run(recording, "-o", link, "--to", "maroon", *force), "link")
    assert tree(recording) == before


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


def test_all_frames_of_what_is_no_folder(run, tmp_path):
    native(tmp_path / "a.h5")
    for source in ("a.h5", "none"):
        one_error_line(run(tmp_path / source, "-o", tmp_path / "x", "--all-frames"), source)
    assert not (tmp_path / "x").exists()


def test_provenance_grows_by_the_same_amount_with_every_conversion(run, tmp_path):
    native(tmp_path / "0.h5")
    sizes = []
    for i in range(5):
        assert run(tmp_path / f"{i}.h5", "--to", "maroon", "-o", tmp_path / f"m{i}")[0] == 0
        assert run(tmp_path / f"m{i}", "-o", tmp_path / f"{i + 1}.h5")[0] == 0
        sizes.append(len(json.dumps(dict(open_capture(tmp_path / f"{i + 1}.h5").meta))))
    growth = np.diff(sizes)
    assert growth.max() < 1.2 * growth.min() + 100
