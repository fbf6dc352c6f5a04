"""``clradar live`` and ``clradar replay``: frames to depth maps, in the terminal and in files."""

from __future__ import annotations

import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run
from rich.console import Console

import clradar
from clradar.live import LiveImages, Shown
from clradar.live import run as run_live
from clradar.live.inbox import Arrived, Counts, Inbox
from clradar.live.loop import Pace
from clradar.live.screen import MOST_COLUMNS, blocks, state_words
from measurement_io import open_recording, save_recording

WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 8)
QAR50 = clradar.arrays.qar50()
GRID = clradar.VoxelGrid.from_extent((-0.02, 0.02), (-0.02, 0.02), (0.28, 0.32), 4e-3)
GRID_OPTIONS = ["--x-mm=-20:20:4", "--y-mm=-20:20:4", "--z-mm=280:320:4"]


def point(z_m: float, array: clradar.AntennaArray = QAR50) -> clradar.Capture:
    return clradar.room_capture(array, WAVEFORM, [], points_m=[[0.004, -0.008, z_m]])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "point" / "30"
    frames = [point(z_m) for z_m in (0.296, 0.300, 0.304)]
    save_recording(path, frames, timestamps_us=[0, 20_000, 40_000])
    return path


def test_what_is_shown_is_written(run: Run, recording: Path, tmp_path: Path) -> None:
    outcome = run("live", str(recording), *GRID_OPTIONS, "-o", str(tmp_path / "shown"))
    assert outcome.status == 0, outcome.err
    lines = outcome.out.splitlines()
    assert lines[0] == "recording, 3 frames, 50 frames/s"
    shown = int(lines[-1].removeprefix("end: ").split()[0])
    files = sorted(path.name for path in (tmp_path / "shown").iterdir())
    assert files == [f"{i:06d}.npz" for i in range(shown)]
    with (
        np.load(tmp_path / "shown" / files[-1]) as last,
        np.load(tmp_path / "shown" / files[0]) as first,
    ):
        want = clradar.backproject(open_recording(recording)[2], GRID, check_grid=False)
        np.testing.assert_array_equal(last["depth_m"], want.depth_map().depth_m)
        assert first["depth_m"].shape == (11, 11)


def test_a_stream_is_shown_until_enough_frames_came(run: Run, recording: Path) -> None:
    """As a user runs them: two programs."""
    command = [sys.executable, "-m", "clradar", "live", "tcp:0", "--frames", "1", *GRID_OPTIONS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        address = listener.stdout.readline().split(": ")[0]
        assert address.startswith("127.0.0.1:")
        outcome = run("replay", str(recording), "--to", address, "--rate-hz", "inf")
        rest = listener.stdout.read()
    assert listener.returncode == 0
    assert rest.splitlines()[-1].startswith("end: 1 shown")
    # The listener may end before all was sent.
    assert outcome.status == 0 or "frames sent, then" in outcome.err


class Given:
    """A source of frames that the test makes."""

    words = "given"

    def __init__(self, frames: list[clradar.Capture]) -> None:
        self._frames, self.shown = frames, threading.Semaphore(0)

    def run(self, inbox: Inbox, stop: threading.Event) -> None:
        """Each frame comes when the last one was shown, or was bad."""
        for i, frame in enumerate(self._frames):
            bad = inbox.counts.bad
            inbox.put(Arrived(frame, f"frame {i}", 0.0))
            while not self.shown.acquire(blocking=False):
                if stop.wait(0.01) or inbox.counts.bad > bad:
                    break


def live(frames: list[clradar.Capture], **options: Any) -> tuple[list[Shown], Pace, Counts]:
    source, shown = Given(frames), []

    def show(one: Shown) -> None:
        shown.append(one)
        source.shown.release()

    with closing(LiveImages(GRID, "rect", None, 15.0, clradar.open_device())) as images:
        return shown, *run_live(source, images, show, lambda pace, counts: None, **options)


def test_every_frame_is_imaged_by_its_own_radar() -> None:
    half = clradar.AntennaArray(QAR50.tx_m[::2], QAR50.rx_m[::2])
    frames = [point(0.300), point(0.304), point(0.296, half), point(0.300)]
    shown, pace, counts = live(frames)
    assert [one.label for one in shown] == [f"frame {i}" for i in range(4)]
    for one, frame in zip(shown, frames, strict=True):
        want = clradar.backproject(frame, GRID, check_grid=False).depth_map(15.0)
        np.testing.assert_allclose(one.image.depth_m, want.depth_m, rtol=1e-6)
    assert (pace.shown, counts) == (4, Counts(arrived=4))
    assert [one.pace.shown for one in shown] == [1, 2, 3, 4]
    assert pace.rate_hz > 0
    assert 0 < pace.latency_s <= pace.worst_s


def test_frames_that_cannot_be_imaged_are_bad_and_it_goes_on() -> None:
    huge = clradar.Capture(np.full((94, 94, 8), 3e38, np.complex64), QAR50, WAVEFORM)
    shown, _, counts = live([point(0.300), huge, point(0.304)])
    assert [one.label for one in shown] == ["frame 0", "frame 2"]
    assert (counts.arrived, counts.bad) == (3, 1)
    assert counts.reason.startswith("frame 1: ")
    assert "bad, the last: frame 1" in state_words(shown[-1].pace, counts)


def test_it_ends_after_enough_frames() -> None:
    shown, pace, _ = live([point(0.300)] * 3, most=2)
    assert len(shown) == pace.shown == 2


def test_the_picture_is_as_the_radar_sees_it() -> None:
    depth_m = np.full((40, 80), np.nan)
    depth_m[30:, :20] = 0.30  # up, and to the right as the radar sees it
    depth_m[:10, 60:] = 0.32
    x_m, y_m = 1e-3 * np.arange(80), 1e-3 * np.arange(40)
    image = clradar.DepthMap(depth_m, np.ones((40, 80)), x_m, y_m)
    console = Console(width=100, color_system="truecolor", force_terminal=True)
    lines = console.render_lines(blocks(image), pad=False)
    rows = [line for line in lines if any(segment.text.strip() for segment in line)]
    colours = [
        [segment.style for segment in row for _ in segment.text] for row in rows
    ]  # one per column
    assert {len(row) for row in colours} == {MOST_COLUMNS}
    assert len(rows) == MOST_COLUMNS // 4  # half as high as wide, two rows in a line
    top_right, bottom_left = colours[0][-1], colours[-1][0]
    top_left, bottom_right = colours[0][0], colours[-1][-1]
    assert top_left == bottom_right
    near, far, none = (
        tuple(style.color.get_truecolor()) for style in (top_right, bottom_left, top_left)
    )
    assert none == (0, 0, 0)
    assert near[0] > 200 > 100 > far[1]  # yellow and violet
