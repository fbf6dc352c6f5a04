"""The native HDF5 file: bit for bit there and back, or one clear error; it alone is opened."""

import dataclasses
import json
import re
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import silx.io
from comparisons import refusal, same_record
from silx.io import nxdata

import clradar
from clradar import AntennaPattern
from clradar.errors import ModelError
from clradar.model import ImageScale
from measurement_io import (
    check_file,
    describe,
    open_capture,
    open_volume,
    save_capture,
    save_volume,
)

META = {
    "seed": 7,
    "alpha": 0.1,
    "big": 2**70,
    "nothing": None,
    "flags": [True, False, {"deep": [1.5, "ünïcödé \x00 \ud800"]}],
    "device": {"name": "pocl"},
}


def small_capture(n_tx=3, n_rx=2, n_freq=5, **meta):
    rng = np.random.default_rng(n_tx)
    data = rng.normal(size=(n_tx, n_rx, n_freq, 2)).astype(np.float32) @ np.array([1, 1j], "c8")
    # What a careless conversion would change: negative zero and subnormal numbers.
    data[0, 0, 0] = complex(-0.0, 1e-42)
    tx_m, rx_m = 0.1 * rng.normal(size=(n_tx, 3)), 0.1 * rng.normal(size=(n_rx, 3))
    array = clradar.AntennaArray(tx_m, rx_m, "läb 1")
    frequencies = 60e9 + np.cumsum(rng.uniform(1.0, 1e9, n_freq))
    return clradar.Capture(data, array, clradar.Waveform(frequencies), meta)


CAPTURE = small_capture()
GRID = clradar.VoxelGrid([-0.1, 0.2, 1 / 3], [1e-3, 0.1 / 3, 0.7e-3], (4, 3, 2))
VOLUME = clradar.Volume(
    np.random.default_rng(0).normal(size=(*GRID.shape, 2)) @ [1, 1j], GRID, {"method": "exact"}
)


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "capture.h5"
    save_capture(target, CAPTURE)
    return target


# ---- there and back

TABLE = AntennaPattern(angle_deg=[0, 90, 180], field=[1, 0.5, 0])
COSINE = AntennaPattern(3.5, 1.5)


@pytest.mark.parametrize(
    ("capture", "patterns", "version"),
    [
        (small_capture(1, 1, 1, **META), (None, None), 1),
        (small_capture(7, 300, 97, **META), (None, None), 1),
        (CAPTURE, (COSINE, None), 2),  # refused by programs that know version 1 alone
        (CAPTURE, (TABLE, COSINE), 2),
    ],
)
def test_capture_round_trip(tmp_path, capture, patterns, version):
    tx, rx = patterns
    array = dataclasses.replace(capture.array, tx_pattern=tx, rx_pattern=rx)
    saved = dataclasses.replace(capture, array=array)
    file = tmp_path / "c.anything"
    save_capture(file, saved)
    read = open_capture(file)
    assert same_record(read, saved)
    assert not read.data.flags.writeable
    assert check_file(file).ok
    with silx.io.open(str(file)) as content:
        assert content.attrs["clradar_version"] == version
        shown = nxdata.get_default(content)
        assert (shown.group.name, shown.axes_names[2]) == ("/entry/data", "frequency (Hz)")
        assert (shown.interpretation, bool(shown.title)) == ("spectrum", True)
        data = content["entry/data/data"]
        assert (data.shuffle, data.fletcher32) == (True, True)
    words = str(describe(file))
    assert ("Tx pattern" in words) is (tx is not None)
    assert ("3.5 dBi, cos^1.5" in words) is (COSINE in patterns)


@pytest.mark.parametrize("scaled", [False, True])
def test_volume_round_trip(tmp_path, scaled):
    array = dataclasses.replace(CAPTURE.array, rx_pattern=COSINE)
    scale = ImageScale(array, clradar.Waveform([76e9, 77e9]), [0.5, 1.0]) if scaled else None
    file, saved = tmp_path / "v.h5", dataclasses.replace(VOLUME, scale=scale)
    save_volume(file, saved)
    read = open_volume(file)
    assert same_record(read, saved)
    assert read.absolute == scaled
    assert check_file(file).ok
    with silx.io.open(str(file)) as content:
        shown = nxdata.get_default(content)
        assert (shown.group.name, shown.interpretation) == ("/entry/max_projection", "image")
        assert (shown.plot_style.signal_scale_type, bool(shown.title)) == ("log", True)
        np.testing.assert_array_equal(shown.signal[()], np.abs(saved.data).max(axis=0))
        depth, whole = (nxdata.NXdata(content["entry"][name]) for name in ("depth_map", "data"))
        assert (depth.signal_name, depth.interpretation) == ("depth (m)", "image")
        assert whole.interpretation == "image"
        assert [label[-5:] for label in whole.axes_names] == ["z (m)", "y (m)", "x (m)"]
        assert json.loads(content["entry/provenance/data"][()]) == VOLUME.meta
    if scale is None:
        return
    with h5py.File(file, "r+") as content:
        assert content.attrs["clradar_version"] == 2
        content["entry/data"].attrs["array_name"] = "another"
    assert "damaged" in refusal(open_volume, file)


