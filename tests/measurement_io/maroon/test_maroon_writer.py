"""Recordings that are written: what the dataset's own reader would find, and what is never left."""

import json
import pickle
import pickletools
import struct

import maroon_files as files
import numpy as np
import pytest
from comparisons import same_bits, tree

import clradar
from clradar.errors import MeasurementError, ModelError, OutputError
from measurement_io import open_capture, save_recording
from measurement_io.maroon import writer


def capture_of(seed, frequencies_hz=(72e9, 77e9, 82e9), meta=None):
    waveform = clradar.Waveform(frequencies_hz)
    data = files.expected_data(files.random_frame(waveform.n_freq, seed=seed))
    return clradar.Capture(data, clradar.arrays.qar50(), waveform, meta or {})


def captures_of(n):
    return [capture_of(i, meta={"timestamp_us": 1000 + i, "gain": 0.5 + i}) for i in range(n)]


def dataset_reader(radar):
    """Read a radar folder as the dataset's program does, by the description of the form.

    Frame 0 says how many there are; of each, the four keys are taken, the imaging channels are
    1 to 94, and the time stamp is the first of an array.
    """

    def load(number):
        content = (radar / "calibrated_data" / f"{number:06d}.npy").read_bytes()
        assert content[:8] == b"\x93NUMPY\x01\x00"
        (length,) = struct.unpack("<H", content[8:10])
        header = content[10 : 10 + length].decode()
        assert "'descr': '|O'" in header
        assert "'shape': ()" in header
        assert (10 + length) % 64 == 0
        # The test has just written these bytes itself.
        frame = pickle.loads(content[10 + length :]).item()
        assert frame["xr"].shape == (96, 96, len(frame["fvec"]))
        return {
            "imaging": frame["xr"][1:95, 1:95, :],
            "unused": np.delete(frame["xr"], slice(1, 95), axis=0),
            "fvec": frame["fvec"],
            "total": int(frame["number_of_measurements"]),
            "time_s": frame["timestamp_us"][0].item() * 1e-6,
        }

    first = load(0)
    return [first, *(load(i) for i in range(1, first["total"]))]


# ---- what is written


def test_the_datasets_reader_finds_what_was_captured(tmp_path):
    captures = captures_of(3)
    radar = save_recording(tmp_path / "hand" / "30", captures)
    assert radar == tmp_path / "hand" / "30" / "radar_72.0_82.0_3"
    found = dataset_reader(radar)
    assert len(found) == 3
    for i, (frame, capture) in enumerate(zip(found, captures, strict=True)):
        for rx, tx, n in ((0, 0, 0), (93, 5, 1), (7, 93, 2)):
            assert frame["imaging"][rx, tx, n] == capture.data[tx, rx, n]
        assert same_bits(np.ascontiguousarray(frame["imaging"].transpose(1, 0, 2)), capture.data)
        assert not frame["unused"].any()
        assert same_bits(frame["fvec"], np.array(capture.waveform.frequencies_hz))
        assert frame["total"] == 3
        assert frame["time_s"] == (1000 + i) * 1e-6
    content = json.loads((radar / "calibration.json").read_text())
    numbers = {"frequency_low_ghz": 72.0, "frequency_high_ghz": 82.0, "frequency_points": 3}
    assert list(content.items())[:3] == list(numbers.items())
    assert list(content)[3:] == ["000000", "000001", "000002"]
    names = [
        argument
        for operation, argument, _ in pickletools.genops(
            (radar / "calibrated_data" / "000000.npy").read_bytes()[128:]
        )
        if operation.name in ("GLOBAL", "STACK_GLOBAL")
    ]  # those that every numpy finds
    assert names == ["numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"]


