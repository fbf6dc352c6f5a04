"""``clradar process``: whole recordings, cleaned, imaged, compared, resumed."""

from __future__ import annotations

import csv
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run, exit_status, one_error_line
from PIL import Image
from quick_figures import seek_no_lobes
from recorder import Recorder, Recording

from calibration import average_frames, correct, range_gate, subtract_background
from clradar import AntennaArray, Capture, ChannelCalibration, VoxelGrid, Waveform, backproject
from clradar.arrays import qar50
from clradar.cli import recordings
from clradar.cli.frames import FrameSteps
from clradar.plot.frames import write_gif
from measurement_io import open_capture, open_channels, open_volume, save_capture, save_channels

GRID = ("--x-mm", "-60:60:6", "--y-mm", "-60:60:6", "--z-mm", "280:320:5")
FRAMES = 3
RESULTS = ("frames.csv", "movie.gif", "pictures/000001.png")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three frames of two points in a room, and two of the room; fewer antennas, frequencies."""
    made = Recorder(
        points_m=[[0.02, 0.01, 0.3], [-0.03, 0.0, 0.31]], waveform=Waveform.sfcw(72e9, 82e9, 48),
        array=AntennaArray(qar50().tx_m[::6], qar50().rx_m[::6]),
    )  # fmt: skip
    return made.write(tmp_path_factory.mktemp("recorded"), n_frames=FRAMES, emptyfiltered=False)


def channels_of(made: Recorder) -> ChannelCalibration:
    """What a calibration without errors would know."""
    response = made.response()
    assert response is not None
    zeros = {f"{side}_{what}": np.zeros(16) for side in ("tx", "rx")
             for what in ("noise", "phase_std_rad", "delay_std_s")}  # fmt: skip
    return ChannelCalibration(
        response, made.array, made.waveform, **zeros,
        dead_tx=[], dead_rx=[], noisy_tx=[], noisy_rx=[3], target="plate",
        target_position={"distance_m": 0.3}, target_covariance=[[1e-6]], target_amplitude=1.0,
        residual_db=-40.0, noise_residual_db=-41.0,
    )  # fmt: skip


def rows_of(folder: Path) -> list[dict[str, str]]:
    with open(folder / "frames.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def processed(recorded: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with inputs, and with what was made of them."""
    place = tmp_path_factory.mktemp("processed")
    for source, name in (
        (recorded.folder, "REC"),
        (recorded.folder, "SIM"),
        (recorded.empty, "ROOM"),
    ):
        (radar,) = source.glob("radar_*")
        shutil.copytree(radar, place / name / radar.name)
    save_channels(place / "channels.h5", channels_of(recorded.recorder))
    save_capture(place / "single.h5", recorded.recorder.frame(0))
    with pytest.MonkeyPatch.context() as patch:
        seek_no_lobes(patch)
        assert exit_status(*process_command(place, place / "out")) == 0
    return place


def process_command(place: Path, out: Path) -> list[object]:
    return [
        "process", place / "REC", place / "SIM", place / "single.h5", "--empty", place / "ROOM",
        "--channels", place / "channels.h5", "--scaling", "common", "--gate-mm", "200:400", *GRID,
        "--keep-captures", "--keep-volumes", "-o", out,
    ]  # fmt: skip


def test_every_frame_is_what_the_single_steps_make_of_it(
    recorded: Recording, processed: Path
) -> None:
    out = processed / "out"
    response = open_channels(processed / "channels.h5")
    empty = average_frames([open_capture(recorded.empty, frame=i) for i in range(2)])
    for i in range(FRAMES):
        capture = open_capture(recorded.folder, frame=i)
        capture = subtract_background(capture, empty, scaling="common")
        capture = correct(range_gate(capture, near_m=0.2, far_m=0.4), response)
        assert (open_capture(out / f"captures/{i:06d}.h5").data == capture.data).all()
        volume = open_volume(out / f"volumes/{i:06d}.h5")
        assert (backproject(capture, volume.grid).data == volume.data).all()
        row = rows_of(out)[i]
        amplitude = np.abs(volume.data)
        z, y, x = np.unravel_index(amplitude.argmax(), amplitude.shape)
        grid = volume.grid
        place = [float(row[f"peak {axis} mm"]) for axis in "xyz"]
        np.testing.assert_allclose(place, 1e3 * np.array([grid.x_m[x], grid.y_m[y], grid.z_m[z]]))
        assert float(row["peak dB"]) == pytest.approx(20 * np.log10(amplitude.max()), abs=1e-6)
        assert float(row["time s"]) == pytest.approx(0.1 * i)
        # The raw recording beside the cleaned one.
        assert float(row["SIM: overlap"]) < 0.9
    record = json.loads((out / "recording.json").read_text())
    assert [one["frame"] for one in record["frames"]] == [0, 1, 2]
    for name in (*RESULTS, "time-line.png"):
        assert (out / name).stat().st_size > 1000


