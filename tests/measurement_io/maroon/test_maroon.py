"""Recorded frames: what is read, and that nothing hostile or damaged gets through."""

import pickle
from dataclasses import replace
from functools import partial

import maroon_files as files
import numpy as np
import pytest
from comparisons import refusal, same_bits

import clradar
from clradar.errors import MeasurementError, ModelError
from measurement_io import (
    check_file,
    open_capture,
    open_recording,
    save_recording,
)

refused = partial(refusal, open_capture)


# ---- what is read


@pytest.mark.parametrize("spelling", files.SPELLINGS)
@pytest.mark.parametrize("protocol", files.PROTOCOLS)
def test_every_protocol_and_spelling(tmp_path, protocol, spelling):
    frame = files.random_frame()
    frame |= {"complex": 1 + 2j, "gain": np.float32(0.5), "z": np.complex64(1j), "note": "hand"}
    raw = files.pickled(frame, protocol, spelling)
    other = {"numpy.core": b"numpy._core.", "numpy._core": b"numpy.core."}[spelling]
    assert other not in raw, "the helper did not rewrite the names"
    path = tmp_path / "000000.npy"
    path.write_bytes(files.npy(raw))

    capture = open_capture(path)

    assert same_bits(capture.data, files.expected_data(frame))
    assert same_bits(capture.waveform.frequencies_hz, frame["fvec"])
    assert capture.meta == {
        "source": str(path),
        "format": "maroon",
        "frame": 0,
        "variant": "raw",
        "timestamp_us": 1_700_000_000_000_123,
        "number_of_measurements": 3,
        "gain": 0.5,
        "note": "hand",
    }


def test_folder_frame_and_variant(tmp_path):
    radar = files.write_recording(tmp_path / "hand" / "30")
    for source in (radar, radar.parent):
        for frame, variant, seed in ((0, "raw", 0), (1, "raw", 1), (1, "emptyfiltered", 101)):
            capture = open_capture(source, frame=frame, variant=variant)
            assert same_bits(capture.data, files.expected_data(files.random_frame(seed=seed)))
            assert (capture.meta["frame"], capture.meta["variant"]) == (frame, variant)
    first = files.expected_data(files.random_frame(seed=0))
    assert same_bits(open_capture(radar).data, first)
    assert "0-1" in refused(radar, frame=2)


def test_keys_of_no_use_are_left_out(tmp_path):
    frame = files.random_frame() | {
        "settings": {"a": [1, (2, 3)]},
        "when": np.array(["2024-01-01"], dtype="datetime64[D]"),
        "rows": np.zeros(2, dtype=[("a", "f4")]),
        "objects": np.array([{}, None], dtype=object),
        "not_finite": float("nan"),
        "frame": 77,
        5: 6,
    }
    meta = open_capture(files.write_frame(tmp_path / "f.npy", frame)).meta
    assert set(meta) == {
        *("source", "format", "frame", "variant", "timestamp_us", "number_of_measurements"),
        "file_frame",
    }
    assert (meta["frame"], meta["file_frame"]) == (None, 77)


# ---- antenna files


def antenna_text(rows: np.ndarray, header: str = "x,y,z") -> str:
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def test_antenna_files(tmp_path):
    frame = files.write_frame(tmp_path / "f.npy", files.random_frame())
    rows = 0.1 * np.random.default_rng(0).normal(size=(96, 3))
    (tmp_path / "Rx.dat").write_text(antenna_text(rows))
    (tmp_path / "Tx.dat").write_text(antenna_text(rows[1:95] + 1))
    array = open_capture(frame, rx_file=tmp_path / "Rx.dat", tx_file=tmp_path / "Tx.dat").array
    assert same_bits(array.rx_m, rows[1:95])
    assert same_bits(array.tx_m, rows[1:95] + 1)
    array = open_capture(frame, rx_file=tmp_path / "Rx.dat").array
    assert same_bits(array.tx_m, clradar.arrays.qar50().tx_m)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (antenna_text(np.zeros((95, 3))), "95 rows"),
        (antenna_text(np.zeros((96, 3)), "a,b,c"), "a,b,c"),
        (antenna_text(np.full((96, 3), np.nan)), "NaN"),
        (antenna_text(np.zeros((96, 2))), "row 0"),
        (antenna_text(np.zeros((96, 3))).replace("0.0", "zero", 1), "zero"),
        ("", "empty"),
    ],
)
def test_bad_antenna_files(tmp_path, content, found):
    frame = files.write_frame(tmp_path / "f.npy", files.random_frame())
    (tmp_path / "Rx.dat").write_text(content)
    with pytest.raises(MeasurementError, match=r"Rx\.dat") as caught:
        open_capture(frame, rx_file=tmp_path / "Rx.dat")
    assert found in str(caught.value)