def write_by_hand(target, order="<", **root):
    """Write a capture as the documentation says, with nothing that is optional."""
    attributes = {"clradar_format": "capture", "clradar_version": 1, "provenance": "{}"}
    array = CAPTURE.array
    values = {"data": CAPTURE.data, "tx_m": array.tx_m, "rx_m": array.rx_m}
    values["frequency_hz"] = CAPTURE.waveform.frequencies_hz
    with h5py.File(target, "w") as file:
        file.attrs.update(attributes | {"created": "2024-05-06T07:08:09+00:00"} | root)
        group = file.create_group("entry/data")
        group.attrs["array_name"] = array.name
        for name, value in values.items():
            group[name] = value.astype(value.dtype.newbyteorder(order))


@pytest.mark.parametrize("order", ["<", ">"])
def test_either_byte_order_and_fixed_length_text(tmp_path, order):
    write_by_hand(tmp_path / "c.h5", order, clradar_format=np.bytes_("capture"))
    assert same_record(open_capture(tmp_path / "c.h5"), CAPTURE)
    named = [problem.split(":")[0] for problem in check_file(tmp_path / "c.h5").problems]
    assert named == [f"/entry/data/{name}" for name in ("frequency_hz", "tx_m", "rx_m", "data")]


@pytest.mark.parametrize("name", ["nul\0", "\ud800"])
def test_array_name_that_hdf5_cannot_hold(tmp_path, name):
    array = clradar.AntennaArray(CAPTURE.array.tx_m, CAPTURE.array.rx_m, name)
    with pytest.raises(ModelError, match="name"):
        save_capture(tmp_path / "c.h5", clradar.Capture(CAPTURE.data, array, CAPTURE.waveform))
    assert list(tmp_path.iterdir()) == []


# ---- what is refused


def change(path, action):
    with h5py.File(path, "r+") as file:
        action(file)


def refusals(path):
    """What is said of the file by reading and by checking it."""
    report = check_file(path)
    assert not report.ok
    return [refusal(open_capture, path), *report.problems]


def replace(name, **options):
    def action(file):
        del file["entry/data"][name]
        file["entry/data"].create_dataset(name, **options)

    return action


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def with_last(name, value):
    def action(file):
        flat = file["entry/data"][name]
        content = flat[()]
        content.flat[-1] = value
        flat[...] = content

    return action


@pytest.mark.parametrize(
    ("action", "found"),
    [
        (attribute("clradar_version", 4), "newer clradar"),
        (attribute("clradar_version", 1.5), "whole number"),
        (attribute("clradar_format", "volume"), "open_volume"),
        (attribute("clradar_format", ["capture"]), "one string"),
        (attribute("provenance", '{"seed": 2}'), "damaged"),
        (lambda f: f.attrs.__delitem__("clradar_format"), "another program"),
        (lambda f: f.attrs.__delitem__("provenance"), "/@provenance"),
        (lambda f: f["entry/data"].attrs.__delitem__("array_name"), "array_name"),
        (lambda f: f.__delitem__("entry/data/data"), "/entry/data/data"),
        (replace("data", data=np.zeros((3, 2, 5), np.complex128)), "complex128"),
        (replace("data", data=np.zeros((3, 2, 4), np.complex64)), "(3, 2, 4)"),
        (replace("data", data=h5py.Empty("c8")), "shape None"),
        (replace("data", shape=(3, 2, 5), dtype=h5py.string_dtype()), "object"),
        (replace("tx_m", data=np.zeros((0, 3))), "at least one"),
        (replace("frequency_hz", data=np.arange(5)), "int64"),
        (with_last("data", complex(0, np.nan)), "1 of 30"),
        (with_last("frequency_hz", 1.0), "ascending"),
        (replace("data", data=np.zeros((3, 2, 5), "c8"), compression="gzip"), "filter 1"),
        # nothing stored: HDF5 would hand out fill values
        (replace("data", shape=(3, 2, 5), dtype="c8"), "0"),
        (replace("data", shape=(3, 2, 5), dtype="c8", chunks=(1, 2, 5)), "3 chunks"),
        # bombs: 8 TB that the file does not hold
        (replace("data", shape=(3, 2, 2**40), dtype="c8", chunks=(1, 1, 2**20)), ""),
        (replace("tx_m", shape=(2**50, 3), dtype="f8", chunks=(2**20, 3)), "to fit"),
    ],
)
def test_changed_file(path, action, found):
    change(path, action)
    said, problem, *_ = refusals(path)
    assert found in said
    assert path.name in problem


