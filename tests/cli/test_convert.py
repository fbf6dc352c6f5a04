"""``clradar convert``: between native captures and recordings, in both directions."""

import json
from pathlib import Path

import maroon_files as files
import numpy as np
import pytest
from command_line import Cli
from comparisons import same_capture, tree

import clradar
from measurement_io import check_file, open_capture, save_capture

DATA = "radar_72.0_82.0_2/calibrated_data"
NAMES = ["000000", "000000_emptyfiltered", "000001", "000001_emptyfiltered"]


@pytest.fixture
def recording(cli: Cli) -> Path:
    """<object>/<distance> with two frames of both variants, and a mesh."""
    distance = Path("hand/30")
    files.write_recording(distance, n_frames=2)
    (distance / "metadata.json").write_bytes(b'{"distance_meters":  0.3}')
    (distance / "photogrammetry").mkdir()
    (distance / "photogrammetry" / "mesh.obj").write_bytes(b"v 1 2 3\n")
    return distance


def native(name: str, seed: int = 0, **meta: object) -> str:
    data = files.expected_data(files.random_frame(2, seed=seed))
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 2)
    save_capture(name, clradar.Capture(data, clradar.arrays.qar50(), waveform, meta))
    return name


def names(folder: str) -> list[str]:
    return sorted(path.name.removesuffix(".h5") for path in Path(folder).iterdir())


def test_all_frames(cli, recording):
    before = tree(recording)
    Path("kept").mkdir()
    Path("kept/000001.h5").write_bytes(b"precious")
    outcome = cli.ok("convert hand/30 -o a --all-frames")
    assert outcome.err == ""
    assert "2 raw, 2 emptyfiltered frames" in outcome.out
    assert names("a") == NAMES
    for name in NAMES:
        recorded = open_capture(recording / DATA / f"{name}.npy")
        capture = open_capture(f"a/{name}.h5")
        assert same_capture(capture, recorded)
        for key in ("timestamp_us", "variant"):
            assert capture.meta[key] == recorded.meta[key]
        assert [i["file"] for i in capture.meta["inputs"]] == [f"{name}.npy"]
    cli.ok("convert hand/30 -o b --all-frames --variant emptyfiltered")
    assert names("b") == NAMES[1::2]
    cli.fails("convert hand/30 -o kept --all-frames", "000001.h5", "--force")
    assert tree(Path("kept")) == {"000001.h5": b"precious"}
    cli.ok("convert hand/30 -o kept --all-frames --force")
    assert names("kept") == NAMES
    assert tree(recording) == before
    for path in (recording / DATA).glob("*_emptyfiltered*"):
        path.unlink()
    line = "convert hand/30 -o c --all-frames --variant emptyfiltered"
    cli.fails(line, "emptyfiltered")


def test_all_frames_skips_damaged_frames(cli, recording):
    bad = recording / DATA / "000000.npy"
    bad.write_bytes(bad.read_bytes()[:-1000])
    outcome = cli("convert hand/30 -o a --all-frames")
    assert (outcome.status, outcome.out) == (1, "")
    warning, summary = outcome.err.splitlines()
    assert "warning" in warning
    assert "000000.npy" in warning
    assert "3 of 4 frames converted" in summary
    assert names("a") == NAMES[1:]
    assert all(check_file(path).ok for path in Path("a").iterdir())
    for path in (recording / DATA).iterdir():
        path.write_bytes(b"")
    outcome = cli("convert hand/30 -o b --all-frames")
    assert (outcome.status, len(outcome.err.splitlines())) == (1, 5)
    assert "0 of 4 frames converted" in outcome.err
    assert not Path("b").exists()


def test_one_capture_to_a_recording_and_back(cli):
    native("sim.h5", note="a hand", rays={"paths": 3}, gain=7)
    Path("new").mkdir()
    outcome = cli.ok("convert sim.h5 -o new/30 --to maroon")
    assert "1 frame" in outcome.out
    cli.ok("convert new/30 -o back.h5")
    back = open_capture("back.h5")
    assert same_capture(back, open_capture("sim.h5"))
    assert (back.meta["note"], back.meta["gain"]) == ("a hand", 7)
    record = json.loads(open_capture("new/30").meta["provenance"])
    assert (record["rays"], record["command"]) == ({"paths": 3}, "convert")
    assert [i["file"] for i in record["inputs"]] == ["sim.h5"]
    sizes = []  # provenance grows by the same amount with every conversion
    for _ in range(5):
        cli.ok("convert back.h5 --to maroon -o 30 --force")
        cli.ok("convert 30 -o back.h5 --force")
        sizes.append(len(json.dumps(dict(open_capture("back.h5").meta))))
    growth = np.diff(sizes)
    assert growth.max() < 1.2 * growth.min() + 100


def test_several_captures_to_a_recording(cli):
    stamps = [1_700_000_000_000_123 - 1000 * (2 - i) for i in range(3)]
    sources = [native(f"{i}.h5", seed=i, timestamp_us=stamps[i]) for i in range(2)]
    files.write_frame(Path("000009.npy"), files.random_frame(seed=2))
    sources.append("000009.npy")
    assert "3 frames" in cli.ok(f"convert {' '.join(sources)} -o 30 --to maroon").out
    for i, source in enumerate(sources):
        read = open_capture("30", frame=i)
        assert same_capture(read, open_capture(source))
        assert read.meta["number_of_measurements"] == 3
        assert read.meta["timestamp_us"] == stamps[i]
    assert check_file("30").ok
