"""``clradar process``: whole recordings, cleaned, imaged, compared, resumed, with hands.

The fits of hands are made up.
"""

import csv
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID as HAND_GRID, Cli, exit_status, worker_here
from comparisons import tree
from interrupted import interrupted_at
from made_up_frames import MOVEMENT, TIMES_S, made_up_fit_hands
from PIL import Image
from quick_figures import seek_nothing_else
from recorder import Recorder, Recording

import calibration
from calibration import average_frames, correct, range_gate, subtract_background
from calibration.hand_fit.starts import read_start
from calibration.registration.mesh_pose import depth_for_mesh
from clradar import AntennaArray, Capture, ChannelCalibration, VoxelGrid, Waveform, backproject
from clradar.arrays import qar50
from clradar.cli.commands import process as recordings
from clradar.cli.commands.process import MOVEMENT as FIGURE, SHEET, table
from clradar.cli.frames import RECORDS, FrameSteps
from clradar.hand import read_pose
from clradar.plot.captures import write_gif
from measurement_io import (
    open_capture,
    open_channels,
    open_volume,
    save_capture,
    save_channels,
    save_recording,
)

GRID = "--x-mm -60:60:6 --y-mm -60:60:6 --z-mm 280:320:5"
FRAMES = 3
SEEN = "settings.json"  # which says when inputs were seen
RESULTS = ("frames.csv", "movie.gif", "pictures/000001.png")
OPTIONS = f"--scaling common --gate-mm 200:400 {GRID} --keep-captures --keep-volumes"
COMMAND = f"process REC SIM single.h5 --empty ROOM --channels channels.h5 {OPTIONS} -o out"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three frames of two points in a room, and two of the room; fewer antennas, frequencies."""
    whole = qar50()
    made = Recorder(
        points_m=[[0.02, 0.01, 0.3], [-0.03, 0.0, 0.31]],
        waveform=Waveform.sfcw(72e9, 82e9, 48),
        array=AntennaArray(whole.tx_m[::6], whole.rx_m[::6]),
    )
    return made.write(tmp_path_factory.mktemp("recorded"), n_frames=FRAMES, emptyfiltered=False)


def channels_of(made: Recorder) -> ChannelCalibration:
    """What a calibration without errors would know."""
    whats = ("noise", "phase_std_rad", "delay_std_s")
    zeros = {f"{side}_{what}": np.zeros(16) for side in ("tx", "rx") for what in whats}
    lists = {"dead_tx": [], "dead_rx": [], "noisy_tx": [], "noisy_rx": [3]}
    place = {"target_position": {"distance_m": 0.3}, "target_covariance": [[1e-6]]}
    levels = {"target_amplitude": 1.0, "residual_db": -40.0, "noise_residual_db": -41.0}
    radar = (made.response(), made.array, made.waveform)
    return ChannelCalibration(*radar, **zeros, **lists, target="plate", **place, **levels)


def rows_of(folder: Path) -> list[dict[str, str]]:
    with open(folder / "frames.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def processed(recorded: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with inputs, and with what was made of them."""
    place = tmp_path_factory.mktemp("processed")
    sources = {"REC": recorded.folder, "SIM": recorded.folder, "ROOM": recorded.empty}
    for name, source in sources.items():
        (radar,) = source.glob("radar_*")
        shutil.copytree(radar, place / name / radar.name)
    save_channels(place / "channels.h5", channels_of(recorded.recorder))
    save_capture(place / "single.h5", recorded.recorder.frame(0))
    with pytest.MonkeyPatch.context() as patch:
        seek_nothing_else(patch)
        patch.chdir(place)
        assert exit_status(*COMMAND.split()) == 0
    return place


