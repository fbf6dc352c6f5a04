"""Read shards and parts, HDF5 files of samples."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.sample import Sample
from clradar.dataset.store.shard_schema import FIELDS, FORMAT, VERSION
from clradar.files.failures import fail, reading, regular_file_size

EXPECTED = "a shard of a data set (HDF5)"


@contextmanager
def opened_shard(path: Path) -> Iterator[Any]:
    """Open a shard for reading, in this process.

    The HDF5 library is not safe against damaged files: what may be damaged is read by
    `clradar.dataset.store.confined_reader`. A data set from elsewhere is verified by
    ``clradar inspect DIR --check`` first.

    Raises
    ------
    MeasurementError
        Missing, no HDF5 file, no shard, or of a newer version; and for any error of h5py while the
        block runs.
    """
    import h5py

    regular_file_size(path, EXPECTED)
    with reading(path, EXPECTED), h5py.File(path, "r") as file:
        check_format(path, file.attrs.get("clradar_format"), file.attrs.get("clradar_version"))
        yield file


def check_format(path: Path, name: Any, version: Any) -> None:
    """Raise `MeasurementError` unless these attributes are those of a shard."""
    if name != FORMAT:
        fail(path, EXPECTED, "another HDF5 file")
    if version > VERSION:
        fail(path, f"version {VERSION} or older", f"{version}; update clradar")


def fields_of(file: Any) -> list[str]:
    """Return the names of `FIELDS` that a shard has."""
    return [name for name, f in FIELDS.items() if f.place in file]


def sample_of(file: Any, row: int) -> Sample:
    """Return one sample of an open shard."""
    arrays = {}
    for name in fields_of(file):
        spec = FIELDS[name]
        dataset = file[spec.place]
        if spec.ragged:
            first = file[spec.first_place]
            arrays[name] = dataset[int(first[row]) : int(first[row + 1])]
        else:
            arrays[name] = dataset[row]
    return Sample(json.loads(file["entry/labels/recipe"][row]), arrays)


def made_with_of(file: Any, row: int) -> dict[str, Any]:
    """Return the versions and the device that made one sample of an open shard."""
    return json.loads(file["entry/labels/made_with"][row])


def row_of(file: Any, path: Path, sample: int) -> int:
    """Return the row of a sample in an open shard."""
    rows = np.flatnonzero(file["entry/labels/sample"][:] == sample)
    if len(rows) != 1:
        fail(path, f"sample {sample} once", f"{len(rows)} times")
    return int(rows[0])
