"""The common scheme of native HDF5 files (NeXus NXdata): structure, header, reading, writing.

Layout (docs/files.md has the tables): `/` NXroot, `/entry` NXentry, `/entry/data` NXdata with its
signal and its axes; the root's attributes hold format and version,
when it was made and, as JSON, where it comes from.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ModelError
from clradar.files.atomic import refuse_existing, replacing, require_space
from clradar.files.failures import fail, reading, regular_file_size
from measurement_io.confined import hdf5_guard

VERSION = 3
"""The newest that is read. Files are written as version 1 where that holds all there is: version 2
adds antenna patterns, without which a reader would misunderstand the samples, and the scale of
volumes; version 3 gains and boresights of single antennas."""

SIDE_COLUMNS = {"gain": 2, "boresight": 3}
"""Of single antennas, beside their positions: real and imaginary part, unit vector. In datasets
such as `tx_antenna_gain`: `tx_gain` is that of a channel, in a file of channels."""


NX_CLASSES = {"/": "NXroot", "/entry": "NXentry", "/entry/data": "NXdata"}
_CHUNK_BYTES = 2**20
_AT_ONCE_BYTES = 2**25
_STRUCTURE_BYTES = 2**16
"""Of a file beside its arrays and its provenance; 16 kB in a capture of the 94 x 94 imager."""

EXPECTED = "a readable native HDF5 file"


@dataclass(frozen=True, slots=True)
class Scheme:
    """The content of `/entry/data` of one format.

    Attributes
    ----------
    noun : str
        What a file of it holds.
    opener : str
        The function that opens it.
    title : str
        What viewers write above it.
    signal : str
        The dataset that viewers show.
    axes : tuple of str
        Of the signal.
    interpretation : "spectrum" or "image"
        Whether viewers show the last axis of the signal as curves, or the last two as images.
    datasets : tuple of str
    texts : tuple of str
        String attributes, which the checksum of the file's text covers.
    optional_texts : tuple of str
        String attributes that a file may lack, under the same checksum.
    """

    noun: str
    opener: str
    title: str
    signal: str
    axes: tuple[str, ...]
    interpretation: str
    datasets: tuple[str, ...]
    texts: tuple[str, ...]
    optional_texts: tuple[str, ...] = ()


SCHEMES = {
    "capture": Scheme(
        noun="a capture",
        opener="open_capture",
        title="Response of each pair of antennas",
        signal="data",
        axes=("tx", "rx", "frequency_hz"),
        interpretation="spectrum",
        datasets=("data", "tx", "rx", "frequency_hz", "tx_m", "rx_m"),
        texts=("array_name",),
    ),
    "volume": Scheme(
        noun="a volume",
        opener="open_volume",
        title="Complex image, slice by slice",
        signal="data",
        axes=("z_m", "y_m", "x_m"),
        interpretation="image",
        datasets=("data", "x_m", "y_m", "z_m", "origin_m", "spacing_m"),
        texts=(),
        optional_texts=("array_name",),
    ),
    "channels": Scheme(
        noun="channels",
        opener="open_channels",
        title="Complex gain of the Tx channels",
        signal="tx_gain",
        axes=("tx",),
        interpretation="spectrum",
        datasets=(
            *("tx", "rx", "frequency_hz", "tx_m", "rx_m", "tx_gain", "rx_gain"),
            *("tx_delay_s", "rx_delay_s", "tx_state", "rx_state", "tx_noise", "rx_noise"),
            *("tx_phase_std_rad", "rx_phase_std_rad", "tx_delay_std_s", "rx_delay_std_s"),
            *("target_position", "target_covariance", "target_amplitude", "reference_hz"),
            *("residual_db", "noise_residual_db"),
        ),
        texts=("array_name", "target", "target_parameters"),
    ),
}
"""The formats there are, by the root's `clradar_format`."""


@dataclass(frozen=True, slots=True)
class View:
    """An image that is drawn from the data, for viewers alone: an NXdata group beside it.

    Attributes
    ----------
    name : str
        Of the group.
    title : str
    axes : tuple of str
        Datasets of `/entry/data`.
    data : ndarray
    long_name : str
    unit : str or None
    """

    name: str
    title: str
    axes: tuple[str, ...]
    data: np.ndarray
    long_name: str
    unit: str | None


VIEW_AXES = ("y_m", "x_m")
VIEWS = ("max_projection", "depth_map")
"""Views of a volume; the first one is what viewers show at once."""


