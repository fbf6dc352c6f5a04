"""The common scheme of native HDF5 files (NeXus NXdata): structure, header, reading, writing.

docs/files.md has the tables: `/` NXroot, `/entry` NXentry, `/entry/data` NXdata with its signal and
its axes; the root's attributes hold format and version, when it was made and its provenance.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ModelError
from clradar.files.atomic import refuse_existing, replacing, require_space

VERSION = 3
"""The newest that is read. Files are written as version 1 where that holds all there is: version 2
adds antenna patterns, without which a reader would misunderstand the samples, and the scale of
volumes; version 3 gains and boresights of single antennas."""

_CHUNK_BYTES = 2**20
_AT_ONCE_BYTES = 2**25
_STRUCTURE_BYTES = 2**16
"""Of a file beside its arrays and its provenance; 16 kB in a capture of the 94 x 94 imager."""

EXPECTED = "a readable native HDF5 file"

Length = int | str | None
"""Of an axis: a number, the name of a length that all datasets with it share, or None for any."""


@dataclass(frozen=True, slots=True)
class Dataset:
    """One dataset of `/entry/data`.

    `version` is the lowest whose readers understand a file with it. Viewers write `long_name` and
    `unit`; what is `for_viewers` alone is not read.
    """

    name: str
    dtype: str
    shape: tuple[Length, ...]
    long_name: str
    unit: str | None = None
    optional: bool = False
    version: int = 1
    for_viewers: bool = False


def _side(side: str) -> tuple[Dataset, ...]:
    """Return what antennas of a side have beside their positions."""
    antenna, pattern, angles = f"{side}_antenna", f"{side}_pattern", f"{side} angles"
    gain = "amplitude, real and imaginary part"
    lobe = "power gain in dBi, exponent of the cosine"
    return (
        Dataset(f"{antenna}_gain", "f8", (side, 2), gain, None, True, 3),
        Dataset(f"{antenna}_boresight", "f8", (side, 3), "boresight", None, True, 3),
        Dataset(pattern, "f8", (2,), lobe, None, True, 2),
        Dataset(f"{pattern}_angle_deg", "f8", (angles,), "angle to boresight", "deg", True, 2),
        Dataset(f"{pattern}_field", "f8", (angles,), "field amplitude", None, True, 2),
    )


INSTRUMENT = (
    Dataset("tx", "i4", ("tx",), "Tx antenna", None, True, for_viewers=True),
    Dataset("rx", "i4", ("rx",), "Rx antenna", None, True, for_viewers=True),
    Dataset("frequency_hz", "f8", ("freq",), "frequency", "Hz"),
    Dataset("tx_m", "f8", ("tx", 3), "Tx antenna positions x, y, z", "m"),
    Dataset("rx_m", "f8", ("rx", 3), "Rx antenna positions x, y, z", "m"),
    *_side("tx"),
    *_side("rx"),
)
"""Antennas and frequencies, which a capture, its channels and the scale of a volume share."""

WEIGHTS = "frequency_weight"
"""Of the window of a volume, whose antennas and frequencies then are in the file, too."""


_CHANNEL = (
    ("gain", "c16", "complex gain at reference_hz", None),
    ("delay_s", "f8", "delay", "s"),
    ("noise", "f8", "noise of one sample relative to the median echo", None),
    ("phase_std_rad", "f8", "standard deviation of the phase", "rad"),
    ("delay_std_s", "f8", "standard deviation of the delay", "s"),
)


def _by_channel(side: str) -> Iterator[Dataset]:
    for name, dtype, long_name, unit in _CHANNEL:
        yield Dataset(f"{side}_{name}", dtype, (side,), f"{side.title()} {long_name}", unit)
    yield Dataset(f"{side}_state", "i4", (side,), "0 live, 1 dead, 2 noisy")


@dataclass(frozen=True, slots=True)
class Scheme:
    """The content of `/entry/data` of one format, in the order in which it is written.

    Viewers show `signal` over its `axes` below `title`: its last axis as curves ("spectrum") or the
    last two as images. The checksum of the file's text covers the string attributes `texts`.
    """

    noun: str
    opener: str
    title: str
    signal: str
    axes: tuple[str, ...]
    interpretation: str
    datasets: tuple[Dataset, ...]
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
        datasets=(Dataset("data", "c8", ("tx", "rx", "freq"), "complex response"), *INSTRUMENT),
        texts=("array_name",),
    ),
    "volume": Scheme(
        noun="a volume",
        opener="open_volume",
        title="Complex image, slice by slice",
        signal="data",
        axes=("z_m", "y_m", "x_m"),
        interpretation="image",
        datasets=(
            Dataset("data", "c8", ("z", "y", "x"), "complex image"),
            *(Dataset(f"{a}_m", "f8", (a,), f"voxel centres, {a}", "m") for a in "xyz"),
            # The axes are for viewers; these two give the grid back exactly.
            Dataset("origin_m", "f8", (3,), "centre of the first voxel x, y, z", "m"),
            Dataset("spacing_m", "f8", (3,), "voxel spacing x, y, z", "m"),
            *(replace(dataset, optional=True) for dataset in INSTRUMENT),
            Dataset(WEIGHTS, "f8", ("freq",), "window", None, True, 2),
        ),
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
            *INSTRUMENT,
            *_by_channel("tx"),
            *_by_channel("rx"),
            Dataset("target_position", "f8", ("n",), "target_parameters"),
            Dataset("target_covariance", "f8", ("n", "n"), "covariance of the position"),
            Dataset("reference_hz", "f8", (1,), "where a gain is the whole response", "Hz"),
            Dataset(
                "target_amplitude", "f8", (1,),
                "amplitude of the echo relative to the target's model",
            ),
            Dataset("residual_db", "f8", (1,), "energy that is left of the echoes", "dB"),
            Dataset("noise_residual_db", "f8", (1,), "what noise alone would leave", "dB"),
        ),
        texts=("array_name", "target", "target_parameters"),
    ),
}  # fmt: skip
"""The formats there are, by the root's `clradar_format`."""