@pytest.mark.usefixtures("quickly")
def test_a_killed_run_resumes_to_the_same_files(
    run: Run, recorded: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    command = ("process", recorded.folder, recorded.folder, *GRID)
    assert run(*command, "-o", whole).status == 0
    done: list[int] = []
    one_frame = FrameSteps.run

    def until_killed(self: FrameSteps, number: int, _: Any) -> None:
        if len(done) == 1:
            raise KeyboardInterrupt
        one_frame(self, number)
        done.append(number)

    monkeypatch.setattr(FrameSteps, "run", until_killed)
    assert run(*command, "-o", killed).status == 130
    assert not (killed / "recording.json").exists()
    # As a kill between the two files of a frame leaves it.
    (killed / "maps" / "000001.npz").write_bytes(b"half")
    monkeypatch.setattr(FrameSteps, "run", lambda s, n, _: done.append(n) or one_frame(s, n))
    outcome = run(*command, "-o", killed)
    assert outcome.status == 0, outcome.err
    assert "resumes with 1 of 3 frames done before" in outcome.out
    assert done == [0, 1, 2]
    for name in RESULTS:
        ours, theirs = ((folder / name).read_bytes() for folder in (whole, killed))
        assert ours == theirs, name
    monkeypatch.setattr(FrameSteps, "run", lambda *_: pytest.fail("all frames are done"))
    assert run(*command, "-o", killed).status == 0
    outcome = run("process", recorded.folder, "-o", killed, *GRID)
    one_error_line(outcome, "was begun with other settings", "simulated")
    assert run(*command, "-o", tmp_path / "x", "--frames", "7").status == 1
    assert not (tmp_path / "x").exists()


@pytest.mark.usefixtures("quickly")
def test_inputs_count_by_their_content(
    run: Run, recorded: Recording, processed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "elsewhere"
    shutil.copytree(processed, place)
    monkeypatch.chdir(place)
    done: list[int] = []
    one_frame = FrameSteps.run
    monkeypatch.setattr(FrameSteps, "run", lambda s, n, _: done.append(n) or one_frame(s, n))
    command = process_command(Path(), Path("out"))
    # The same by other names and with other times: nothing is done again.
    assert (run(*command).status, done) == (0, [])
    channels = place / "channels.h5"
    before = channels.stat()
    save_channels(channels, replace(channels_of(recorded.recorder), noisy_rx=[]), force=True)
    os.utime(channels, ns=(before.st_atime_ns, before.st_mtime_ns))
    one_error_line(run(*command), "--channels '", "channels.h5")
    assert done == []
    assert run(*command, "--force").status == 0
    assert done == [0, 1, 2]
    assert rows_of(Path("out")) != rows_of(processed / "out")


@pytest.mark.usefixtures("quickly")
def test_frames_that_are_gone_are_not_kept_without_a_word(
    run: Run, processed: Path, tmp_path: Path
) -> None:
    place = tmp_path / "elsewhere"
    shutil.copytree(processed, place)
    command = process_command(place, place / "out")
    for name in ("REC", "SIM"):
        next((place / name).rglob("000002.npy")).unlink()
    one_error_line(run(*command), "RECORDING of 4 files, now of 3", "--force")
    assert run(*command, "--force").status == 0
    assert [row["frame"] for row in rows_of(place / "out")] == ["0", "1"]
    assert len(list((place / "out" / "pictures").iterdir())) == 2
    assert not (place / "out" / "captures" / "000002.h5").exists()
    one_error_line(run("process", place / "REC", "-o", place / "REC", "--force"), "also an input")


@pytest.mark.usefixtures("quickly")
def test_variants_of_captures_are_told_by_their_names(
    run: Run, recorded: Recording, tmp_path: Path
) -> None:
    made = tmp_path / "made"
    names = ("000000.h5", "000001.h5", "000001_emptyfiltered.h5", "notes.h5")
    made.mkdir()
    for i, name in enumerate(names):
        save_capture(made / name, recorded.recorder.frame(i))
    for variant, numbers, read in ((None, "01", 0), ("raw", "01", 0), ("emptyfiltered", "1", 2)):
        out = tmp_path / f"{variant}"
        more = () if variant is None else ("--variant", variant)
        outcome = run("process", made, "-o", out, *GRID, "--keep-captures", *more)
        assert outcome.status == 0, outcome.err
        assert "left out, as they are not named like frames: notes.h5" in outcome.err
        assert [row["frame"] for row in rows_of(out)] == list(numbers)
        first = open_capture(out / "captures" / f"{int(numbers[0]):06d}.h5")
        assert (first.data == recorded.recorder.frame(read).data).all()
    (made / names[2]).unlink()
    outcome = run("process", made, "-o", tmp_path / "x", *GRID, "--variant", "emptyfiltered")
    one_error_line(outcome, "made: expected frames of the variant emptyfiltered", "000000.h5")


@pytest.mark.usefixtures("quickly")
def test_a_frame_that_cannot_be_read_costs_no_other_and_places_no_grid(
    run: Run, recorded: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed: list[Capture] = []

    def grid_for(capture: Capture, *_: Any) -> VoxelGrid:
        placed.append(capture)
        return VoxelGrid([-0.05, -0.04, 0.3], [5e-3] * 3, [21, 17, 3])

    monkeypatch.setattr(recordings, "grid_for", grid_for)
    made = recorded.recorder.write(tmp_path, n_frames=3)
    broken = next(made.folder.rglob("000000.npy"))
    broken.write_bytes(b"no frame")
    outcome = run("process", made.folder, "-o", tmp_path / "out", "--gate-mm", "200:400")
    assert outcome.status == 1
    want = range_gate(open_capture(made.folder, frame=1), near_m=0.2, far_m=0.4)
    assert [(capture.data == want.data).all() for capture in placed] == [True]
    assert "000000.npy" in outcome.err
    assert "1 of 3 frames could not be processed" in outcome.err
    assert [row["frame"] for row in rows_of(tmp_path / "out")] == ["1", "2"]
    # Pictures are numbered without gaps, as a video needs them.
    pictures = tmp_path / "out" / "pictures"
    assert sorted(path.name for path in pictures.iterdir()) == ["000000.png", "000001.png"]


@pytest.mark.usefixtures("quickly")
def test_the_workers_of_a_scheduler_make_the_same_files(
    run: Run, recorded: Recording, tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed")
    command = ("process", recorded.folder, "--frames", "1", *GRID, "-o")
    with distributed.LocalCluster(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None,
        resources={"DEVICE": 1},
    ) as cluster:  # fmt: skip
        outcome = run(*command, tmp_path / "there", "--scheduler", cluster.scheduler_address)
    assert outcome.status == 0, outcome.err
    assert run(*command, tmp_path / "here").status == 0
    for name in (*RESULTS[:2], "pictures/000000.png"):
        one, other = ((tmp_path / where / name).read_bytes() for where in ("here", "there"))
        assert one == other, name


def test_the_motion_of_a_mesh_is_that_of_its_frames(tmp_path: Path) -> None:
    """The table's columns from alignments: a mesh that moves along x and turns about its centre."""
    from clradar.cli.recordings import table

    centre = np.array([0.01, 0.02, 0.3])
    records: list[dict[str, Any]] = []
    for i in range(3):
        angle, moved = np.radians(10 * i), np.array([0.005 * i, 0, 0])
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn, centre + moved - turn @ centre
        records.append(
            {
                "frame": i, "time_us": None, "peak_db": 0.0, "recorded_db": 0.0, "cleaned_db": 0.0,
                "peak_m": centre.tolist(), "centre_m": centre.tolist(), "metrics": [],
                "alignment": {"transform": matrix.tolist(), "centre_m": (centre + moved).tolist(),
                              "inlier_share": 0.9, "rms_m": 1e-3},
            }
        )  # fmt: skip
    records[1]["alignment"] = {"failed": "could not align"}
    columns = table(records, [])
    np.testing.assert_allclose(columns["mesh x mm"], [10, np.nan, 20])
    np.testing.assert_allclose(columns["mesh y mm"], [20, np.nan, 20])
    np.testing.assert_allclose(columns["mesh turn z deg"], [0, np.nan, 20], atol=1e-9)
    np.testing.assert_allclose(columns["mesh rms mm"], [1, np.nan, 1])


def test_an_animation_has_the_pixels_of_its_pictures(tmp_path: Path) -> None:
    pictures = np.full((4, 20, 30, 3), 255, np.uint8)
    pictures[1:, 5:9, 3:20] = 200, 30, 0
    pictures[3, 0, 0] = 0, 0, 200  # 1 and 2 are the same
    pictures[0, 5:9, 3:20] = 0, 0, 200  # the first picture has the colours
    pictures[0, 15:, 3:20] = 200, 30, 0
    files = [tmp_path / f"{i}.png" for i in range(4)]
    for file, picture in zip(files, pictures, strict=True):
        Image.fromarray(picture).save(file)
    write_gif(tmp_path / "movie.gif", files, 0.1)
    with Image.open(tmp_path / "movie.gif") as movie:
        shown = []
        for i in range(movie.n_frames):  # type: ignore[attr-defined]
            movie.seek(i)
            shown += movie.info["duration"] // 100 * [np.asarray(movie.convert("RGB"))]
    assert np.array_equal(shown, pictures)  # frames that are the same are one, which stays longer