@dataclass(frozen=True, slots=True)
class NativeHeader:
    """The root's attributes of a native file.

    Attributes
    ----------
    format : str
        A key of `SCHEMES`.
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


def check_hdf5(path: Path, expected: str) -> None:
    """Raise `MeasurementError` unless a path is a regular file that starts as HDF5 does."""
    size = regular_file_size(path, expected)
    with reading(path, expected), open(path, "rb") as raw:
        magic = raw.read(len(hdf5_guard.HDF5_MAGIC))
    if magic != hdf5_guard.HDF5_MAGIC:
        fail(path, f"{expected} (HDF5)", f"{size} bytes that are no HDF5 file")


def plain_text(field: str, value: str) -> str:
    """Return a string that HDF5 can hold; `ModelError` for one that it cannot."""
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        pass
    else:
        if "\0" not in value:
            return value
    raise ModelError(f"{field}: expected plain text, got {value!r:.100}")


def write(
    path: Path,
    kind: str,
    text: str,
    texts: dict[str, str],
    fill: Callable[[Any], None],
    *,
    size_bytes: int,
    force: bool,
    version: int = 1,
    views: Sequence[View] = (),
) -> None:
    """Write a native file whole or not at all.

    Parameters
    ----------
    path : Path
    kind : str
        A key of `SCHEMES`.
    text : str
        The provenance, JSON.
    texts : dict
        The string attributes of its scheme.
    fill : callable
        Called with the group `/entry/data` to write its datasets.
    size_bytes : int
        What its arrays take, by `stored_bytes`.
    force : bool
        Replace an existing file.
    version : int
        The lowest whose readers understand the file.
    views : sequence of View
        The first is what viewers show; without one it is the data.
    """
    refuse_existing(path, force=force)
    import h5py

    scheme = SCHEMES[kind]
    created = _now().isoformat(timespec="seconds")
    # From version 1.10 on HDF5 keeps checksums of its own structures, and long attributes.
    with ExitStack() as stack:
        temporary = stack.enter_context(replacing(path, force=force))
        size_bytes += stored_bytes(*(view.data for view in views))
        require_space(temporary, size_bytes + len(text) + _STRUCTURE_BYTES)
        file = stack.enter_context(h5py.File(temporary, "x", libver=("v110", "v110")))
        file.attrs["NX_class"] = NX_CLASSES["/"]
        file.attrs["default"] = "entry"
        file.attrs["clradar_format"] = kind
        file.attrs["clradar_version"] = version
        file.attrs["created"] = created
        file.attrs["provenance"] = text
        # HDF5 keeps the strings of attributes where it has no checksum.
        kept = [name for name in (*scheme.texts, *scheme.optional_texts) if name in texts]
        crc32 = text_crc32(created, text, [texts[name] for name in kept])
        file.attrs["text_crc32"] = np.uint32(crc32)
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = NX_CLASSES["/entry"]
        entry.attrs["default"] = views[0].name if views else "data"
        data = _data_group(entry, "data", scheme.title, scheme.signal, scheme.axes)
        for name in kept:
            data.attrs[name] = texts[name]
        fill(data)
        data[scheme.signal].attrs["interpretation"] = scheme.interpretation
        for view in views:
            group = _data_group(entry, view.name, view.title, "data", view.axes)
            write_dataset(group, "data", view.data, view.long_name, view.unit)
            group["data"].attrs["interpretation"] = "image"
            for axis in view.axes:
                group[axis] = data[axis]


def _data_group(entry: Any, name: str, title: str, signal: str, axes: Sequence[str]) -> Any:
    group = entry.create_group(name)
    group.attrs["NX_class"] = NX_CLASSES["/entry/data"]
    group.attrs["signal"] = signal
    group.attrs["axes"] = list(axes)
    group.create_dataset("title", data=title)
    return group


def write_dataset(
    group: Any, name: str, value: np.ndarray, long_name: str, unit: str | None
) -> None:
    """Write a dataset with checksums and the names that viewers show."""
    chunks = (_rows_per_chunk(value.shape, value.itemsize), *value.shape[1:])
    made = group.create_dataset(name, data=value, chunks=chunks, shuffle=True, fletcher32=True)
    _name(made, long_name, unit)


def write_planes(group: Any, name: str, planes: Any, shape: tuple[int, ...], title: str) -> None:
    """The same of complex64 values of which a few MiB are read at a time, by slices of rows."""
    rows = _rows_per_chunk(shape, 8)
    chunks = (rows, *shape[1:])
    made = group.create_dataset(name, shape, "c8", chunks=chunks, shuffle=True, fletcher32=True)
    step = rows * max(1, _AT_ONCE_BYTES // (8 * math.prod(chunks)))
    for first in range(0, shape[0], step):
        made[first : first + step] = planes[first : first + step]
    _name(made, title, None)


def _name(made: Any, long_name: str, unit: str | None) -> None:
    # Viewers write either the long name or the name and the unit.
    made.attrs["long_name"] = long_name if unit is None else f"{long_name} ({unit})"
    if unit is not None:
        made.attrs["units"] = unit


def _rows_per_chunk(shape: tuple[int, ...], itemsize: int) -> int:
    # About 1 MiB per chunk, cut along the first axis, so that one pair or slice is read quickly.
    row_bytes = itemsize * math.prod(shape[1:])
    return min(shape[0], max(1, _CHUNK_BYTES // row_bytes))


def stored_bytes(*values: np.ndarray) -> int:
    """Return what arrays take in a file, whose last chunks are as long as the others."""
    return sum(shape_bytes(value.shape, value.itemsize) for value in values)


def shape_bytes(shape: tuple[int, ...], itemsize: int) -> int:
    """The same of an array of a shape."""
    rows = _rows_per_chunk(shape, itemsize)
    return -(-shape[0] // rows) * rows * itemsize * math.prod(shape[1:])


def write_instrument(group: Any, array: Any, waveform: Any) -> None:
    """Write the antennas and the frequencies that a capture and its channels share."""
    write_dataset(group, "tx", np.arange(array.n_tx, dtype=np.int32), "Tx antenna", None)
    write_dataset(group, "rx", np.arange(array.n_rx, dtype=np.int32), "Rx antenna", None)
    write_dataset(group, "frequency_hz", waveform.frequencies_hz, "frequency", "Hz")
    write_dataset(group, "tx_m", array.tx_m, "Tx antenna positions x, y, z", "m")
    write_dataset(group, "rx_m", array.rx_m, "Rx antenna positions x, y, z", "m")
    for side in ("tx", "rx"):
        for name, value in _side_columns(array, side).items():
            title = "amplitude, real and imaginary part" if value.shape[1] == 2 else "boresight"
            write_dataset(group, name, value, title, None)
        pattern = getattr(array, f"{side}_pattern")
        if pattern is None:
            continue
        name = f"{side}_pattern"
        lobe = np.array([pattern.gain_dbi, pattern.exponent])
        write_dataset(group, name, lobe, "power gain in dBi, exponent of the cosine", None)
        if pattern.angle_deg is not None:
            angle_deg = pattern.angle_deg
            write_dataset(group, f"{name}_angle_deg", angle_deg, "angle to boresight", "deg")
            write_dataset(group, f"{name}_field", pattern.field, "field amplitude", None)


def instrument_version(array: Any) -> int:
    """Return the lowest version whose readers understand a file with these antennas."""
    if any(_side_columns(array, side) for side in ("tx", "rx")):
        return 3
    return 2 if array.has_patterns else 1


def _side_columns(array: Any, side: str) -> dict[str, np.ndarray]:
    """Return what single antennas of a side have: dataset -> float64 (n, columns)."""
    values = {column: getattr(array, f"{side}_{column}") for column in SIDE_COLUMNS}
    return {
        f"{side}_antenna_{column}": value.view(np.float64).reshape(len(value), -1)
        for column, value in values.items()
        if value is not None
    }


def instrument_bytes(array: Any, waveform: Any) -> int:
    """Return what `write_instrument` stores."""
    # An index, 4 bytes, goes with each position of 24.
    values = [waveform.frequencies_hz, *2 * (array.tx_m, array.rx_m)]
    for side in ("tx", "rx"):
        values += _side_columns(array, side).values()
    for pattern in (array.tx_pattern, array.rx_pattern):
        if pattern is not None and pattern.angle_deg is not None:
            values += [pattern.angle_deg, pattern.field]
    return stored_bytes(*values)


def _now() -> datetime:
    """The time, or that of SOURCE_DATE_EPOCH, seconds since 1970, for files of equal bytes."""
    given = os.environ.get("SOURCE_DATE_EPOCH", "")
    if given.isdecimal() and len(given) <= 10:
        return datetime.fromtimestamp(int(given), timezone.utc)
    return datetime.now(timezone.utc)


def text_crc32(created: str, text: str, texts: list[str]) -> int:
    # A volume has no name, and its text ends in a line feed all the same.
    lines = (created, text, *(texts or [""]))
    return zlib.crc32("\n".join(lines).encode("utf-8"))
