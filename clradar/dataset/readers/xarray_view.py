"""A data set as an `xarray.Dataset` of Dask arrays, read when they are computed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.plan.plan import plan_record
from clradar.dataset.readers.index import Index, read_index
from clradar.dataset.store.folder import Manifest
from clradar.dataset.store.shard_reader import fields_of, opened_shard
from clradar.dataset.store.shard_schema import FIELDS, LABELS, Field
from clradar.errors import MissingPackage
from clradar.files.json_text import to_json

if TYPE_CHECKING:
    import xarray

CHUNK_BYTES = 2**25
"""Approximate size of the chunks of Dask arrays."""

NAMES = ("pose", "handedness", "rig")
"""Labels that are coordinates of the samples."""

INSTALL = "pip install 'clradar[dataset]'"


def open_dataset(folder: str | os.PathLike[str], *, sequences: bool = False) -> xarray.Dataset:
    """Return a data set with its axes, units and labels.

    Parameters
    ----------
    folder : path-like
        A data set, as ``clradar dataset`` writes it, complete or not.
    sequences : bool
        Of a data set whose plan has [movement]: along `sequence` and `frame` instead of `sample`;
        without meshes, and without sequences that lack a frame.

    Returns
    -------
    xarray.Dataset
        Along `sample`, whose coordinate is the number in the plan: the products, each label, and
        `pose`, `handedness` and `rig` as further coordinates. Everything but these is a Dask array
        that reads its shard when it is computed. Meshes are concatenated along an axis of their
        own: those of sample i begin at ``mesh_vertices_first[i]`` and end before
        ``mesh_vertices_end[i]``; faces index the vertices of their own mesh. In `attrs`: `plan` and
        `made_with` as JSON, `complete`, `set_aside`. Recipes are JSON texts:
        ``make_sample(view.recipe.values[0])`` makes a sample again.

    Raises
    ------
    MeasurementError
        It is no data set, damaged, or has no closed shard.
    MissingPackage
        xarray or Dask is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import open_dataset, read_plan, run
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> result = run(read_plan("plan.toml"), Path("letters"))
    >>> view = open_dataset("letters")
    >>> view.pose.values.tolist(), view.joints.dims
    (['A', 'B'], ('sample', 'joint', 'coordinate'))
    >>> bool(view.joints.sel(sample=0, joint="wrist", coordinate="z") > 0.2)  # metres
    True
    """
    try:
        import dask.array  # noqa: F401 - here, so that the error names what to install
        import xarray
    except ImportError as error:
        raise MissingPackage(
            f"open_dataset: expected xarray and dask, got {error}; {INSTALL}"
        ) from error
    index = read_index(folder)
    whole = index.sequences("open_dataset") if sequences else None
    shards = _Shards(index)
    with opened_shard(index.files[0]) as file:
        coordinates = _coordinates(file)
        variables: dict[str, Any] = {}
        for name in fields_of(file):
            spec = FIELDS[name]
            if spec.ragged:
                variables |= shards.ragged(name, spec)
            else:
                variables[name] = shards.stacked(file, spec.place, spec.axes)
        for name, label in LABELS.items():
            if name not in NAMES and name in file["entry/labels"]:
                variables[name] = shards.stacked(file, f"entry/labels/{name}", label.axes)
    coordinates["sample"] = ("sample", shards.whole("entry/labels/sample"))
    for name in NAMES:
        texts = shards.whole(f"entry/labels/{name}")
        coordinates[name] = ("sample", np.char.decode(texts, "utf-8"))
    view = xarray.Dataset(variables, coordinates, _attributes(index.manifest))
    return view if whole is None else _sequences(view, whole)


def _sequences(view: xarray.Dataset, whole: np.ndarray) -> xarray.Dataset:
    """The samples at positions (n, n_frames) along `sequence` and `frame`."""
    meshes = [name for name in view.variables if str(name).startswith("mesh_")]
    kept = view.drop_vars([*meshes, "sequence", "frame"]).isel(sample=whole.reshape(-1))
    numbers = kept["sample"].values.reshape(whole.shape)
    split = kept.drop_vars("sample").coarsen(sample=whole.shape[1])
    made = split.construct(sample=("sequence", "frame"))
    made = made.assign_coords(
        sample=(("sequence", "frame"), numbers),
        sequence=numbers[:, 0] // whole.shape[1],
        frame=np.arange(whole.shape[1]),
    )
    return made.assign_attrs(view.attrs)


def _coordinates(file: Any) -> dict[str, Any]:
    """Return the axes that samples share, by name; positions of antennas along tx and rx."""
    found = {}
    for name, axis in file["entry/axes"].items():
        values = axis[:]
        if values.dtype.kind == "S":
            values = np.char.decode(values, "utf-8")
        dims = (name[:2], "coordinate") if name in ("tx_m", "rx_m") else (name,)
        found[name] = (dims, values, _units(axis))
    return found


def _units(dataset: Any) -> dict[str, str]:
    found = {key: str(dataset.attrs[key]) for key in ("units", "long_name") if key in dataset.attrs}
    if "long_name" in found:  # xarray writes the units beside it
        found["long_name"] = found["long_name"].removesuffix(f" ({found.get('units')})")
    return found


def _attributes(manifest: Manifest) -> dict[str, Any]:
    return {
        "complete": int(manifest.complete),
        "set_aside": len(manifest.aside),
        "plan": to_json("plan", plan_record(manifest.plan)),
        "made_with": to_json("made_with", manifest.made_with),
    }


@dataclass(frozen=True, slots=True)
class _Lazy:
    """One array of one shard; opens the file for each read, so that it can be pickled."""

    path: Path
    place: str
    shape: tuple[int, ...]
    dtype: np.dtype
    ndim: int

    def __getitem__(self, key: Any) -> np.ndarray:
        with opened_shard(self.path) as file:
            found: np.ndarray = file[self.place][key]
        if self.dtype.kind == "U":
            found = np.char.decode(found, "utf-8")
        return found.astype(self.dtype, copy=False)


class _Shards:
    """Arrays concatenated over the shards."""

    def __init__(self, index: Index) -> None:
        self._index = index

    def whole(self, place: str) -> np.ndarray:
        """Read a small array."""
        found = []
        for path in self._index.files:
            with opened_shard(path) as file:
                found.append(file[place][:])
        return np.concatenate(found)

    def stacked(self, file: Any, place: str, axes: Sequence[str]) -> Any:
        """Return an array with one row per sample as a variable; `file` is any open shard."""
        import xarray

        model = file[place]
        dtype = model.dtype if model.dtype.kind != "S" else self._text_type(place)
        rows = [(count, model.shape[1:]) for count in self._index.counts]
        array = self._joined(place, rows, dtype)
        return xarray.Variable(("sample", *axes), array, _units(model))

    def _text_type(self, place: str) -> np.dtype:
        """Return the type of texts with the longest length of all shards."""
        sizes = []
        for path in self._index.files:
            with opened_shard(path) as file:
                sizes.append(file[place].dtype.itemsize)
        return np.dtype(f"U{max(sizes)}")  # no text has more characters than bytes

    def ragged(self, name: str, spec: Field) -> dict[str, Any]:
        """Return the rows of a ragged array, and the first row and the end of each sample."""
        import xarray

        place = spec.place
        begins, ends, rows, offset = [], [], [], 0
        for path in self._index.files:
            with opened_shard(path) as file:
                first = file[f"{place}_first"][:]
                model = file[place]
                rest, dtype, units = model.shape[1:], model.dtype, _units(model)
            begins.append(first[:-1] + offset)
            ends.append(first[1:] + offset)
            rows.append((int(first[-1]), rest))
            offset += int(first[-1])
        row = f"{name}_row"
        return {
            name: xarray.Variable((row, *spec.axes), self._joined(place, rows, dtype), units),
            f"{name}_first": xarray.Variable(("sample",), np.concatenate(begins)),
            f"{name}_end": xarray.Variable(("sample",), np.concatenate(ends)),
        }

    def _joined(self, place: str, rows: list[tuple[int, tuple[int, ...]]], dtype: Any) -> Any:
        import dask.array

        pieces = []
        for path, sha256, (count, rest) in zip(
            self._index.files, self._index.sha256, rows, strict=True
        ):
            row_bytes = max(1, int(np.prod(rest)) * dtype.itemsize)
            step = max(1, min(count, CHUNK_BYTES // row_bytes))
            shape = (count, *rest)
            lazy = _Lazy(path, place, shape, np.dtype(dtype), len(shape))
            name = f"{place}-{sha256}"
            pieces.append(
                dask.array.from_array(lazy, chunks=(step, *rest), name=name, asarray=False)
            )
        return pieces[0] if len(pieces) == 1 else dask.array.concatenate(pieces)
