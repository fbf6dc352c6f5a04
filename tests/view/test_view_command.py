"""``clradar view``: sources, the line with the address, what it needs, how it ends."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from fronts import capture, frames, volume
from nightly import nightly
from systems import posix_only

import clradar
from clradar.errors import MeasurementError
from clradar.hand import JOINT_NAMES
from clradar.view import server
from clradar.view.server import MissingViser, serving
from clradar.view.session import View
from clradar.view.sources import open_source
from clradar.view.truth import recording_truth
from clradar.view.wish import Wish
from measurement_io import save_capture, save_recording, save_volume


def test_sources(tmp_path):
    captures = [capture(1.0), capture(2.0)]
    save_recording(tmp_path / "plate/30", captures, timestamps_us=[0, 125_000])
    save_capture(tmp_path / "capture.h5", captures[1])
    save_volume(tmp_path / "volume.h5", volume())
    recording = open_source(tmp_path / "plate/30")
    assert [recording.label(i) for i in recording.frames()] == ["frame 0", "frame 1"]
    assert recording.read(1).data[0, 0, 0] == 2.0
    single = open_source(tmp_path / "capture.h5")
    assert (single.frames(), single.label(0)) == ((0,), "capture.h5")
    assert single.read(0).data.shape == (2, 1, 3)
    assert isinstance(open_source(tmp_path / "volume.h5").read(0), clradar.Volume)
    with pytest.raises(MeasurementError, match="nothing there"):
        open_source(tmp_path / "absent.h5")


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
    with pytest.raises(MissingViser, match=r"pip install viser"), serving(view):
        pass


def test_the_address_is_of_this_machine_alone(monkeypatch):
    def nameless():
        raise KeyError("getpwuid(): uid not found: 4711")

    monkeypatch.setattr("getpass.getuser", nameless)
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
