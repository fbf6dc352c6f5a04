"""Small valid files of every kind that is read, always the same."""

from __future__ import annotations

import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import maroon_files
import numpy as np

import clradar
from measurement_io import save_capture, save_volume


def frames() -> list[bytes]:
    """Recorded frames: every protocol, both channel counts, the numpy of old and of today."""
    frame = maroon_files.random_frame(1, channels=94)
    rich = frame | {
        "gain": np.float32(0.5),
        "phase": 1 + 2j,
        "note": "hand",
        "flag": True,
        "list": [1, 2.5, ("a", None)],
        "objects": np.array([1, "a"], dtype=object),
        "stamps": [1, 2, 3],
    }
    found = [
        maroon_files.npy(maroon_files.pickled(content, protocol, spelling))
        for content in (frame, rich)
        for protocol in maroon_files.PROTOCOLS
        for spelling in maroon_files.SPELLINGS
    ]
    found.append(maroon_files.npy(maroon_files.pickled_by_python_2(frame)))
    found.append(maroon_files.npy(maroon_files.pickled(maroon_files.random_frame(1))))
    frame = frame | {"xr": np.asfortranarray(frame["xr"]).astype(">c16")}
    found.append(maroon_files.npy(maroon_files.pickled(frame, 5)))
    return found


def native_captures() -> list[bytes]:
    """Native captures: as saved here, by another writer in every generation of HDF5, long text."""
    rng = np.random.default_rng(0)
    data = (rng.normal(size=(3, 2, 5)) + 1j * rng.normal(size=(3, 2, 5))).astype(np.complex64)
    array = clradar.AntennaArray(rng.normal(size=(3, 3)), rng.normal(size=(2, 3)), "lab 1")
    waveform = clradar.Waveform(60e9 + np.arange(5) * 1e9)
    capture = clradar.Capture(data, array, waveform, {"seed": 1, "list": [1.5, None, {"a": "b"}]})
    return [
        _saved(save_capture, capture),
        *(_by_hand(capture, options) for options in _GENERATIONS),
        *(_by_hand(capture, options, crowd=30) for options in _GENERATIONS[:2]),
    ]


def native_volumes() -> list[bytes]:
    """Native volumes, as saved here."""
    grid = clradar.VoxelGrid([-0.1, 0.2, 0.3], [1e-3, 2e-3, 3e-3], (4, 3, 2))
    rng = np.random.default_rng(0)
    data = (rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)).astype(np.complex64)
    return [_saved(save_volume, clradar.Volume(data, grid, {"method": "exact"}))]


_GENERATIONS: tuple[dict[str, Any], ...] = (
    {"libver": "earliest"},
    {"libver": "latest"},
    {"libver": ("earliest", "v108"), "track_order": True},
)


def _saved(save: Any, record: Any) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file.h5"
        save(path, record)
        return path.read_bytes()


def _by_hand(capture: clradar.Capture, options: dict[str, Any], crowd: int = 0) -> bytes:
    """A capture with other storage: contiguous, chunked with every kind of index, many names."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", **options) as file:
        for name, value in {
            "clradar_format": "capture",
            "clradar_version": 1,
            "created": "2024-05-06T07:08:09+00:00",
            "provenance": json.dumps(dict(capture.meta)),
        }.items():
            file.attrs[name] = value
        for i in range(crowd):  # so many that HDF5 stores them another way
            file.attrs[f"attribute {i}"] = f"value {i}"
        group = file.create_group("entry/data")
        group.attrs["array_name"] = np.bytes_(capture.array.name)
        for i in range(crowd):
            group.create_group(f"group {i}")
        group.create_dataset("data", data=capture.data, chunks=(1, 2, 5), shuffle=True)
        group.create_dataset("tx_m", data=capture.array.tx_m, chunks=(1, 3), maxshape=(None, 3))
        group.create_dataset("rx_m", data=capture.array.rx_m, maxshape=(None, None))
        group["frequency_hz"] = capture.waveform.frequencies_hz
    return stream.getvalue()


def radar_folder(folder: Path) -> None:
    """Put what lies around a calibration.json: a radar folder with an unreadable frame."""
    frames_folder = folder / "radar_72.0_82.0_2" / "calibrated_data"
    frames_folder.mkdir(parents=True, exist_ok=True)
    (frames_folder / "000000.npy").write_bytes(b"no frame, so that reading it takes no time")


def calibrations() -> list[bytes]:
    """calibration.json of a recording, with the entries of one frame in both generations."""
    box = {"bb_min": [-0.1, -0.1, 0.26], "bb_max": [0.1, 0.1, 0.34], "grid_size": [201, 201, 81]}
    top = {"frequency_low_ghz": 72.0, "frequency_high_ghz": 82.0, "frequency_points": 2}
    amplitude = {"amplitude_filter_kernel_size": 3, "amplitude_filter_threshold_dB": -15.0}
    limits = {"min_abs": 0.0, "max_abs": 1.5, "min_amplitude": 0.0, "max_amplitude": 1.5}
    matrix = np.eye(4).tolist()
    new = {"volume": box | limits, "amplitude": amplitude, "depth": {"intrinsics": matrix}}
    old = {"volume": box | limits, "amplitude": amplitude, "depth": {"transform": matrix}}
    trees = [top, top | {"000000": new}, top | {"000000": old, "000001": new | {"depth": box}}]
    return [json.dumps(tree, indent=1).encode() for tree in trees]


def antenna_files() -> list[bytes]:
    """Antenna files with 96 and with 94 rows."""
    rows = np.zeros((96, 3))
    rows[1:95] = clradar.arrays.qar50().rx_m
    texts = [[f"{x},{y},{z}" for x, y, z in part] for part in (rows, rows[1:95])]
    return ["\n".join(["x,y,z", *text, ""]).encode() for text in texts]
