"""Write shards, HDF5 files in the NeXus convention, and parts, shards of one sample.

Shards are assembled from parts. The same samples give the same bytes: no time is stored, the order
of writing is fixed, and compressed chunks are copied as they are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.sample import Sample
from clradar.dataset.store.shard_reader import fields_of
from clradar.dataset.store.shard_schema import (
    FIELDS,
    FORMAT,
    VERSION,
    Field,
    axes_of,
    label_values,
    labels_of,
)
from clradar.files.atomic import replacing, require_space, write_file

CHUNK_BYTES = 2**20
SMALL_BYTES = 2**16
LIBRARY = ("v110", "v110")
"""Versions of the HDF5 file format that are written."""

RAGGED_ROWS = 2**14
SHOWN_FIRST = ("max_projection", "depth_map")
"""What viewers draw at once, where a shard has it."""


def write_sample(
    path: Path, sample: Sample, made_with: Mapping[str, Any], *, compression: int, force: bool
) -> None:
    """Write one sample with its versions and device, JSON values, whole or not at all.

    `compression` is the level of gzip; with `force` an existing file is replaced.
    """
    import h5py

    # In memory first: HDF5 cannot close a file for which the disk is full.
    with h5py.File(path.name, "x", driver="core", backing_store=False, libver=LIBRARY) as file:
        _fill(file, [dict(sample.recipe)], [_text(made_with)], compression, sample.arrays, [])
        file.flush()
        content = file.id.get_file_image()
    write_file(path, content, force=force)


def assemble(path: Path, parts: Sequence[Path], *, compression: int) -> None:
    """Assemble a shard from parts in their order; replaces the target."""
    import h5py

    with ExitStack() as stack, replacing(path, force=True) as temporary:
        require_space(temporary, sum(part.stat().st_size for part in parts))  # take more
        files = [stack.enter_context(h5py.File(part, "r")) for part in parts]
        recipes = [json.loads(file["entry/labels/recipe"][0]) for file in files]
        made_with = [file["entry/labels/made_with"][0].decode() for file in files]
        with h5py.File(temporary, "x", libver=LIBRARY) as file:
            _fill(file, recipes, made_with, compression, {}, files)


def _fill(
    file: Any,
    recipes: list[dict[str, Any]],
    made_with: list[str],
    compression: int,
    arrays: Mapping[str, np.ndarray],
    files: Sequence[Any],
) -> None:
    """Write a shard of the samples of the open parts `files`, or of one sample's `arrays`."""
    axes = axes_of(recipes[0])
    names = fields_of(files[0]) if files else [name for name in FIELDS if name in arrays]
    file.attrs["NX_class"] = "NXroot"
    file.attrs["default"] = "entry"
    file.attrs["clradar_format"] = FORMAT
    file.attrs["clradar_version"] = VERSION
    entry = file.create_group("entry")
    entry.attrs["NX_class"] = "NXentry"
    entry.attrs["default"] = FIELDS[next((n for n in SHOWN_FIRST if n in names), names[0])].group
    store = _Store(entry, compression)
    store.labels(recipes, made_with)
    store.axes(axes)
    for name in names:
        spec = FIELDS[name]
        group = store.data_group(spec)
        if spec.ragged:
            pieces = [f[spec.place][:] for f in files] if files else [arrays[name]]
            store.ragged(group, spec, pieces)
        elif files:
            store.copied(group, spec, [f[spec.place] for f in files])
        else:
            store.array(group, spec.dataset, arrays[name][None], spec.units, spec.long_name)
        if spec.axes[-2:] == ("y_m", "x_m"):
            group[spec.dataset].attrs["interpretation"] = "image"


def _text(value: Mapping[str, Any]) -> str:
    return json.dumps(value, allow_nan=False)


