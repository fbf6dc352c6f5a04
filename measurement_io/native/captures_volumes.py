"""The native HDF5 file of captures and volumes (docs/files.md)."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ModelError
from clradar.files import json_text
from clradar.files.failures import clean, fail, reading
from clradar.model import (
    AntennaArray,
    AntennaPattern,
    Capture,
    ImageScale,
    Volume,
    VoxelGrid,
    Waveform,
    checks,
)
from clradar.model.volume import Planes, depth_map_of_planes
from measurement_io.confined import hdf5_process
from measurement_io.native import contents as native_contents
from measurement_io.native.scheme import (
    EXPECTED,
    VIEW_AXES,
    VIEWS,
    NativeHeader,
    View,
    check_hdf5,
    instrument_bytes,
    instrument_version,
    plain_text,
    shape_bytes,
    stored_bytes,
    write,
    write_dataset,
    write_instrument,
    write_planes,
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
        No capture; `capture.meta` holds what JSON cannot hold, or the array's name is no plain
        text. Nothing is written.
    OutputError
        The target exists and `force` is not set, its folder does not exist, or the system refuses
        to write. Nothing half-written stays behind.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_capture, save_capture
    >>> waveform = clradar.Waveform([76e9, 77e9, 78e9])
    >>> array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab")
    >>> cycles = waveform.frequencies_hz * 0.6 / clradar.constants.SPEED_OF_LIGHT_M_PER_S
    >>> data = np.exp(-2j * np.pi * cycles) * np.ones((2, 1, 1))  # a path of 0.6 m
    >>> capture = clradar.Capture(data.astype(np.complex64), array, waveform, {"room": "B 12"})
    >>> save_capture("capture.h5", capture)
    >>> read = open_capture("capture.h5")
    >>> np.array_equal(read.data, capture.data), dict(read.meta)
    (True, {'room': 'B 12'})
    """
    checks.instance("save_capture: capture", capture, Capture)
    texts = {"array_name": plain_text("AntennaArray.name", capture.array.name)}

    def fill(data: Any) -> None:
        write_dataset(data, "data", capture.data, "complex response", None)
        write_instrument(data, capture.array, capture.waveform)

    text = json_text.to_json("Capture.meta", capture.meta)
    size = stored_bytes(capture.data) + instrument_bytes(capture.array, capture.waveform)
    version = instrument_version(capture.array)
    write(Path(path), "capture", text, texts, fill, size_bytes=size, force=force, version=version)


def save_volume(path: str | os.PathLike[str], volume: Volume, *, force: bool = False) -> None:
    """Write a volume to a native HDF5 file; reading it gives the same bits.

    Parameters and errors as for `save_capture`.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_volume, save_volume
    >>> grid = clradar.VoxelGrid([-0.01, -0.01, 0.3], [0.01, 0.01, 0.01], (3, 3, 2))
    >>> data = np.zeros(grid.shape, np.complex64)
    >>> data[1, 1, 2] = 1j
    >>> save_volume("volume.h5", clradar.Volume(data, grid, {"method": "exact"}))
    >>> np.array_equal(open_volume("volume.h5").data, data)
    True
    """
    checks.instance("save_volume: volume", volume, Volume)
    save_planes(path, volume.data, volume.grid, volume.meta, volume.scale, force=force)


def save_planes(
    path: str | os.PathLike[str],
    planes: Planes,
    grid: VoxelGrid,
    meta: Mapping[str, Any],
    scale: ImageScale | None,
    *,
    force: bool = False,
) -> None:
    """Write a volume whose planes are read a few at a time; as `save_volume`."""
    texts = {}
    if scale is not None:
        texts["array_name"] = plain_text("AntennaArray.name", scale.array.name)

    def fill(data: Any) -> None:
        write_planes(data, "data", planes, grid.shape, "complex image")
        write_dataset(data, "x_m", grid.x_m, "voxel centres, x", "m")
        write_dataset(data, "y_m", grid.y_m, "voxel centres, y", "m")
        write_dataset(data, "z_m", grid.z_m, "voxel centres, z", "m")
        # The axes are for viewers; these two give the grid back exactly.
        write_dataset(data, "origin_m", grid.origin_m, "centre of the first voxel x, y, z", "m")
        write_dataset(data, "spacing_m", grid.spacing_m, "voxel spacing x, y, z", "m")
        if scale is not None:
            write_instrument(data, scale.array, scale.waveform)
            write_dataset(data, native_contents.WEIGHTS, scale.weights, "window", None)

    text = json_text.to_json("Volume.meta", meta)
    size = shape_bytes(grid.shape, 8) + stored_bytes(grid.x_m, grid.y_m, grid.z_m)
    if scale is not None:
        size += instrument_bytes(scale.array, scale.waveform) + scale.weights.nbytes
    version = 1 if scale is None else max(2, instrument_version(scale.array))
    write(
        Path(path), "volume", text, texts, fill, size_bytes=size, force=force, version=version,
        views=_views(planes, grid),
    )  # fmt: skip


def _views(planes: Planes, grid: VoxelGrid) -> list[View]:
    """Return what viewers show of a volume; nothing where an amplitude is beyond float32."""
    try:
        depth = depth_map_of_planes(planes, grid, DYNAMIC_RANGE_DB)
    except ModelError:
        return []
    titles = (
        "Maximum amplitude along z",
        f"Depth of the maximum along z, within {depth.dynamic_range_db:g} dB of the strongest",
    )
    return [
        View(VIEWS[0], titles[0], VIEW_AXES, depth.amplitude, "amplitude", None),
        View(VIEWS[1], titles[1], VIEW_AXES, depth.depth_m, "depth", "m"),
    ]


