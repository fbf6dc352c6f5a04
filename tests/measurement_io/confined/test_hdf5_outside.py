"""Reading HDF5 opens the file and nothing else, whatever the file points to."""

import re
import struct
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from comparisons import refusal
from layout_files import random_capture
from opened_files import OpenedFiles
from systems import linux_only

from clradar.files.confined import process
from measurement_io import check_file, open_capture, save_capture

_FOREIGN_FILTER = 32013
"""A registered filter (ZFP) that neither HDF5 nor h5py brings along."""


CAPTURE = random_capture(3, 2, 5)


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A capture, and next to it a folder with what it must not open."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    save_capture("out/other.h5", CAPTURE)
    Path("out/secret.raw").write_bytes(CAPTURE.data.tobytes())
    save_capture("capture.h5", CAPTURE)
    return tmp_path / "capture.h5"


@pytest.fixture
def watch(path):
    opened = OpenedFiles(path.parent / "out")
    yield opened
    opened.close()


def change(path, action):
    with h5py.File(path, "r+") as file:
        action(file)


def refusals(path):
    """What is said of the file by reading and by checking it."""
    report = check_file(path)
    assert not report.ok
    return [refusal(open_capture, path), *report.problems]


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


def read_all(path):
    """What a reader does that trusts the file."""
    with h5py.File(path) as file:
        file["entry/data/data"][()]


@linux_only
@pytest.mark.parametrize(
    "action", [external_link, external_storage, virtual_dataset], ids=lambda action: action.__name__
)
def test_nothing_else_is_opened(path, watch, action):
    change(path, action)
    read_all(path)
    assert watch.names(), "the trap does not work: h5py alone opens nothing else"
    assert all("expected" in text for text in refusals(path))
    assert watch.names() == set()


def test_filter_plugins_are_not_loaded(path, watch, monkeypatch):
    # In the earliest form of HDF5, whose structures have no checksums.
    with h5py.File("plain.h5", "w") as file, h5py.File(path) as saved:
        saved.copy("entry", file)
        file.attrs.update(saved.attrs)
        group = hide_data(file)
        made = group.create_dataset("data", (3, 2, 5), "c8", chunks=(3, 2, 5), shuffle=True)
        made.id.write_direct_chunk((0, 0, 0), CAPTURE.data.tobytes())
    content = Path("plain.h5").read_bytes()
    # Of a filter its number, the length of its name, flags, how many parameters, and its name.
    (known,) = re.findall(rb"\x02\x00\x08\x00.\x00\x01\x00shuffle\x00", content)
    path.write_bytes(content.replace(known, struct.pack("<H", _FOREIGN_FILTER) + known[2:]))
    Path("out/libfilter.so").write_bytes(b"no library")
    process._stop_server()  # the next one has the variable from the start
    monkeypatch.setenv("HDF5_PLUGIN_PATH", str(path.parent / "out"))
    watch.names()

    trusting = "import h5py; h5py.File('capture.h5')['entry/data/data'][()]"
    subprocess.run([sys.executable, "-c", trusting], capture_output=True)
    assert "libfilter.so" in watch.names(), "the trap does not work"
    assert all(f"filter {_FOREIGN_FILTER}" in text for text in refusals(path))
    assert watch.names() == set()
    process._stop_server()
