"""Damaged and hostile containers: one error, whatever they claim; bombs cost no memory."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from layout_files import layout, random_capture, write
from test_layouts import PLAIN, assert_same, refused, tree_of

from clradar.errors import MeasurementError
from measurement_io import open_with_layout
from measurement_io.layouts.lab_file import LabFile


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    return layout(tmp_path, PLAIN)


def test_unusual_archives(tmp_path, toml):
    good = io.BytesIO()
    np.save(good, np.zeros(3))
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.npy", good.getvalue())
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("data.npy", good.getvalue())
    assert "every key once" in refused(tmp_path / "c.npz", toml)
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.txt", "text")
        archive.writestr("data", "text")
    assert "no .npy array" in refused(tmp_path / "c.npz", toml)
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.npy", good.getvalue())
    raw = bytearray((tmp_path / "c.npz").read_bytes())
    raw[raw.index(b"PK\1\2") + 8] |= 1
    (tmp_path / "c.npz").write_bytes(raw)
    assert "encrypted" in refused(tmp_path / "c.npz", toml)


# ---- HDF5


def remade(change: Callable[[h5py.File, np.ndarray], None]) -> Callable[[Path], None]:
    """Return a writer of files whose dataset "data" is replaced by `change`."""

    def make(path: Path) -> None:
        tree = tree_of(random_capture())
        write("hdf5", path, tree)
        with h5py.File(path, "r+") as file:
            del file["data"]
            change(file, tree["data"])

    return make


def missing_chunk(file: h5py.File, data: np.ndarray) -> None:
    made = file.create_dataset("data", data.shape, "c8", chunks=(1, 4, 6))
    made[:-1] = data[:-1]


HOSTILE_HDF5 = [
    (missing_chunk, "5 chunks stored"),
    (lambda f, d: f.create_dataset("data", d.shape, "c8"), "bytes stored"),
    (lambda f, d: f.create_dataset("data", data=d.real.astype("i4"), scaleoffset=4), "filter"),
    (lambda f, d: f.create_dataset("data", d.shape, "c8", chunks=(2**9,) * 3,
                                   maxshape=(None,) * 3), "in chunks of at most"),
    (lambda f, d: f.create_group("data"), "the key 'data'"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), h5py.ref_dtype), "object"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), [("r", "f4"), ("i", "S9")]), "hold numbers"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), HOSTILE_HDF5, ids=range(len(HOSTILE_HDF5)))
def test_hostile_hdf5(tmp_path, toml, change, expected):
    remade(change)(tmp_path / "c.h5")
    assert expected in refused(tmp_path / "c.h5", toml)


def test_groups_that_hold_each_other(tmp_path, toml):
    capture = random_capture()
    path = write("hdf5", tmp_path / "c", tree_of(capture))
    with h5py.File(path, "r+") as file:
        file["again"] = file["/"]
        inner = file.create_group("a/b/c")
        inner["back"] = file["a"]
    assert_same(open_with_layout(path, toml), capture)
    with h5py.File(path, "r+") as file:
        file.create_group("/".join("abcdefghijklmnopqrstuvwxyz"))
    assert "nested" in refused(path, toml)


def test_matlab_classes_of_v73(tmp_path, toml):
    capture = random_capture()
    path = write("mat v7.3", tmp_path / "c", {**tree_of(capture), "word": "hällo"})
    with h5py.File(path, "r+") as file:
        file["#refs#/a"] = [[1.0]]
        cell = file.create_dataset("cell", data=[[file["#refs#/a"].ref]], dtype=h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        file["flag"] = np.uint8([[1]])
        file["flag"].attrs["MATLAB_class"] = np.bytes_("logical")
        file["nothing"] = np.uint64([0, 0])
        file["nothing"].attrs["MATLAB_class"] = np.bytes_("double")
        file["nothing"].attrs["MATLAB_empty"] = np.uint8(1)
        file["odd"] = [[1.0]]
        file["odd"].attrs["MATLAB_class"] = "text of variable length"
    assert_same(open_with_layout(path, toml), capture)
    found = LabFile.opened(
        path, [(name, {}) for name in ("word", "cell", "flag", "odd", "nothing")]
    )
    assert found.read("word", "a test", "text") == "hällo"
    assert not any(name.startswith("#") for name in found.keys)
    for name, kind in (("cell", "cell"), ("flag", "logical"), ("odd", "unknown form")):
        with pytest.raises(MeasurementError, match=kind):
            found.read(name, "a test")
    with pytest.raises(MeasurementError, match="hold numbers"):
        found.read("nothing", "a test")


# ---- MATLAB v5