# ---- what disagrees


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"xr": np.zeros((95, 96, 2), np.complex64)}, "(95, 96, 2)"),
        ({"xr": np.zeros((96, 96), np.complex64)}, "(96, 96)"),
        ({"xr": np.zeros((96, 96, 2), np.float32)}, "float32"),
        ({"xr": np.zeros((96, 96, 3), np.complex64)}, "3 in 'xr', 2 in 'fvec'"),
        ({"xr": np.zeros((96, 96, 0), np.complex64), "fvec": np.zeros(0)}, "(0,)"),
        ({"xr": [1, 2]}, "another type"),
        ({"fvec": np.array([72e9, np.nan])}, "NaN"),
        ({"fvec": np.array([[72e9, 82e9]])}, "(1, 2)"),
        ({"fvec": np.array([72.0, 82.0])}, "got 72"),  # gigahertz
        ({"number_of_measurements": 2.5}, "2.5"),
        ({"number_of_measurements": np.array([1, 2])}, "[1, 2]"),
        ({"number_of_measurements": "many"}, "many"),
    ],
)
def test_wrong_contents(tmp_path, change, found):
    path = files.write_frame(tmp_path / "f.npy", files.random_frame() | change)
    assert found in refused(path)


@pytest.mark.parametrize(
    ("value", "found"),
    [(np.nan, "1 of 17672"), (complex(0, np.inf), "1 of 17672"), (1e60, "an overflow")],
)
def test_values_that_complex64_cannot_hold(tmp_path, value, found):
    frame = files.random_frame()
    frame["xr"] = frame["xr"].astype(np.complex128)
    frame["xr"][40, 50, 1] = value
    assert found in refused(files.write_frame(tmp_path / "f.npy", frame))


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("radar_72.0_82.0_3", "2 in 'xr', 2 in 'fvec', 3 in the folder's name"),
        ("radar_72.0_81.0_2", "72 to 82 GHz"),
    ],
)
def test_folder_name_disagrees(tmp_path, name, found):
    radar = files.write_recording(tmp_path, name=name)
    assert found in refused(radar / "calibrated_data" / "000000.npy")


# ---- damaged files, of which tests/files has the hostile pickles


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        b"MATLAB 5.0 MAT-file",
        files.npy(files.pickled({}), descr="<f8", shape="(4,)"),
        files.npy(files.pickled({}), shape="(1,)"),
        files.npy(pickle.dumps({"xr": 1}, 4)),
        b"\x93NUMPY\x03\x00" + files.npy(b"")[8:],
        b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16,
    ],
    ids=range(8),
)
def test_other_files(tmp_path, content):
    path = tmp_path / "000000.npy"
    path.write_bytes(content)
    refused(path)
    assert not check_file(path).ok


# ---- write


@pytest.fixture
def capture():
    data = files.expected_data(files.random_frame(5))
    return clradar.Capture(data, clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 5))


def test_other_antennas_lie_beside_their_frames_which_are_of_one_array(tmp_path, capture):
    pattern = clradar.AntennaPattern(exponent=1.0)
    array = clradar.AntennaArray(capture.array.rx_m[:5], capture.array.tx_m[:4], "few", pattern)
    other = clradar.Capture(capture.data[:5, :4], array, capture.waveform)
    radar = save_recording(tmp_path / "30", [other, other])
    path = radar / "calibrated_data" / "000000.npy"
    for read in (open_capture(path), open_recording(tmp_path / "30")[1]):
        np.testing.assert_array_equal(read.data, other.data)
        np.testing.assert_array_equal(read.array.tx_m, array.tx_m)
        assert (read.array.name, read.array.tx_pattern) == ("few", pattern)
    gains = replace(other, array=replace(array, tx_gain=[1, 1, 1, 1, 0.5]))
    with pytest.raises(ModelError, match="other gains or patterns"):
        save_recording(tmp_path / "60", [other, gains])
    (radar / "antennas.toml").unlink()
    with pytest.raises(MeasurementError, match=r"\(96, 96, Nf\) or \(94, 94, Nf\)"):
        open_capture(path)
