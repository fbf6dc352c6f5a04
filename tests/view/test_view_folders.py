"""Sources of the live view, folders that change while it looks, and how the command ends."""

import json
import math
import signal
import subprocess
import sys

import numpy as np
import pytest
from fronts import Front, capture, frames, session_of, volume
from nightly import nightly
from systems import posix_only

from clradar.errors import MeasurementError, MissingPackage
from clradar.hand import JOINT_NAMES
from clradar.view import server
from clradar.view.playing import Player
from clradar.view.server import serving
from clradar.view.session import View
from clradar.view.sources import open_source, recording_truth
from clradar.view.wish import Wish
from measurement_io import save_recording, save_volume


class Watched(Front):
    """A folder, and what a view of it says and shows."""

    def __init__(self, folder):
        super().__init__()
        self.folder = folder
        self.peaks: list[float] = []
        source = open_source(folder, watch=True)
        self.source = source
        self.player = Player(View(source=source, wish=Wish(frame=-1)), self)

    def show(self, shown):
        self.peaks.append(float(shown.first.image.amplitude.max()))
        super().show(shown)

    def write(self, name, amplitude):
        save_volume(self.folder / name, volume(amplitude), force=True)

    def look(self):
        """The amplitudes that two looks bring to be shown."""
        self.peaks.clear()
        for _ in range(2):
            self.player.look()
        self.player.settle()
        return self.peaks

    def labels(self):
        return [self.source.label(frame) for frame in self.source.frames()]


@pytest.fixture
def watched(tmp_path):
    found = Watched(tmp_path)
    yield found
    found.player.close()


def test_new_files_are_shown_as_they_come(watched):
    assert watched.source.frames() == ()
    assert watched.look() == []
    watched.write("9.h5", 9.0)
    assert watched.look() == [9.0]
    watched.write("10.h5", 10.0)
    (watched.folder / "notes.txt").write_text("no frame")
    assert watched.look() == [10.0]
    assert watched.labels() == ["9.h5", "10.h5"]
    watched.player.chosen()
    watched.player.change(frame=watched.source.frames()[0])
    watched.player.settle()
    watched.write("11.h5", 11.0)
    assert watched.look() == []  # who looks at an earlier one is left there
    assert watched.labels() == ["9.h5", "10.h5", "11.h5"]
    watched.player.play(True)
    watched.player.settle()
    assert watched.peaks == [11.0]
    said = watched.player.pace()
    assert said.startswith("2 shown, ")
    assert said.endswith(" 1 dropped")


def test_of_files_that_come_together_the_newest_is_shown(watched):
    for i in range(1, 5):
        watched.write(f"{i}.h5", i)
    assert watched.look() == [4.0]
    assert watched.player.dropped == 3
    assert "4 shown" not in watched.player.pace()


def test_a_half_written_file_is_shown_once_it_is_whole(watched):
    watched.write("whole.h5", 3.0)
    content = (watched.folder / "whole.h5").read_bytes()
    watched.look()
    half = watched.folder / "half.h5"
    half.write_bytes(content[: len(content) // 2])
    assert watched.look() == []
    assert watched.labels() == ["whole.h5"]
    _, _, reason = watched.player.pace().partition("1 bad, the last: ")
    assert "half.h5" in reason
    half.write_bytes(content)
    assert watched.look() == [3.0]
    assert watched.labels() == ["whole.h5", "half.h5"]


def test_a_folder_that_grows_without_watching_is_followed(tmp_path):
    save_volume(tmp_path / "a.h5", volume(1.0))
    source = open_source(tmp_path)
    with session_of(source, Wish()) as (session, front):
        session.play(True)
        save_volume(tmp_path / "b.h5", volume(2.0))
        while not source.grows:
            session.look()
        assert front.followed[0]
        assert session.due_s == math.inf


def test_a_folder_that_is_away_for_a_while(watched, tmp_path):
    watched.write("a.h5", 1.0)
    watched.look()
    away = tmp_path.with_name("away")
    tmp_path.rename(away)
    watched.look()
    assert "a readable folder" in watched.said[0]
    away.rename(tmp_path)
    watched.write("b.h5", 2.0)
    assert watched.look() == [2.0]


def test_frames_of_a_recording_are_watched_by_variant(tmp_path):
    save_recording(tmp_path / "plate/30", [capture()], timestamps_us=[0])
    source = open_source(tmp_path / "plate/30", watch=True)
    assert [source.label(frame) for frame in source.frames()] == ["frame 0"]
    assert source.read(0).data.shape == (2, 1, 3)
    assert not open_source(tmp_path / "plate/30", "emptyfiltered", watch=True).frames()


def test_folders_and_files_that_cannot_be_viewed(tmp_path):
    (tmp_path / "notes.txt").write_text("no frame")
    for name, watch, words in (
        ("", False, r"files \(\.h5, .*\) in the folder, got none"),
        ("notes.txt", True, "expected a folder, got a file"),
        ("absent", True, "expected a folder, got nothing there"),
        ("absent.h5", False, "nothing there"),
    ):
        with pytest.raises(MeasurementError, match=words):
            open_source(tmp_path / name, watch=watch)


@pytest.mark.parametrize(
    "frames", [None, [{"frame": 0, "hands": 1}], [{"frame": 0, "bodies": [1]}]]
)
def test_truth_of_a_recording_is_drawn_as_far_as_it_can_be_read(tmp_path, frames):
    save_recording(tmp_path / "plate/30", [capture()], timestamps_us=[0])
    assert recording_truth(tmp_path / "plate/30", str) is None
    joints = {name: [0.0, 0.1, 0.3] for name in JOINT_NAMES[1:]}
    hands = [{"pose": "A", "joints_m": joints}, {"pose": "B", "joints_m": joints}]
    made = [{"frame": 1, "hands": hands, "bodies": {"plate": (np.eye(4) / 4).tolist()}}]
    (tmp_path / "plate/30/truth").mkdir()
    (tmp_path / "plate/30/truth/truth.json").write_text(json.dumps({"frames": frames or made}))
    truth_of = recording_truth(tmp_path / "plate/30", "frame {}".format)
    assert truth_of(0) is None
    if frames is None:
        truth = truth_of(1)
        assert truth.lines == ("pose A", "pose B", "plate at (0.0, 0.0, 0.0) mm")
        np.testing.assert_array_equal(truth.joints_m[24:27, 2], [0.3, np.nan, 0.3])


def test_without_viser_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    view = View(source=frames(volume()), wish=Wish())
    with pytest.raises(MissingPackage, match=r"pip install viser"), serving(view):
        pass


def test_the_address_is_of_this_machine_alone(monkeypatch):
    monkeypatch.setattr("getpass.getuser", lambda: {}["uid not found"])
    here, tunnel = server.address_lines(8080)
    assert here.startswith("http://127.0.0.1:8080 ")
    assert "ssh -L 8080:127.0.0.1:8080 USER@" in tunnel


@posix_only
@pytest.mark.device
@pytest.mark.parametrize("number", [signal.SIGTERM, *nightly([signal.SIGINT])])
def test_it_ends_cleanly(tmp_path, number):
    pytest.importorskip("viser")
    save_volume(tmp_path / "volume.h5", volume())
    command = ["-m", "clradar", "view", "--port", "8400", str(tmp_path / "volume.h5")]
    with subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        assert process.stdout.readline().startswith("from another machine: ssh -L ")
        process.send_signal(number)
        left, errors = process.communicate()
    assert (process.returncode, left, errors) == (0, "", "")
