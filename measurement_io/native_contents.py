"""What is in a native file: taken out by the process that reads it (`hdf5_process`).

Nothing but numbers, text and arrays leaves these functions; `native` makes records of them.
"""

from __future__ import annotations

import zlib
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from measurement_io import hdf5_guard
from measurement_io.failures import clean, fail

VERSION = 1
FORMATS = ("capture", "volume")
AXES = {"capture": ("tx", "rx", "frequency_hz"), "volume": ("z_m", "y_m", "x_m")}
DATASETS = {
    "capture": ("data", "tx", "rx", "frequency_hz", "tx_m", "rx_m"),
    "volume": ("data", "x_m", "y_m", "z_m", "origin_m", "spacing_m"),
}
NX_CLASSES = {"/": "NXroot", "/entry": "NXentry", "/entry/data": "NXdata"}
EXPECTED = "a readable native HDF5 file"


def read_capture(path: Path) -> dict[str, Any]:
    """Return the header of a native capture, and its arrays by the names of its datasets."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        header, data = _header(path, file, "capture")
        tx_m = hdf5_guard.array(path, data, "tx_m", np.float64, (None, 3))
        rx_m = hdf5_guard.array(path, data, "rx_m", np.float64, (None, 3))
        frequency_hz = hdf5_guard.array(path, data, "frequency_hz", np.float64, (None,))
        shape = (len(tx_m), len(rx_m), len(frequency_hz))
        cube = hdf5_guard.array(path, data, "data", np.complex64, shape)
        arrays = {"tx_m": tx_m, "rx_m": rx_m, "frequency_hz": frequency_hz, "data": cube}
        return {"header": header, **arrays}


def read_volume(path: Path) -> dict[str, Any]:
    """Return the header of a native volume, and its arrays by the names of its datasets."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        header, data = _header(path, file, "volume")
        arrays = {
            name: hdf5_guard.array(path, data, name, np.float64, (count,))
            for name, count in {
                "x_m": None,
                "y_m": None,
                "z_m": None,
                "origin_m": 3,
                "spacing_m": 3,
            }.items()
        }
        shape = tuple(len(arrays[name]) for name in AXES["volume"])
        arrays["data"] = hdf5_guard.array(path, data, "data", np.complex64, shape)
        return {"header": header, **arrays}


def read_header(path: Path) -> dict[str, Any]:
    """Return what the root's attributes say."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        return _header(path, file, None)[0]


def nexus_problems(path: Path) -> list[str]:
    """Return what a native file lacks that reading does not need: NeXus attributes, checksums."""
    problems = []
    with hdf5_guard.opened(path, EXPECTED) as file:
        header, data = _header(path, file, None)
        kind = header["format"]
        nodes = {"/": file, "/entry": file["entry"], "/entry/data": data}
        for name, node in nodes.items():
            problems += _attribute_problem(path, node, "NX_class", NX_CLASSES[name])
        problems += _attribute_problem(path, file, "default", "entry")
        problems += _attribute_problem(path, nodes["/entry"], "default", "data")
        problems += _attribute_problem(path, data, "signal", "data")
        axes = list(AXES[kind])
        if "axes" not in data.attrs or hdf5_guard.texts(path, data, "axes") != axes:
            problems.append(f"/entry/data@axes: expected {axes}")
        for name in DATASETS[kind]:
            if name in ("tx", "rx") and name not in data:
                continue  # for viewers only
            found = hdf5_guard.dataset(path, data, name)
            if not hdf5_guard.has_checksum(found):
                problems.append(f"/entry/data/{name}: carries no Fletcher-32 checksum")
            if name in ("tx", "rx"):
                want = np.arange(data[f"{name}_m"].shape[0])
                have = hdf5_guard.array(path, data, name, np.int32, (None,))
                if not np.array_equal(have, want):
                    problems.append(f"/entry/data/{name}: expected 0 ... {len(want) - 1}")
        created = header["created"]
        try:
            datetime.fromisoformat(created)
        except ValueError:
            problems.append(f"/@created: expected an ISO 8601 time, got {clean(created)}")
    return problems


def _attribute_problem(path: Path, node: Any, name: str, want: str) -> list[str]:
    have = hdf5_guard.text(path, node, name) if name in node.attrs else "nothing"
    return [] if have == want else [f"{node.name}@{name}: expected {want}, got {clean(have)}"]


def _header(path: Path, file: Any, wanted: str | None) -> tuple[dict[str, Any], Any]:
    """Check what the file says it is; return that and the group of the data."""
    if "clradar_format" not in file.attrs:
        fail(
            path,
            "a native capture or volume",
            "an HDF5 file without the attribute clradar_format, so of another program",
        )
    kind = hdf5_guard.text(path, file, "clradar_format")
    version = hdf5_guard.whole_number(path, file, "clradar_version")
    if version > VERSION:
        fail(
            path,
            f"a native file of version {VERSION}, the newest that this clradar reads",
            f"version {version}: it was written by a newer clradar; update to read it",
        )
    if version < 1:
        fail(path, f"a native file of version 1 to {VERSION}", f"version {version}")
    if kind not in FORMATS:
        fail(path, "clradar_format 'capture' or 'volume'", repr(clean(kind)))
    if wanted is not None and kind != wanted:
        fail(path, f"a {wanted}", f"a {kind}; use open_{kind}")
    created = hdf5_guard.text(path, file, "created")
    text = hdf5_guard.text(path, file, "provenance")
    data = hdf5_guard.group(path, hdf5_guard.group(path, file, "entry"), "data")
    name = hdf5_guard.text(path, data, "array_name") if kind == "capture" else ""
    if "text_crc32" in file.attrs:
        want = hdf5_guard.whole_number(path, file, "text_crc32")
        have = text_crc32(created, text, name)
        if have != want:
            fail(path, f"text attributes with checksum {want:08x}", f"{have:08x}: they are damaged")
    found = {"format": kind, "version": version, "created": created}
    return found | {"provenance": text, "array_name": name}, data


def text_crc32(created: str, text: str, name: str) -> int:
    return zlib.crc32("\n".join((created, text, name)).encode("utf-8"))
