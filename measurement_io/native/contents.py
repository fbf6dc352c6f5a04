"""Attributes and arrays of a native file, read in the confined process.

Nothing but numbers, text and arrays leaves these functions; `native` and `channels_file` make
records of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import clean, fail
from measurement_io.confined import hdf5_guard
from measurement_io.native.scheme import (
    EXPECTED,
    NX_CLASSES,
    SCHEMES,
    VERSION,
    VIEW_AXES,
    VIEWS,
    Dataset,
    text_crc32,
)

Contents = dict[str, Any]
_FORMAT = "clradar_format"


def is_native(path: Path) -> bool:
    """Whether the root of an HDF5 file has our format attribute."""
    with hdf5_guard.opened(path, "a readable HDF5 file") as file:
        return _FORMAT in file.attrs


def read_if_native(path: Path, kind: str | None) -> Contents | None:
    """Return the header of a native file of a format, of any without `kind`, and arrays by name.

    None if the root has no format attribute of ours.
    """
    with hdf5_guard.opened(path, EXPECTED) as file:
        return _read(path, file, kind) if _FORMAT in file.attrs else None


def _read(path: Path, file: Any, kind: str | None) -> Contents:
    header, data = _header(path, file, kind)
    kind = header["format"]
    lengths: dict[str, int] = {}
    arrays: Contents = {}
    # The data comes last: what it is a response of says how long its axes have to be.
    for dataset in sorted(SCHEMES[kind].datasets, key=lambda dataset: dataset.name == "data"):
        if dataset.for_viewers or (dataset.optional and dataset.name not in data.keys()):  # noqa: SIM118 - `in data` would follow links
            continue
        arrays[dataset.name] = _array(path, data, dataset, lengths)
    return {"header": header, "arrays": arrays}


def _array(path: Path, data: Any, dataset: Dataset, lengths: dict[str, int]) -> np.ndarray:
    """Return one dataset, whose named lengths are those of the datasets before it."""
    wanted = [lengths.get(n) if isinstance(n, str) else n for n in dataset.shape]
    found = hdf5_guard.array(path, data, dataset.name, dataset.dtype, tuple(wanted))
    for name, length in zip(dataset.shape, found.shape, strict=True):
        if isinstance(name, str) and lengths.setdefault(name, length) != length:
            fail(path, f"as many rows as columns in {dataset.name}", f"shape {found.shape}")
    return found


def read_header(path: Path) -> Contents:
    """Return the root's attributes."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        return _header(path, file, None)[0]


def nexus_problems(path: Path) -> list[str]:
    """Return missing NeXus attributes and checksums, which reading does not need."""
    problems = []
    with hdf5_guard.opened(path, EXPECTED) as file:
        header, data = _header(path, file, None)
        scheme = SCHEMES[header["format"]]
        entry = file["entry"]
        for name, node in (("/", file), ("/entry", entry)):
            problems += _attribute_problem(path, node, "NX_class", NX_CLASSES[name])
        problems += _attribute_problem(path, file, "default", "entry")
        views = _views(path, entry) if header["format"] == "volume" else {}
        # Files before the views have the data as their default, and so have those without any.
        problems += _attribute_problem(path, entry, "default", next(iter(views), "data"))
        problems += _group_problems(path, data, scheme.signal, scheme.axes)
        for view in views.values():
            problems += _group_problems(path, view, "data", VIEW_AXES)
            if not hdf5_guard.has_checksum(hdf5_guard.dataset(path, view, "data")):
                problems.append(f"{view.name}/data: carries no Fletcher-32 checksum")
        for dataset in scheme.datasets:
            name = dataset.name
            if dataset.optional and name not in data.keys():  # noqa: SIM118
                continue
            found = hdf5_guard.dataset(path, data, name)
            if not hdf5_guard.has_checksum(found):
                problems.append(f"/entry/data/{name}: carries no Fletcher-32 checksum")
            if dataset.for_viewers:
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


def read_views(path: Path) -> Contents:
    """Return the views of a native volume, those that there are, each shape (n_y, n_x)."""
    types = dict(zip(VIEWS, (np.float32, np.float64), strict=True))
    with hdf5_guard.opened(path, EXPECTED) as file:
        _, data = _header(path, file, "volume")
        shape = tuple(hdf5_guard.dataset(path, data, axis).size for axis in VIEW_AXES)
        views = _views(path, file["entry"])
        return {
            name: hdf5_guard.array(path, view, "data", types[name], shape)
            for name, view in views.items()
        }


def _views(path: Path, entry: Any) -> dict[str, Any]:
    """Return the groups of the views, in the order of `VIEWS`."""
    return {name: hdf5_guard.group(path, entry, name) for name in VIEWS if name in entry.keys()}  # noqa: SIM118 - `in entry` would follow links


def _group_problems(path: Path, group: Any, signal: str, axes: Sequence[str]) -> list[str]:
    problems = _attribute_problem(path, group, "NX_class", NX_CLASSES["/entry/data"])
    problems += _attribute_problem(path, group, "signal", signal)
    wanted = list(axes)
    if "axes" not in group.attrs or hdf5_guard.texts(path, group, "axes") != wanted:
        problems.append(f"{group.name}@axes: expected {wanted}")
    return problems


def _attribute_problem(path: Path, node: Any, name: str, want: str) -> list[str]:
    have = hdf5_guard.text(path, node, name) if name in node.attrs else "nothing"
    return [] if have == want else [f"{node.name}@{name}: expected {want}, got {clean(have)}"]


def _header(path: Path, file: Any, wanted: str | None) -> tuple[Contents, Any]:
    """Return the checked root attributes and the group of the data."""
    if _FORMAT not in file.attrs:
        fail(
            path,
            "a native capture or volume",
            "an HDF5 file without the attribute clradar_format, so of another program",
        )
    kind = hdf5_guard.text(path, file, _FORMAT)
    version = hdf5_guard.whole_number(path, file, "clradar_version")
    if version > VERSION:
        fail(
            path,
            f"a native file of version {VERSION}, the newest that this clradar reads",
            f"version {version}: it was written by a newer clradar; update to read it",
        )
    if version < 1:
        fail(path, f"a native file of version 1 to {VERSION}", f"version {version}")
    if kind not in SCHEMES:
        formats = " or ".join(repr(name) for name in SCHEMES)
        fail(path, f"clradar_format {formats}", repr(clean(kind)))
    if wanted is not None and kind != wanted:
        fail(path, SCHEMES[wanted].noun, f"{SCHEMES[kind].noun}; use {SCHEMES[kind].opener}")
    created = hdf5_guard.text(path, file, "created")
    text = hdf5_guard.text(path, file, "provenance")
    data = hdf5_guard.group(path, hdf5_guard.group(path, file, "entry"), "data")
    optional = (name for name in SCHEMES[kind].optional_texts if name in data.attrs)
    names = (*SCHEMES[kind].texts, *optional)
    texts = {name: hdf5_guard.text(path, data, name) for name in names}
    if "text_crc32" in file.attrs:
        want = hdf5_guard.whole_number(path, file, "text_crc32")
        have = text_crc32(created, text, list(texts.values()))
        if have != want:
            fail(path, f"text attributes with checksum {want:08x}", f"{have:08x}: they are damaged")
    found = {"format": kind, "version": version, "created": created, "provenance": text}
    return {**found, "texts": texts}, data