@pytest.fixture
def copy(cli: Cli, processed: Path, tmp_path: Path) -> Path:
    """What is processed, in the folder of the commands: other names, other times."""
    shutil.copytree(processed, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the frames that are processed."""
    numbers: list[int] = []
    one_frame = FrameSteps.run
    monkeypatch.setattr(
        FrameSteps, "run", lambda s, n, *more: numbers.append(n) or one_frame(s, n, *more)
    )
    return numbers


def test_every_frame_is_what_the_single_steps_make_of_it(recorded, processed):
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
        row, amplitude, grid = rows_of(out)[i], np.abs(volume.data), volume.grid
        z, y, x = np.unravel_index(amplitude.argmax(), amplitude.shape)
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
def test_inputs_count_by_their_content(cli, recorded, processed, copy, done):
    channels = Path("channels.h5").rename("renamed.h5")
    cli.ok(COMMAND.replace("channels.h5", channels.name))
    assert done == []
    channels = channels.rename("channels.h5")
    before = channels.stat()
    save_channels(channels, replace(channels_of(recorded.recorder), noisy_rx=[]), force=True)
    os.utime(channels, ns=(before.st_atime_ns, before.st_mtime_ns))
    cli.fails(COMMAND, "--channels '", "channels.h5")
    assert done == []
    cli.ok(f"{COMMAND} --force")
    assert done == [0, 1, 2]
    assert rows_of(Path("out")) != rows_of(processed / "out")
    # Frames that are gone are not kept without a word.
    for name in ("REC", "SIM"):
        next(Path(name).rglob("000002.npy")).unlink()
    cli.fails(COMMAND, "RECORDING of 4 files, now of 3", "--force")
    cli.ok(f"{COMMAND} --force")
    assert [row["frame"] for row in rows_of(Path("out"))] == ["0", "1"]
    assert len(list(Path("out/pictures").iterdir())) == 2
    assert not Path("out/captures/000002.h5").exists()
    cli.fails("process REC -o REC --force", "also an input")


@pytest.mark.usefixtures("quickly")
def test_a_folder_in_two_roles_counts_in_each(cli, copy):
    """Of the recording one frame is processed; its mean, as the empty room, is of all."""
    line = f"process REC --empty REC --frames 0 {GRID} -o twice"
    cli.ok(line)
    last = max(Path("REC").rglob("*.npy"))
    shutil.copyfile(min(Path("REC").rglob("*.npy")), last)
    cli.fails(line, f"--empty '{last}' holds something else now")


@pytest.mark.usefixtures("quickly")
def test_variants_of_captures_are_told_by_their_names(cli, recorded):
    names = ("000000.h5", "000001.h5", "000001_emptyfiltered.h5", "notes.h5")
    Path("made").mkdir()
    for i, name in enumerate(names):
        save_capture(f"made/{name}", recorded.recorder.frame(i))
    line = f"process made {GRID} --keep-captures -o"
    for more, numbers, read in (
        ("", "01", 0),
        (" --variant raw", "01", 0),
        (" --variant emptyfiltered", "1", 2),
    ):
        outcome = cli.ok(f"{line} {read}{len(more)}{more}")
        assert "left out, as they are not named like frames: notes.h5" in outcome.err
        out = Path(f"{read}{len(more)}")
        assert [row["frame"] for row in rows_of(out)] == list(numbers)
        first = open_capture(out / "captures" / f"{int(numbers[0]):06d}.h5")
        assert (first.data == recorded.recorder.frame(read).data).all()
    Path("made", names[2]).unlink()
    wanted = "made: expected frames of the variant emptyfiltered"
    cli.fails(f"{line} x --variant emptyfiltered", wanted, "000000.h5")


@pytest.mark.usefixtures("quickly")
def test_a_frame_that_cannot_be_read_costs_no_other_and_places_no_grid(
    cli, recorded, tmp_path, monkeypatch
):
    placed: list[Capture] = []

    def grid_for(capture: Capture, *_: Any) -> VoxelGrid:
        placed.append(capture)
        return VoxelGrid([-0.05, -0.04, 0.3], [5e-3] * 3, [21, 17, 3])

    monkeypatch.setattr("clradar.cli.images.grid_for", grid_for)
    folder = recorded.recorder.write(tmp_path, n_frames=3).folder
    next(folder.rglob("000000.npy")).write_bytes(b"no frame")
    outcome = cli(f"process {folder} -o out --gate-mm 200:400")
    assert outcome.status == 1
    want = range_gate(open_capture(folder, frame=1), near_m=0.2, far_m=0.4)
    assert [(capture.data == want.data).all() for capture in placed] == [True]
    assert "000000.npy" in outcome.err
    assert "1 of 3 frames could not be processed" in outcome.err
    assert [row["frame"] for row in rows_of(Path("out"))] == ["1", "2"]
    # Pictures are numbered without gaps, as a video needs them.
    pictures = sorted(path.name for path in Path("out/pictures").iterdir())
    assert pictures == ["000000.png", "000001.png"]


@pytest.mark.usefixtures("quickly")
def test_the_workers_of_a_scheduler_make_the_same_files(cli, recorded):
    pytest.importorskip("distributed")
    line = f"process {recorded.folder} --frames 1 {GRID} -o"
    with worker_here() as address:
        cli.ok(f"{line} there --scheduler {address}")
    cli.ok(f"{line} here")
    for name in (*RESULTS[:2], "pictures/000000.png"):
        assert Path("here", name).read_bytes() == Path("there", name).read_bytes()


def test_the_motion_of_a_mesh_is_that_of_its_frames():
    """The table's columns from alignments: a mesh that moves along x and turns about its centre."""
    centre = np.array([0.01, 0.02, 0.3])
    records: list[dict[str, Any]] = []
    for i in range(3):
        angle, at_m = np.radians(10 * i), centre + np.array([0.005 * i, 0, 0])
        matrix = np.eye(4)
        matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        matrix[:3, 3] = at_m - matrix[:3, :3] @ centre
        found = {"transform": matrix.tolist(), "centre_m": at_m.tolist()}
        levels = dict.fromkeys(("peak_db", "recorded_db", "cleaned_db"), 0.0)
        places = dict.fromkeys(("peak_m", "centre_m"), centre.tolist())
        alignment = {**found, "inlier_share": 0.9, "rms_m": 1e-3}
        record = {"frame": i, "time_us": None, "metrics": [], "alignment": alignment}
        records.append({**record, **levels, **places})
    records[1]["alignment"] = {"failed": "could not align"}
    columns = table(records, [])
    np.testing.assert_allclose(columns["mesh x mm"], [10, np.nan, 20])
    np.testing.assert_allclose(columns["mesh y mm"], [20, np.nan, 20])
    np.testing.assert_allclose(columns["mesh turn z deg"], [0, np.nan, 20], atol=1e-9)
    np.testing.assert_allclose(columns["mesh rms mm"], [1, np.nan, 1])


def test_an_animation_has_the_pixels_of_its_pictures(tmp_path):
    red, blue = (200, 30, 0), (0, 0, 200)
    pictures = np.full((4, 20, 30, 3), 255, np.uint8)
    pictures[1:, 5:9, 3:20] = red
    pictures[3, 0, 0] = blue  # 1 and 2 are the same
    pictures[0, 5:9, 3:20] = blue  # the first picture has the colours
    pictures[0, 15:, 3:20] = red
    files = [tmp_path / f"{i}.png" for i in range(4)]
    for file, picture in zip(files, pictures, strict=True):
        Image.fromarray(picture).save(file)
    write_gif(tmp_path / "movie.gif", files, 0.1)
    shown = []
    with Image.open(tmp_path / "movie.gif") as movie:
        for i in range(movie.n_frames):  # type: ignore[attr-defined]
            movie.seek(i)
            shown += movie.info["duration"] // 100 * [np.asarray(movie.convert("RGB"))]
    assert np.array_equal(shown, pictures)  # frames that are the same are one, which stays longer


@pytest.mark.usefixtures("quickly")
def test_a_killed_run_resumes_to_the_same_files(cli, recorded, done):
    line = f"process {recorded.folder} {recorded.folder} {GRID} -o"
    cli.ok(f"{line} whole")
    with interrupted_at(FrameSteps, "run", 2):
        assert cli(f"{line} killed").status == 130
    assert not Path("killed/recording.json").exists()
    # As a kill between the two files of a frame leaves it.
    Path("killed/maps/000001.npz").write_bytes(b"half")
    done.clear()
    outcome = cli.ok(f"{line} killed")
    assert "resumes with 1 of 3 frames done before" in outcome.out
    assert done == [1, 2]
    whole, killed = tree("whole", SEEN), tree("killed", SEEN)
    assert [name for name in RESULTS if whole[name] != killed[name]] == []
    cli.ok(f"{line} killed")
    assert done == [1, 2]
    other = f"process {recorded.folder} {GRID} -o killed"
    cli.fails(other, "was begun with other settings", "simulated")
    cli.fails(f"{line} x --frames 7", "7")
    assert not Path("x").exists()


# ---- hands


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


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Frames whose hands are fitted, by made-up fits; an interrupt ends them where it is put."""
    numbers: list[int] = []

    def fits(images: Any, **settings: Any) -> Iterator[Any]:
        for fit, track in made_up_fit_hands(_Numbers(images), **settings):
            if numbers[:1] == [-fit.frame]:
                raise KeyboardInterrupt
            numbers.append(fit.frame)
            yield fit, track

    monkeypatch.setattr(calibration, "fit_hands", fits)
    return numbers


@pytest.fixture
def line(cli: Cli, made: Path) -> str:
    """The command that fits the hands of four frames, one of them without an echo."""
    whole = open_capture(made / "sim.h5")
    few = slice(None, None, 6)
    array = AntennaArray(whole.array.tx_m[few], whole.array.rx_m[few])
    capture = replace(whole, data=whole.data[few, few], array=array)
    empty = replace(capture, data=np.zeros_like(capture.data))
    stamps_us = [1 + 125_000 * i for i in range(4)]
    save_recording("one", [capture, empty, capture, capture], timestamps_us=stamps_us)
    return f"process one --fit-hand F --fit-shape {HAND_GRID} -o"


@pytest.mark.usefixtures("quickly")
def test_a_folder_with_hands_table_and_figures(cli, line, tried):
    outcome = cli.ok(f"{line} out")
    # 16 frequencies may be few for this grid: said once at most, not of every frame.
    assert outcome.err.count("warning") == outcome.err.count("unambiguous") <= 1
    folder = Path("out/hand")
    assert {path.name for path in folder.iterdir()} == {FIGURE, SHEET, RECORDS}
    assert "4 frames, 1 followed, 2 searched, 1 without a hand" in outcome.out
    frame = json.loads((folder / "frames/000003.json").read_text())
    assert (frame["how"], frame["start"]) == ("followed", "frame 2")
    assert frame["time_s"] == pytest.approx(0.375001)
    # A pose file, a transform and a start for other commands.
    pose = read_pose(folder / "frames/000003.toml")
    assert pose.joints.keys() == MOVEMENT.pose(TIMES_S[3]).joints.keys()
    start = read_start(folder / "frames/000003.json")
    assert np.array_equal(start.transform, MOVEMENT.transform(TIMES_S[3]))
    fitted = [one["hand"] for one in json.loads(Path("out/recording.json").read_text())["frames"]]
    assert [one["how"] for one in fitted] == ["searched", "nothing found", "searched", "followed"]
    assert "the misfit per cell is 1.30" in " ".join(fitted[2]["notes"])
    assert fitted[3] == frame
    overall = rows_of(Path("out"))
    tip_mm = [float(overall[3][f"hand index tip {axis} mm"]) for axis in "xyz"]
    np.testing.assert_allclose(tip_mm, 1e3 * MOVEMENT.joints_m(TIMES_S[3])[9], rtol=0, atol=5.1e-4)
    assert overall[1]["hand index tip x mm"] == ""  # nothing is seen there
    before = tree("out", SEEN)
    cli.ok(f"{line} out")
    assert tree("out", SEEN) == before


@pytest.mark.usefixtures("quickly")
def test_an_interrupted_fit_goes_on_where_it_was(cli, line, tried, monkeypatch):
    """It gives every byte of an uninterrupted one, though the last frame was half written."""
    monkeypatch.setattr(recordings, "draw_movement", lambda *_: None)
    cli.ok(f"{line} whole")
    tried[:] = [-2]
    assert cli(f"{line} cut").status == 130
    assert not Path("cut/recording.json").exists()
    Path("cut/hand/frames/000002.json").write_text("{}")
    Path("cut/hand/frames/.000003.json.0123.tmp").touch()
    tried.clear()
    cli.fails(f"{line} cut --seed 1", "seed 0, now 1")
    cli.ok(f"{line} cut")
    assert tried == [2, 3]
    assert tree("cut", SEEN) == tree("whole", SEEN)