def test_files_beside_the_radar_folder(tmp_path):
    mesh = tmp_path / "mesh_smoothed.obj"
    mesh.write_text("v 0 0 0\n")
    beside = {
        "metadata": {"distance_meters": 0.3},
        "alignment": {"photogrammetry2radar": np.eye(4).tolist()},
    }
    save_recording(tmp_path / "30", captures_of(1), **beside, meshes=[mesh])
    for name, content in beside.items():
        assert json.loads((tmp_path / "30" / f"{name}.json").read_text()) == content
    copied = tmp_path / "30" / "photogrammetry" / "mesh_smoothed.obj"
    assert copied.read_bytes() == mesh.read_bytes()
    with pytest.raises(MeasurementError, match="nothing there"):
        save_recording(tmp_path / "40", captures_of(1), meshes=[tmp_path / "no.obj"])
    with pytest.raises(ModelError, match=r"metadata\.json"):
        save_recording(tmp_path / "40", captures_of(1), metadata={"a": float("nan")})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["30", "mesh_smoothed.obj"]


# ---- what is refused, and what is left then

FIRST = capture_of(0)
SWAPPED = clradar.AntennaArray(FIRST.array.rx_m, FIRST.array.tx_m, "swapped")


@pytest.mark.parametrize(
    ("captures", "found"),
    [
        ([], "no|none"),
        ([FIRST, clradar.Capture(FIRST.data, SWAPPED, FIRST.waveform)], "swapped"),
        ([FIRST, capture_of(1, [72e9, 77e9 + 1e6, 82e9])], r"captures\[1\].*other steps"),
        ([FIRST, capture_of(1, [72e9, 82e9])], "2 from 72 to 82 GHz"),
        ([FIRST, "frame"], "Capture"),
    ],
)
def test_frames_that_do_not_belong_together(tmp_path, captures, found):
    for given, stamps in ((captures, None), (iter(captures), [0] * len(captures))):
        with pytest.raises(ModelError, match=found):
            save_recording(tmp_path / "hand" / "30", given, timestamps_us=stamps)
        assert not (tmp_path / "hand" / "30").exists()
        assert not [*tmp_path.rglob("*.tmp"), *tmp_path.rglob("*.npy")]


def test_frames_are_counted_before_they_are_written(tmp_path):
    for captures, stamps, found in (
        (iter([FIRST]), None, "expected a list, or time stamps"),
        ([FIRST], [0, 1], "expected 2, one for each"),
        ([FIRST, FIRST], [0], "expected at most 1"),
    ):
        with pytest.raises(ModelError, match=found):
            save_recording(tmp_path / "30", captures, timestamps_us=stamps)
    assert not [*tmp_path.iterdir()]


def test_a_folder_that_exists(tmp_path, monkeypatch):
    target = tmp_path / "30"
    target.mkdir()
    radar = save_recording(target, captures_of(2))  # an empty one is as good as none
    (target / "kinect").mkdir()
    (target / "kinect" / "rgb.png").write_bytes(b"theirs")
    (target / "metadata.json").write_bytes(b"{}")
    (radar / "depth").mkdir()
    before = tree(target)
    with pytest.raises(OutputError, match="force"):
        save_recording(target, captures_of(1))
    with pytest.raises(ModelError, match="captures"):
        save_recording(target, [capture_of(0), capture_of(1, [72e9])], force=True)
    with monkeypatch.context() as patch:
        patch.setattr(writer, "_refuse_existing", lambda *_, **__: None)  # it came after the look
        with pytest.raises(OutputError, match="cannot be written"):
            save_recording(target, captures_of(1))
    assert tree(target) == before

    save_recording(target, [capture_of(5)], metadata={"a": 1}, force=True)
    after = tree(target)
    assert after["kinect/rgb.png"] == b"theirs"
    assert json.loads(after["metadata.json"]) == {"a": 1}
    assert [n for n in after if n.endswith(".npy")] == [f"{radar.name}/calibrated_data/000000.npy"]
    assert same_bits(open_capture(target).data, capture_of(5).data)
    assert not (radar / "depth").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["30"]