@dataclass(frozen=True, slots=True)
class View:
    """An image that is drawn from the data, for viewers alone: an NXdata group beside it."""

    name: str
    title: str
    data: np.ndarray
    long_name: str
    unit: str | None


VIEW_AXES = ("y_m", "x_m")


@dataclass(frozen=True, slots=True)
class NativeHeader:
    """Of a native file; `created` is ISO 8601, UTC, `unchecked` are datasets without checksums."""

    format: str
    version: int
    created: str
    unchecked: list[str]


def plain_text(field: str, value: str) -> str:
    """Return a string that HDF5 can hold; `ModelError` for one that it cannot."""
    if "\0" in value or value != value.encode("utf-8", "ignore").decode():
        raise ModelError(f"{field}: expected plain text, got {value!r:.100}")
    return value


def write(
    path: Path,
    kind: str,
    text: str,
    texts: dict[str, str],
    values: Mapping[str, Any],
    *,
    force: bool,
    views: Sequence[View] = (),
) -> None:
    """Write a native file whole or not at all; viewers show the first of the views, or the data.

    `text` is the provenance, JSON; `values` are arrays by the names of their datasets, or what
    gives an array a few rows at a time and has a shape.
    """
    refuse_existing(path, force=force)
    import h5py

    scheme = SCHEMES[kind]
    written = [dataset for dataset in scheme.datasets if dataset.name in values]
    size_bytes = sum(_stored_bytes(values[d.name].shape, np.dtype(d.dtype)) for d in written)
    size_bytes += sum(_stored_bytes(view.data.shape, view.data.dtype) for view in views)
    created = _now().isoformat(timespec="seconds")
    # From version 1.10 on HDF5 keeps checksums of its own structures, and long attributes.
    with ExitStack() as stack:
        temporary = stack.enter_context(replacing(path, force=force))
        require_space(temporary, size_bytes + 2 * len(text) + _STRUCTURE_BYTES)
        file = stack.enter_context(h5py.File(temporary, "x", libver=("v110", "v110")))
        file.attrs["NX_class"] = "NXroot"
        file.attrs["default"] = "entry"
        file.attrs["clradar_format"] = kind
        file.attrs["clradar_version"] = max(dataset.version for dataset in written)
        file.attrs["created"] = created
        file.attrs["provenance"] = text
        # HDF5 keeps the strings of attributes where it has no checksum.
        kept = [name for name in (*scheme.texts, *scheme.optional_texts) if name in texts]
        crc32 = text_crc32(created, text, [texts[name] for name in kept])
        file.attrs["text_crc32"] = np.uint32(crc32)
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = "NXentry"
        entry.attrs["default"] = views[0].name if views else "data"
        data = _data_group(entry, "data", scheme.title, scheme.signal, scheme.axes)
        for name in kept:
            data.attrs[name] = texts[name]
        for dataset in written:
            names = texts.get(dataset.long_name)  # a text that lists what each number is
            long_name = dataset.long_name if names is None else names.replace(",", ", ")
            value = values[dataset.name]
            _write_dataset(data, dataset.name, value, dataset.dtype, long_name, dataset.unit)
        data[scheme.signal].attrs["interpretation"] = scheme.interpretation
        note = entry.create_group("provenance")  # for viewers, as what follows
        note.attrs["NX_class"] = "NXnote"
        note["type"], note["data"] = "application/json", text
        for view in views:
            group = _data_group(entry, view.name, view.title, "data", VIEW_AXES)
            _write_dataset(group, "data", view.data, view.data.dtype, view.long_name, view.unit)
            group["data"].attrs["interpretation"] = "image"
            if view.unit is None:  # an amplitude, in dB for silx
                group.attrs["SILX_style"] = '{"signal_scale_type": "log"}'
            for axis in VIEW_AXES:
                group[axis] = data[axis]