class _Store:
    """Writer of the group `/entry` of a shard."""

    def __init__(self, entry: Any, compression: int) -> None:
        self._entry = entry
        self._filters = {
            "compression": "gzip",
            "compression_opts": compression,
            "shuffle": True,
            "fletcher32": True,
            "track_times": False,
        }

    def labels(self, recipes: list[dict[str, Any]], made_with: list[str]) -> None:
        group = self._entry.create_group("labels")
        group.attrs["NX_class"] = "NXcollection"
        index = np.array([recipe["sample"] for recipe in recipes], dtype=np.int64)
        self.array(group, "sample", index, None, "number of the sample in the plan")
        found = {
            **label_values(recipes),
            "recipe": [_text(recipe) for recipe in recipes],
            "made_with": made_with,
        }
        for name, label in labels_of(recipes[0]).items():
            self.array(group, name, _bytes(found[name]), label.units, label.long_name)
            if label.axes:
                group[name].attrs["axes"] = ["sample", *label.axes]

    def axes(self, axes: Mapping[str, Any]) -> None:
        group = self._entry.create_group("axes")
        group.attrs["NX_class"] = "NXcollection"
        for name, axis in axes.items():
            self.array(group, name, _bytes(axis.values), axis.units, name)

    def data_group(self, spec: Field) -> Any:
        """Return the NXdata group of a field, created with links to its axes if it is missing."""
        if spec.group in self._entry:
            return self._entry[spec.group]
        group = self._entry.create_group(spec.group)
        group.attrs["NX_class"] = "NXdata"
        group.attrs["signal"] = spec.dataset
        group.attrs["title"] = spec.long_name
        group["sample"] = self._entry["labels/sample"]
        if not spec.ragged:
            group.attrs["axes"] = ["sample", *spec.axes]
        for axis in spec.axes:
            if axis in self._entry["axes"]:
                group[axis] = self._entry[f"axes/{axis}"]
        if spec.group == "capture":
            for name in ("tx_m", "rx_m"):
                group[name] = self._entry[f"axes/{name}"]
        return group

    def array(
        self, group: Any, name: str, value: np.ndarray, units: str | None, long_name: str
    ) -> None:
        """Write an array of samples, or an axis."""
        made = group.create_dataset(name, data=value, chunks=_chunks(value), **self._filters)
        _describe(made, units, long_name)

    def copied(self, group: Any, spec: Field, sources: Sequence[Any]) -> None:
        """Concatenate the compressed chunks of parts without decompressing them."""
        first = sources[0]
        shape = (len(sources), *first.shape[1:])
        made = group.create_dataset(
            spec.dataset, shape=shape, dtype=first.dtype, chunks=first.chunks, **self._filters
        )
        for row, source in enumerate(sources):
            for i in range(source.id.get_num_chunks()):
                offset = source.id.get_chunk_info(i).chunk_offset
                mask, content = source.id.read_direct_chunk(offset)
                made.id.write_direct_chunk((row, *offset[1:]), content, mask)
        _describe(made, spec.units, spec.long_name)

    def ragged(self, group: Any, spec: Field, pieces: Sequence[np.ndarray]) -> None:
        first = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])])
        value = np.concatenate(pieces)
        chunks = (min(len(value), RAGGED_ROWS), *value.shape[1:])
        made = group.create_dataset(spec.dataset, data=value, chunks=chunks, **self._filters)
        _describe(made, spec.units, spec.long_name)
        name = f"{spec.dataset}_first"
        self.array(
            group, name, first.astype(np.int64), None, f"where {spec.dataset} begin, and end"
        )


def _describe(made: Any, units: str | None, long_name: str) -> None:
    # Viewers write one or the other; names of axes have their unit already.
    own = units is None or long_name.endswith(f"_{units}")
    made.attrs["long_name"] = long_name if own else f"{long_name} ({units})"
    if units is not None:
        made.attrs["units"] = units
    made.flush()  # in this order, and not in that of addresses at closing: files of equal bytes


def _chunks(value: np.ndarray) -> tuple[int, ...]:
    """Return a chunk shape of about 1 MiB within one row of the first axis, or the whole array."""
    if value.nbytes <= SMALL_BYTES:
        return value.shape
    rest = value.shape[1:]
    if not rest:
        return (min(len(value), CHUNK_BYTES // value.itemsize),)
    plane_bytes = max(1, int(np.prod(rest[1:])) * value.itemsize)
    return (1, min(rest[0], max(1, CHUNK_BYTES // plane_bytes)), *rest[1:])


def _bytes(values: Any) -> np.ndarray:
    """Return numbers unchanged, texts as UTF-8 of a fixed length."""
    if isinstance(values, np.ndarray):
        return values
    import h5py

    encoded = [text.encode("utf-8") for text in values]
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, *map(len, encoded))))
