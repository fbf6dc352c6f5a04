"""The native HDF5 file of captures and volumes, version 1 (docs/files.md)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from clradar.model import AntennaArray, Capture, Volume, VoxelGrid, Waveform
from measurement_io import hdf5_guard, provenance
from measurement_io.failures import fail
from measurement_io.native_scheme import (
    NativeHeader,
    check_hdf5,
    header_of,
    opened,
    plain_text,
    write,
    write_dataset,
    write_instrument,
)


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
    texts = {"array_name": plain_text("AntennaArray.name", capture.array.name)}

    def fill(data: Any) -> None:
        write_dataset(data, "data", capture.data, "complex response", None)
        write_instrument(data, capture.array, capture.waveform)

    text = provenance.to_json("Capture.meta", capture.meta)
    write(Path(path), "capture", text, texts, fill, force=force)


def save_volume(path: str | os.PathLike[str], volume: Volume, *, force: bool = False) -> None:
    """Write a volume to a native HDF5 file; reading it gives the same bits.

    Parameters and errors as for `save_capture`.
    """
    grid = volume.grid

    def fill(data: Any) -> None:
        write_dataset(data, "data", volume.data, "complex image", None)
        write_dataset(data, "x_m", grid.x_m, "voxel centres, x", "m")
        write_dataset(data, "y_m", grid.y_m, "voxel centres, y", "m")
        write_dataset(data, "z_m", grid.z_m, "voxel centres, z", "m")
        # The axes are for viewers; these two give the grid back exactly.
        write_dataset(data, "origin_m", grid.origin_m, "centre of the first voxel x, y, z", "m")
        write_dataset(data, "spacing_m", grid.spacing_m, "voxel spacing x, y, z", "m")

    text = provenance.to_json("Volume.meta", volume.meta)
    write(Path(path), "volume", text, {}, fill, force=force)


def read_capture(path: Path) -> tuple[NativeHeader, Capture]:
    """Return header and capture of a native file; every failure is a `MeasurementError`."""
    with opened(path) as file:
        header, data = header_of(path, file, "capture")
        array, waveform = read_instrument(path, data)
        shape = (array.n_tx, array.n_rx, waveform.n_freq)
        cube = hdf5_guard.array(path, data, "data", np.complex64, shape)
        return header, Capture(cube, array, waveform, header.meta)


def read_instrument(path: Path, data: Any) -> tuple[AntennaArray, Waveform]:
    """Return the antennas and the frequencies of `/entry/data`."""
    tx_m = hdf5_guard.array(path, data, "tx_m", np.float64, (None, 3))
    rx_m = hdf5_guard.array(path, data, "rx_m", np.float64, (None, 3))
    frequency = hdf5_guard.array(path, data, "frequency_hz", np.float64, (None,))
    name = hdf5_guard.text(path, data, "array_name")
    return AntennaArray(tx_m, rx_m, name), Waveform(frequency)


def read_volume(path: Path) -> tuple[NativeHeader, Volume]:
    """Return header and volume of a native file; every failure is a `MeasurementError`."""
    with opened(path) as file:
        header, data = header_of(path, file, "volume")
        axes = [hdf5_guard.array(path, data, n, np.float64, (None,)) for n in ("x_m", "y_m", "z_m")]
        origin = hdf5_guard.array(path, data, "origin_m", np.float64, (3,))
        spacing = hdf5_guard.array(path, data, "spacing_m", np.float64, (3,))
        grid = VoxelGrid(origin, spacing, (len(axes[0]), len(axes[1]), len(axes[2])))
        for axis, have, want in zip("xyz", axes, (grid.x_m, grid.y_m, grid.z_m), strict=True):
            if np.abs(have - want).max() > 1e-9 * max(1.0, float(np.abs(want).max())):
                fail(path, f"{axis}_m as origin_m and spacing_m say", "another axis")
        image = hdf5_guard.array(path, data, "data", np.complex64, grid.shape)
        return header, Volume(image, grid, header.meta)


def open_volume(path: str | os.PathLike[str]) -> Volume:
    """Return the volume of a native HDF5 file.

    Raises
    ------
    MeasurementError
        Missing, no native file, a capture, a newer version, damaged, or NaN in the data.
    """
    file = Path(path)
    check_hdf5(file, "a native volume file")
    return read_volume(file)[1]
