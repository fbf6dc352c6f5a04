"""Files such as labs write them, by other programs than the readers under test."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

import clradar

CONTAINERS = (
    "npz",
    "npz deflated",
    "hdf5",
    "hdf5 gzip",
    "hdf5 lzf",
    "mat v5",
    "mat v5 deflated",
    "mat v7.3",
)

Tree = Mapping[str, Any]


def random_capture(n_tx: int = 5, n_rx: int = 4, n_freq: int = 6, seed: int = 0) -> clradar.Capture:
    """Positions are multiples of 5 mm, which every unit of length gives exactly."""
    rng = np.random.default_rng(seed)
    data = rng.standard_normal((n_tx, n_rx, n_freq, 2)).astype(np.float32) @ [1, 1j]
    array = clradar.AntennaArray(
        rng.integers(-14, 15, (n_tx, 3)) * 5 / 1e3,
        rng.integers(-14, 15, (n_rx, 3)) * 5 / 1e3,
        "lab",
    )
    waveform = clradar.Waveform(np.linspace(72, 82, n_freq) * 1e9)
    return clradar.Capture(data.astype(np.complex64), array, waveform)


def write(container: str, path: Path, tree: Tree) -> Path:
    """Write arrays, text and (nested) mappings of them; `path` has no meaning to the readers."""
    if container.startswith("npz"):
        save = np.savez_compressed if "deflated" in container else np.savez
        with open(path, "wb") as file:
            save(file, **{key: np.asarray(value) for key, value in tree.items()})
    elif container.startswith("mat v5"):
        with open(path, "wb") as file:
            scipy.io.savemat(file, dict(tree), do_compression="deflated" in container)
    elif container == "mat v7.3":
        write_mat73(path, tree)
    else:
        filters = {
            "hdf5": {},
            "hdf5 gzip": {"compression": "gzip", "shuffle": True, "fletcher32": True},
            "hdf5 lzf": {"compression": "lzf", "shuffle": True},
        }[container]
        with h5py.File(path, "w") as file:
            _fill(file, tree, filters)
    return path


def _fill(group: h5py.Group, tree: Tree, filters: Mapping[str, Any]) -> None:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            _fill(group.create_group(key), value, filters)
        elif isinstance(value, str) or np.ndim(value) == 0:
            group[key] = value
        else:
            group.create_dataset(key, data=value, **filters)


def write_mat73(path: Path, tree: Tree) -> None:
    """Write what MATLAB's save -v7.3 writes: its block of 512 bytes, axes reversed, classes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _fill_matlab(file, tree)
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Mar  3 10:11:12 2025 HDF5 "
    with open(path, "r+b") as raw:
        raw.write(text.ljust(116) + bytes(8) + b"\x00\x02IM")


def _fill_matlab(group: h5py.Group, tree: Tree) -> None:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            inner = group.create_group(key)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            _fill_matlab(inner, value)
            continue
        if isinstance(value, str):
            array = np.array([[ord(c)] for c in value], np.uint16)
            name = "char"
        else:
            array = np.atleast_2d(np.asarray(value)).transpose()
            name = {"c8": "single", "f4": "single", "i2": "int16"}.get(
                array.dtype.str[1:], "double"
            )
        if array.dtype.kind == "c":
            part = array.real.dtype.str
            pairs = np.empty(array.shape, [("real", part), ("imag", part)])
            pairs["real"], pairs["imag"] = array.real, array.imag
            array = pairs
        chunks = (max(1, array.shape[0] // 8), *array.shape[1:])
        made = group.create_dataset(key, data=array, chunks=chunks, compression="gzip")
        made.attrs["MATLAB_class"] = np.bytes_(name)


def layout(folder: Path, text: str) -> Path:
    """Write a layout file and return its path."""
    with tempfile.NamedTemporaryFile(
        "w", dir=folder, prefix="lab", suffix=".toml", delete=False, encoding="utf-8"
    ) as file:
        file.write(text)
    return Path(file.name)