def read_capture(path: Path) -> tuple[NativeHeader, Capture]:
    """Return header and capture of a native file; every failure is a `MeasurementError`."""
    with reading(path, EXPECTED):
        return _capture(*contents(native_contents.read_capture, path))


def read_capture_if_native(path: Path) -> tuple[NativeHeader, Capture] | None:
    """Return what `read_capture` does, None for an HDF5 file of another program."""
    with reading(path, EXPECTED):
        found = hdf5_process.run(native_contents.read_capture_if_native, path)
        return None if found is None else _capture(*_split(found))


def _capture(header: NativeHeader, found: native_contents.Contents) -> tuple[NativeHeader, Capture]:
    array, waveform = instrument(found)
    return header, Capture(_read_only(found["data"]), array, waveform, header.meta)


def read_volume(path: Path) -> tuple[NativeHeader, Volume]:
    """Return header and volume of a native file; every failure is a `MeasurementError`."""
    with reading(path, EXPECTED):
        header, found = contents(native_contents.read_volume, path)
        axes = [found[name] for name in ("x_m", "y_m", "z_m")]
        counts = (len(axes[0]), len(axes[1]), len(axes[2]))
        grid = VoxelGrid(found["origin_m"], found["spacing_m"], counts)
        for axis, have, want in zip("xyz", axes, (grid.x_m, grid.y_m, grid.z_m), strict=True):
            if np.abs(have - want).max() > 1e-9 * max(1.0, float(np.abs(want).max())):
                fail(path, f"{axis}_m by origin_m and spacing_m", "another axis")
        scale = None
        if native_contents.WEIGHTS in found:
            scale = ImageScale(*instrument(found), found[native_contents.WEIGHTS])
        return header, Volume(_read_only(found["data"]), grid, header.meta, scale)


def read_header(path: Path) -> NativeHeader:
    """Return the header of a native file without reading its data."""
    with reading(path, EXPECTED):
        return _header(hdf5_process.run(native_contents.read_header, path))


def nexus_problems(path: Path) -> list[str]:
    """Return missing NeXus attributes and checksums, which reading does not need."""
    with reading(path, EXPECTED):
        return [clean(line) for line in hdf5_process.run(native_contents.nexus_problems, path)]


VIEW_TOLERANCE = 1e-6
"""Relative: another processor may round an amplitude's root to the neighbouring float32, 1.2e-7."""


def view_problems(path: Path, volume: Volume) -> list[str]:
    """Return which of the images that viewers show are not those of the volume in the file."""
    with reading(path, EXPECTED):
        found = hdf5_process.run(native_contents.read_views, path)
        wanted = {view.name: view.data for view in _views(volume.data, volume.grid)}
    problems = [f"/entry/{name}: expected none, got one" for name in found if name not in wanted]
    for name in wanted.keys() & found.keys():
        # Where two depths are equally bright, rounding may choose the other one.
        off = ~np.isclose(found[name], wanted[name], VIEW_TOLERANCE, 0.0, equal_nan=True)
        if off.mean() > (0.0 if name == VIEWS[0] else 1e-3):
            problems.append(f"/entry/{name}: {off.sum()} of {off.size} pixels are not the data's")
    return sorted(problems)


def contents(
    function: Callable[[Path], native_contents.Contents], path: Path
) -> tuple[NativeHeader, native_contents.Contents]:
    """Return the header of a native file, and what a function of `native_contents` takes out."""
    return _split(hdf5_process.run(function, path))


def _split(found: native_contents.Contents) -> tuple[NativeHeader, native_contents.Contents]:
    header = found.pop("header")
    return _header(header), {**header["texts"], **found}


def instrument(found: native_contents.Contents) -> tuple[AntennaArray, Waveform]:
    """Return the antennas and the frequencies of a capture or of its channels."""
    tx, rx = (AntennaPattern(**kept) if kept else None for kept in found["patterns"])
    sides = {
        name: value.view(np.complex128)[:, 0] if name.endswith("gain") else value
        for name, value in found["sides"].items()
    }
    array = AntennaArray(found["tx_m"], found["rx_m"], found["array_name"], tx, rx, **sides)
    return array, Waveform(found["frequency_hz"])


def _header(found: native_contents.Contents) -> NativeHeader:
    meta = json_text.parse_object(found["provenance"], strict=True)
    return NativeHeader(found["format"], found["version"], found["created"], meta)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False  # the record keeps a read-only array without another copy
    return array


def open_volume(path: str | os.PathLike[str]) -> Volume:
    """Return the volume of a native HDF5 file.

    Raises
    ------
    MeasurementError
        Missing, no native file, a capture, a newer version, damaged, or NaN in the data.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_volume, save_volume
    >>> grid = clradar.VoxelGrid([-0.01, -0.01, 0.3], [0.01, 0.01, 0.01], (3, 3, 2))
    >>> data = np.zeros(grid.shape, np.complex64)
    >>> data[1, 1, 2] = 1j
    >>> save_volume("volume.h5", clradar.Volume(data, grid, {"method": "exact"}))
    >>> volume = open_volume("volume.h5")
    >>> z, y, x = np.unravel_index(np.abs(volume.data).argmax(), volume.data.shape)
    >>> round(float(volume.grid.x_m[x]), 3), round(float(volume.grid.z_m[z]), 3)
    (0.01, 0.31)
    """
    file = Path(path)
    check_hdf5(file, "a native volume file")
    return read_volume(file)[1]
