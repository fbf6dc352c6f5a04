"""The native HDF5 file: captures and volumes, version 1.

Layout (docs/files.md has the table): `/` NXroot, `/entry` NXentry, `/entry/data` NXdata with the
signal `data` and what its axes mean; the root's attributes say which format and version it is,
when it was made and, as JSON, where it comes from.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ModelError
from clradar.model import AntennaArray, Capture, Volume, VoxelGrid, Waveform
from measurement_io import hdf5_process, native_contents, provenance
from measurement_io.atomic import refuse_existing, replacing
from measurement_io.failures import clean, fail, reading, regular_file_size
from measurement_io.hdf5_guard import HDF5_MAGIC
from measurement_io.native_contents import AXES, EXPECTED, NX_CLASSES, VERSION, text_crc32

_CHUNK_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class NativeHeader:
    """What the root's attributes of a native file say.

    Attributes
    ----------
    format : str
        "capture" or "volume".
    version : int
    created : str
        ISO 8601, UTC.
    meta : dict
        The provenance, from JSON.
    """

    format: str
    version: int
    created: str
    meta: dict[str, Any]


def save_capture(path: str | os.PathLike[str], capture: Capture, *, force: bool = False) -> None:
    """Write a capture to a native HDF5 file; reading it gives the same bits.

    Parameters
    ----------
    path : path-like
        Target, whatever its extension. Its folder has to exist.
    capture : Capture
    force : bool
        Replace an existing file.

    Raises
    ------
    ModelError
        `capture.meta` holds what JSON cannot hold, or the array's name is no plain text. Nothing is
        written.
    OutputError
        The target exists and `force` is not set, its folder does not exist, or the system refuses
        to write. Nothing half-written stays behind.
    """
    name = capture.array.name
    if "\0" in name or not _encodable(name):
        raise ModelError(f"AntennaArray.name: expected plain text, got {name!r:.100}")

    def fill(data: Any) -> None:
        data.attrs["array_name"] = name
        _dataset(data, "data", capture.data, "complex response", None)
        _dataset(data, "tx", np.arange(capture.array.n_tx, dtype=np.int32), "Tx antenna", None)
        _dataset(data, "rx", np.arange(capture.array.n_rx, dtype=np.int32), "Rx antenna", None)
        _dataset(data, "frequency_hz", capture.waveform.frequencies_hz, "frequency", "Hz")
        _dataset(data, "tx_m", capture.array.tx_m, "Tx antenna positions x, y, z", "m")
        _dataset(data, "rx_m", capture.array.rx_m, "Rx antenna positions x, y, z", "m")

    text = provenance.to_json("Capture.meta", capture.meta)
    _write(Path(path), "capture", text, name, fill, force=force)


def save_volume(path: str | os.PathLike[str], volume: Volume, *, force: bool = False) -> None:
    """Write a volume to a native HDF5 file; reading it gives the same bits.

    Parameters and errors as for `save_capture`.
    """
    grid = volume.grid

    def fill(data: Any) -> None:
        _dataset(data, "data", volume.data, "complex image", None)
        _dataset(data, "x_m", grid.x_m, "voxel centres, x", "m")
        _dataset(data, "y_m", grid.y_m, "voxel centres, y", "m")
        _dataset(data, "z_m", grid.z_m, "voxel centres, z", "m")
        # The axes are for viewers; these two give the grid back exactly.
        _dataset(data, "origin_m", grid.origin_m, "centre of the first voxel x, y, z", "m")
        _dataset(data, "spacing_m", grid.spacing_m, "voxel spacing x, y, z", "m")

    text = provenance.to_json("Volume.meta", volume.meta)
    _write(Path(path), "volume", text, "", fill, force=force)


def read_capture(path: Path) -> tuple[NativeHeader, Capture]:
    """Return header and capture of a native file; every failure is a `MeasurementError`."""
    with reading(path, EXPECTED):
        found = hdf5_process.run(native_contents.read_capture, path)
        header = _header(found["header"])
        name = found["header"]["array_name"]
        array = AntennaArray(found["tx_m"], found["rx_m"], name)
        cube = _read_only(found["data"])
        return header, Capture(cube, array, Waveform(found["frequency_hz"]), header.meta)


def read_volume(path: Path) -> tuple[NativeHeader, Volume]:
    """Return header and volume of a native file; every failure is a `MeasurementError`."""
    with reading(path, EXPECTED):
        found = hdf5_process.run(native_contents.read_volume, path)
        header = _header(found["header"])
        axes = [found[name] for name in ("x_m", "y_m", "z_m")]
        counts = (len(axes[0]), len(axes[1]), len(axes[2]))
        grid = VoxelGrid(found["origin_m"], found["spacing_m"], counts)
        for axis, have, want in zip("xyz", axes, (grid.x_m, grid.y_m, grid.z_m), strict=True):
            if np.abs(have - want).max() > 1e-9 * max(1.0, float(np.abs(want).max())):
                fail(path, f"{axis}_m as origin_m and spacing_m say", "another axis")
        return header, Volume(_read_only(found["data"]), grid, header.meta)


def open_volume(path: str | os.PathLike[str]) -> Volume:
    """Return the volume of a native HDF5 file.

    Raises
    ------
    MeasurementError
        Missing, no native file, a capture, a newer version, damaged, or NaN in the data.
    """
    file = Path(path)
    size = regular_file_size(file, "a native volume file")
    with reading(file, "a native volume file"), open(file, "rb") as raw:
        magic = raw.read(len(HDF5_MAGIC))
    if magic != HDF5_MAGIC:
        fail(file, "a native volume file (HDF5)", f"{size} bytes that are no HDF5 file")
    return read_volume(file)[1]


def read_header(path: Path) -> NativeHeader:
    """Return the header of a native file without reading its data."""
    with reading(path, EXPECTED):
        return _header(hdf5_process.run(native_contents.read_header, path))


def nexus_problems(path: Path) -> list[str]:
    """Return what a native file lacks that reading does not need: NeXus attributes, checksums."""
    with reading(path, EXPECTED):
        return [
            clean(problem) for problem in hdf5_process.run(native_contents.nexus_problems, path)
        ]


def _header(found: dict[str, Any]) -> NativeHeader:
    meta = provenance.from_json(found["provenance"])
    return NativeHeader(found["format"], found["version"], found["created"], meta)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False  # the record keeps a read-only array without another copy
    return array


def _write(
    path: Path, kind: str, text: str, name: str, fill: Callable[[Any], None], *, force: bool
) -> None:
    refuse_existing(path, force=force)
    import h5py

    created = datetime.now(timezone.utc).isoformat(timespec="seconds")
    # From version 1.10 on HDF5 keeps checksums of its own structures, and long attributes.
    with (
        replacing(path, force=force) as temporary,
        h5py.File(temporary, "x", libver=("v110", "v110")) as file,
    ):
        file.attrs["NX_class"] = NX_CLASSES["/"]
        file.attrs["default"] = "entry"
        file.attrs["clradar_format"] = kind
        file.attrs["clradar_version"] = VERSION
        file.attrs["created"] = created
        file.attrs["provenance"] = text
        # HDF5 keeps the strings of attributes where it has no checksum.
        file.attrs["text_crc32"] = np.uint32(text_crc32(created, text, name))
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = NX_CLASSES["/entry"]
        entry.attrs["default"] = "data"
        data = entry.create_group("data")
        data.attrs["NX_class"] = NX_CLASSES["/entry/data"]
        data.attrs["signal"] = "data"
        data.attrs["axes"] = list(AXES[kind])
        fill(data)


def _dataset(group: Any, name: str, value: np.ndarray, long_name: str, unit: str | None) -> None:
    # About 1 MiB per chunk, cut along the first axis, so that one pair or slice is read quickly.
    row_bytes = max(1, value.nbytes // len(value))
    rows = min(len(value), max(1, _CHUNK_BYTES // row_bytes))
    made = group.create_dataset(
        name, data=value, chunks=(rows, *value.shape[1:]), shuffle=True, fletcher32=True
    )
    made.attrs["long_name"] = long_name
    if unit is not None:
        made.attrs["units"] = unit


def _encodable(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True
