"""Shards and parts that may be damaged or hostile, read in a confined process.

`measurement_io.confined.reading` has the limits of that process. What it returns is plain:
texts and arrays, of which the caller believes nothing before it is compared with the plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.sample import Sample
from clradar.dataset.store.shard_reader import (
    EXPECTED,
    check_format,
    fields_of,
    row_of,
    sample_of,
)
from clradar.dataset.store.shard_schema import FIELDS, LABELS
from clradar.files.failures import reading
from clradar.files.json_text import parse_object
from measurement_io.confined import hdf5_guard
from measurement_io.confined.reading import run

FILTERS = (*hdf5_guard.CHECKING_FILTERS, hdf5_guard.DEFLATE)

BLOCK_BYTES = 2**28
"""Of an array that is in memory at a time."""


@dataclass(frozen=True, slots=True)
class ArrayContents:
    """An array of `FIELDS` as it is stored.

    `first` is the row at which each sample of a ragged array begins, and the end. `invalid` are the
    rows with numbers that are not finite; of depth maps, whose NaN is no depth, infinite ones.
    """

    dtype: str
    shape: list[int]
    first: np.ndarray | None
    invalid: list[int]


@dataclass(frozen=True, slots=True)
class ShardContents:
    """A shard or part without the numbers of its arrays, all of which have been read.

    `labels` are those of `LABELS` that are there, and the numbers of the samples, "sample".
    """

    labels: dict[str, np.ndarray]
    axes: dict[str, np.ndarray]
    arrays: dict[str, ArrayContents]


def read_contents(path: Path, data_bytes: int) -> ShardContents:
    """Read all of a shard or part, which verifies its checksums.

    The expected size of its arrays, `data_bytes`, decides what the confined process may use.

    Raises
    ------
    MeasurementError
        Damaged, or no shard.
    """
    found = run(_contents, path, most_bytes=_limit(path, data_bytes))
    arrays = {name: ArrayContents(**array) for name, array in found["arrays"].items()}
    return ShardContents(found["labels"], found["axes"], arrays)


def read_sample(path: Path, sample: int, data_bytes: int) -> tuple[Sample, dict[str, Any]]:
    """Return a stored sample, and the versions and the device that made it.

    Raises
    ------
    MeasurementError
        Damaged, no shard, or without this sample.
    """
    found = run(_sample, path, sample, most_bytes=_limit(path, data_bytes))
    with reading(path, EXPECTED):
        stored = Sample(parse_object(found["recipe"]), found["arrays"])
        return stored, parse_object(found["made_with"])


def _limit(path: Path, data_bytes: int) -> int:
    return data_bytes + 8 * path.stat().st_size


class _Guarded:
    """An open shard whose groups and datasets are opened without following links to other files."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file

    def group(self, names: list[str]) -> Any:
        group = self._file
        for name in names:
            group = hdf5_guard.group(self._path, group, name)
        return group

    def __getitem__(self, place: str) -> Any:
        *above, name = place.split("/")
        return hdf5_guard.dataset(self._path, self.group(above), name, FILTERS)

    def __contains__(self, place: str) -> bool:
        group = self._file
        *above, last = place.split("/")
        for name in above:
            if name not in group.keys():  # noqa: SIM118 - `in group` would follow links
                return False
            group = hdf5_guard.group(self._path, group, name)
        return last in group.keys()  # noqa: SIM118


@contextmanager
def _opened(path: Path) -> Iterator[_Guarded]:
    with hdf5_guard.opened(path, EXPECTED) as file:
        check_format(
            path,
            hdf5_guard.text(path, file, "clradar_format"),
            hdf5_guard.whole_number(path, file, "clradar_version"),
        )
        yield _Guarded(path, file)


def _contents(path: Path) -> dict[str, Any]:
    with _opened(path) as file:
        axes = list(file.group(["entry", "axes"]).keys())
        return {
            "labels": _labels(file),
            "axes": {name: file[f"entry/axes/{name}"][:] for name in axes},
            "arrays": {name: _array(file, name) for name in fields_of(file)},
        }


def _labels(file: _Guarded) -> dict[str, Any]:
    places = {name: f"entry/labels/{name}" for name in ("sample", *LABELS)}
    return {name: file[place][:] for name, place in places.items() if place in file}


def _array(file: _Guarded, name: str) -> dict[str, Any]:
    spec = FIELDS[name]
    data = file[spec.place]
    row_bytes = int(np.prod(data.shape[1:])) * data.dtype.itemsize
    step = max(1, BLOCK_BYTES // max(1, row_bytes))
    invalid: list[int] = []
    for at in range(0, len(data), step):
        block = data[at : at + step]
        if block.dtype.kind in "fc":
            wrong = np.isinf(block) if name == "depth_map" else ~np.isfinite(block)
            invalid += (at + np.flatnonzero(wrong.reshape(len(block), -1).any(axis=1))).tolist()
    return {
        "dtype": data.dtype.name,
        "shape": list(data.shape),
        "first": file[spec.first_place][:] if spec.ragged else None,
        "invalid": invalid,
    }


def _sample(path: Path, sample: int) -> dict[str, Any]:
    with _opened(path) as file:
        row = row_of(file, path, sample)
        found = sample_of(file, row)
        return {
            "recipe": file["entry/labels/recipe"][row].decode(),
            "made_with": file["entry/labels/made_with"][row].decode(),
            "arrays": dict(found.arrays),
        }