def _data_group(entry: Any, name: str, title: str, signal: str, axes: Sequence[str]) -> Any:
    group = entry.create_group(name)
    group.attrs["NX_class"] = "NXdata"
    group.attrs["signal"] = signal
    group.attrs["axes"] = list(axes)
    group.create_dataset("title", data=title)
    return group


def _write_dataset(
    group: Any, name: str, value: Any, dtype: Any, long_name: str, unit: str | None
) -> None:
    """Write a dataset with checksums and the names that viewers show."""
    shape, kind = value.shape, np.dtype(dtype)
    rows = _rows_per_chunk(shape, kind.itemsize)
    options = {"chunks": (rows, *shape[1:]), "shuffle": True, "fletcher32": True}
    made = group.create_dataset(name, shape, kind, **options)
    chunk_bytes = rows * kind.itemsize * math.prod(shape[1:])
    step = rows * max(1, _AT_ONCE_BYTES // chunk_bytes)
    for first in range(0, shape[0], step):  # a few MiB at a time
        made[first : first + step] = value[first : first + step]
    # Viewers write either the long name or the name and the unit.
    made.attrs["long_name"] = long_name if unit is None else f"{long_name} ({unit})"
    if unit is not None:
        made.attrs["units"] = unit
    # At closing HDF5 writes what is left of several datasets in the order of its own addresses.
    made.flush()


def _rows_per_chunk(shape: tuple[int, ...], itemsize: int) -> int:
    # About 1 MiB per chunk, cut along the first axis, so that one pair or slice is read quickly.
    row_bytes = itemsize * math.prod(shape[1:])
    return min(shape[0], max(1, _CHUNK_BYTES // row_bytes))


def _stored_bytes(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    """Return what an array takes in a file, whose last chunk is as long as the others."""
    rows = _rows_per_chunk(shape, dtype.itemsize)
    return -(-shape[0] // rows) * rows * dtype.itemsize * math.prod(shape[1:])


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
