"""Attributes and arrays of a native file, read in the confined process.

Nothing but numbers, text and arrays leaves these functions; `records` makes records of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clradar.files.failures import clean, fail
from measurement_io.confined import hdf5_guard
from measurement_io.confined.hdf5_guard import attribute
from measurement_io.native.scheme import EXPECTED, SCHEMES, VERSION, text_crc32

Contents = dict[str, Any]
_FORMAT = "clradar_format"


def format_of(path: Path) -> str | None:
    """Return our format attribute of the root of an HDF5 file, if it has one."""
    with hdf5_guard.opened(path, "a readable HDF5 file") as file:
        return attribute(path, file, _FORMAT, str) if _FORMAT in file.attrs else None


def read_if_native(path: Path, kind: str | None) -> Contents | None:
    """Return header and arrays of a native file of a format, or any; None for another's file."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        if _FORMAT not in file.attrs:
            return None
        found, data = _header(path, file, kind)
        lengths: dict[str, int] = {}
        found |= {"arrays": {}, "unchecked": []}
        datasets = SCHEMES[found["format"]].datasets
        # The data comes last: what it is a response of says how long its axes have to be.
        for dataset in sorted(datasets, key=lambda dataset: dataset.name == "data"):
            absent = dataset.optional and dataset.name not in data.keys()  # noqa: SIM118 - `in data` would follow links
            if dataset.for_viewers or absent:
                continue
            wanted = [lengths.get(n) if isinstance(n, str) else n for n in dataset.shape]
            array, checked = hdf5_guard.array(
                path, data, dataset.name, dataset.dtype, tuple(wanted)
            )
            for name, length in zip(dataset.shape, array.shape, strict=True):
                if isinstance(name, str) and lengths.setdefault(name, length) != length:
                    got = f"shape {array.shape}"
                    fail(path, f"as many rows as columns in {dataset.name}", got)
            found["arrays"][dataset.name] = array
            if not checked:
                found["unchecked"].append(dataset.name)
        return found


def _header(path: Path, file: Any, wanted: str | None) -> tuple[Contents, Any]:
    """Return the checked root attributes and the group of the data."""
    kind = attribute(path, file, _FORMAT, str)
    version = attribute(path, file, "clradar_version", int)
    if version > VERSION:
        fail(
            path,
            f"a native file of version {VERSION}, the newest that this clradar reads",
            f"version {version}: it was written by a newer clradar; update to read it",
        )
    if version < 1:
        fail(path, f"a native file of version 1 to {VERSION}", f"version {version}")
    if kind not in SCHEMES:
        fail(path, f"clradar_format {' or '.join(map(repr, SCHEMES))}", repr(clean(kind)))
    if wanted is not None and kind != wanted:
        fail(path, SCHEMES[wanted].noun, f"{SCHEMES[kind].noun}; use {SCHEMES[kind].opener}")
    created = attribute(path, file, "created", str)
    text = attribute(path, file, "provenance", str)
    data = hdf5_guard.group(path, hdf5_guard.group(path, file, "entry"), "data")
    optional = (name for name in SCHEMES[kind].optional_texts if name in data.attrs)
    names = (*SCHEMES[kind].texts, *optional)
    texts = {name: attribute(path, data, name, str) for name in names}
    if "text_crc32" in file.attrs:
        want = attribute(path, file, "text_crc32", int)
        have = text_crc32(created, text, list(texts.values()))
        if have != want:
            fail(path, f"text attributes with checksum {want:08x}", f"{have:08x}: they are damaged")
    found: Contents = {"format": kind, "version": version, "created": created}
    return {**found, "provenance": text, "texts": texts}, data