@pytest.mark.parametrize("text", ["", "[1]", '{"a": NaN}', np.bytes_(b'{"a": "\xff"}')])
def test_provenance_that_is_no_json_object(tmp_path, text):
    write_by_hand(tmp_path / "c.h5", provenance=text)
    refusal(open_capture, tmp_path / "c.h5")


def test_files_that_are_no_volume(tmp_path, path):
    assert "open_capture" in refusal(open_volume, path)
    path.write_text("text")
    assert "HDF5" in refusal(open_volume, path)
    refusal(open_volume, tmp_path / "nothing")


def test_volume_whose_axes_disagree(tmp_path):
    save_volume(tmp_path / "v.h5", VOLUME)
    with h5py.File(tmp_path / "v.h5", "r+") as file:
        file["entry/data/x_m"][1] += 1e-6
    assert "x_m" in refusal(open_volume, tmp_path / "v.h5")


def test_every_bit_of_the_data_counts(path):
    whole = path.read_bytes()
    with h5py.File(path) as file:
        ids = [file["entry/data"][name].id for name in ("data", "tx_m", "rx_m", "frequency_hz")]
        chunks = [i.get_chunk_info(0) for i in ids]
    for chunk in chunks:
        for at in range(chunk.byte_offset, chunk.byte_offset + chunk.size, 23):
            damaged = bytearray(whole)
            damaged[at] ^= 1
            path.write_bytes(damaged)
            refusal(open_capture, path)


_FOREIGN_FILTER = 32013
"""A registered filter (ZFP) that neither HDF5 nor h5py brings along."""


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A capture, and next to it a folder with what it must not open."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    save_capture("out/other.h5", CAPTURE)
    Path("out/secret.raw").write_bytes(CAPTURE.data.tobytes())
    save_capture("capture.h5", CAPTURE)
    return tmp_path / "capture.h5"


def hide_data(file):
    file.move("entry/data/data", "hidden")
    return file["entry/data"]


def external_link(file):
    hide_data(file)["data"] = h5py.ExternalLink("out/other.h5", "/entry/data/data")


def external_storage(file):
    storage = [("out/secret.raw", 0, h5py.h5f.UNLIMITED)]
    hide_data(file).create_dataset("data", (3, 2, 5), "c8", external=storage)


def virtual_dataset(file):
    layout = h5py.VirtualLayout((3, 2, 5), np.complex64)
    layout[...] = h5py.VirtualSource("out/other.h5", "/entry/data/data", (3, 2, 5))
    hide_data(file).create_virtual_dataset("data", layout)


@pytest.mark.parametrize(
    "action", [external_link, external_storage, virtual_dataset], ids=lambda action: action.__name__
)
def test_what_lies_in_other_files_is_refused(beside, action):
    """The process that reads can open no other file (tests/files/confined)."""
    change(beside, action)
    with h5py.File(beside) as trusting:
        assert trusting["entry/data/data"][()].shape == (3, 2, 5)
    assert all("expected" in text for text in refusals(beside))


def test_filters_of_others_are_refused(beside):
    # In the earliest form of HDF5, whose structures have no checksums.
    with h5py.File("plain.h5", "w") as file, h5py.File(beside) as saved:
        saved.copy("entry", file)
        file.attrs.update(saved.attrs)
        group = hide_data(file)
        made = group.create_dataset("data", (3, 2, 5), "c8", chunks=(3, 2, 5), shuffle=True)
        made.id.write_direct_chunk((0, 0, 0), CAPTURE.data.tobytes())
    content = Path("plain.h5").read_bytes()
    # Of a filter its number, the length of its name, flags, how many parameters, and its name.
    (known,) = re.findall(rb"\x02\x00\x08\x00.\x00\x01\x00shuffle\x00", content)
    beside.write_bytes(content.replace(known, struct.pack("<H", _FOREIGN_FILTER) + known[2:]))
    assert all(f"filter {_FOREIGN_FILTER}" in text for text in refusals(beside))
