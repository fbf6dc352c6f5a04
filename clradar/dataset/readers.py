"""Readers of data sets: an `xarray.Dataset` of Dask arrays; a map-style one for PyTorch."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.folder import read_manifest, shard_name
from clradar.dataset.plan.plan import plan_record
from clradar.dataset.shards import ARRAYS, LABELS, arrays_of, labels_of, opened_shard, samples_of
from clradar.errors import ClradarError, MissingPackage
from clradar.files.failures import fail
from clradar.files.json_text import to_json
from clradar.model import checks

if TYPE_CHECKING:
    import xarray

CHUNK_BYTES = 2**25
"""Approximate size of the chunks of Dask arrays."""

NAMES = ("sample", "pose", "handedness", "rig")
"""Labels that are coordinates of the samples."""


class _Stored:
    """The stored samples of a data set: `rows` has the shard and the row of each."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.manifest = read_manifest(Path(folder))
        self.plan = self.manifest.plan
        self.rows: list[tuple[Path, int]] = []
        self.samples: list[int] = []
        for number in sorted(self.manifest.shards):
            path = Path(folder) / shard_name(number)
            with opened_shard(path) as file:
                samples = samples_of(file)
            self.rows += ((path, row) for row in range(len(samples)))
            self.samples += samples
        if not self.samples:
            fail(Path(folder), "a data set with at least one shard of samples", "none")

    def sequences(self, function: str) -> np.ndarray:
        """Return the positions of the samples of all whole sequences, shape (n, n_frames)."""
        if self.plan.movement is None:
            checks.fail(f"{function}: sequences", "a data set whose plan has [movement]", "none")
        place = {sample: position for position, sample in enumerate(self.samples)}
        frames = self.plan.movement.frames
        firsts = sorted(sample for sample in self.samples if sample % frames == 0)
        wanted = [range(first, first + frames) for first in firsts]
        whole = [[place[s] for s in own] for own in wanted if all(s in place for s in own)]
        return np.array(whole, dtype=np.int64).reshape(-1, frames)


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
        Along `sample`, the number in the plan: products and labels, as Dask arrays that read their
        shard when they are computed, and `pose`, `handedness` and `rig` as coordinates. The meshes
        of sample i begin at ``mesh_vertices_first[i]`` and end before ``mesh_vertices_end[i]``;
        faces index the vertices of their own mesh. In `attrs`: `plan` and `made_with` as JSON,
        `complete`, `set_aside`. ``make_sample(view.recipe.values[0])`` makes a sample again.

    Examples
    --------
    >>> from clradar.dataset import open_dataset, read_plan, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> view = open_dataset("letters")
    >>> view.pose.values.tolist(), view.joints.dims
    (['A', 'B'], ('sample', 'joint', 'coordinate'))
    >>> bool(view.joints.sel(sample=0, joint="wrist", coordinate="z") > 0.2)  # metres
    True
    """
    try:
        import dask.array  # noqa: F401 - here, so that the error names what to install
        import xarray  # noqa: F401
    except ImportError as error:
        raise MissingPackage(
            f"open_dataset: expected xarray and dask, got {error}; pip install xarray 'dask[array]'"
        ) from error
    stored = _Stored(folder)
    whole = stored.sequences("open_dataset") if sequences else None
    view = _view([*dict.fromkeys(path for path, _ in stored.rows)])
    view.attrs = {
        "complete": int(not stored.manifest.missing),
        "set_aside": len(stored.manifest.aside),
        "plan": to_json("plan", plan_record(stored.plan)),
        "made_with": to_json("made_with", stored.manifest.made_with),
    }
    return view if whole is None else _sequences(view, whole)


def _view(paths: list[Path]) -> xarray.Dataset:
    """Return the samples of shards, with rows of meshes along axes of their own."""
    import dask.array
    import xarray

    fields = {**ARRAYS, **LABELS}
    parts: dict[str, list[Any]] = defaultdict(list)
    coordinates: dict[str, Any] = {}
    for path in paths:
        with opened_shard(path) as file:
            for name, field in fields.items():
                if field.place in file:
                    parts[name].append(_lazy(path, file[field.place]))
                if field.place in file and field.ragged:
                    offset = parts[f"{name}_end"][-1][-1] if parts[f"{name}_end"] else 0
                    edges = offset + file[f"{field.place}_first"][:]
                    parts[f"{name}_first"].append(edges[:-1])
                    parts[f"{name}_end"].append(edges[1:])
            for name, axis in file["entry/axes"].items() if not coordinates else ():
                dims = (name[:2], "coordinate") if name in ("tx_m", "rx_m") else (name,)
                coordinates[name] = (dims, _values(axis), _units(axis.attrs.get("units"), name))
    variables: dict[str, Any] = {}
    for name, own in parts.items():
        if name not in fields:  # where meshes begin and end
            variables[name] = ("sample", np.concatenate(own))
            continue
        field = fields[name]
        first = f"{name}_row" if field.ragged else "sample"
        whole = dask.array.concatenate(own)
        where = coordinates if name in NAMES else variables
        values = whole.compute() if name in NAMES else whole
        where[name] = ((first, *field.axes), values, _units(field.units, field.long_name))
    return xarray.Dataset(variables, coordinates)


def _values(dataset: Any, key: Any = ...) -> np.ndarray:
    found: np.ndarray = dataset[key]
    return np.char.decode(found, "utf-8") if dataset.dtype.kind == "S" else found


def _units(units: str | None, long_name: str) -> dict[str, str]:
    return {"long_name": long_name} | ({} if units is None else {"units": str(units)})


def _lazy(path: Path, dataset: Any) -> Any:
    """Return a Dask array that reads its shard when it is computed."""
    import dask.array

    text = dataset.dtype.kind == "S"  # no text has more characters than bytes
    dtype = np.dtype(f"U{dataset.dtype.itemsize}") if text else dataset.dtype
    rest = dataset.shape[1:]
    step = max(1, CHUNK_BYTES // max(1, int(np.prod(rest)) * dtype.itemsize))
    lazy = _Lazy(path, dataset.name, dataset.shape, dtype, dataset.ndim)
    return dask.array.from_array(lazy, chunks=(step, *rest), name=False, asarray=False)


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
            return _values(file[self.place], key).astype(self.dtype, copy=False)


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


class TorchDataset:
    """Samples as dictionaries of tensors, for `torch.utils.data.DataLoader`.

    It can be pickled, and forked: no file stays open. Depth maps have NaN where there is no depth.

    Parameters
    ----------
    folder : path-like
        A data set, as ``clradar dataset`` writes it.
    names : sequence of str
        Keys of each sample: products that all have one shape ("max_projection", "volume",
        "joints", ...), labels ("alpha", "angles_rad", ...), "pose" and "handedness" as numbers (see
        `poses`; 0 is right, 1 left), and "sample", its number in the plan.
    transform : callable, optional
        Applied to each dictionary.
    sequences : bool
        Of a data set whose plan has [movement]: an item is a sequence, and each value has its
        frames along a first axis. Sequences that lack a frame are left out.

    Attributes
    ----------
    poses : tuple of str
        Names of the poses by their numbers in "pose".

    Examples
    --------
    >>> from clradar.dataset import TorchDataset, read_plan, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> data = TorchDataset("letters", ("joints", "pose"))
    >>> len(data), data.poses  # data[0]["joints"] is a tensor of shape (25, 3)
    (2, ('A', 'B'))
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        names: Sequence[str] = ("max_projection", "pose"),
        transform: Callable[[dict[str, Any]], Any] | None = None,
        *,
        sequences: bool = False,
    ) -> None:
        stored = _Stored(folder)
        plan, self._rows, self._transform = stored.plan, stored.rows, transform
        positions = stored.sequences("TorchDataset") if sequences else np.arange(len(stored.rows))
        self._positions: np.ndarray = positions
        self.poses = tuple(pose.name for pose in plan.poses.poses)
        fields = {**arrays_of(plan.output.products), **labels_of(plan)}
        known = [n for n, own in fields.items() if own.dtype != "text" and not own.ragged]
        known.append("handedness")
        named = plan.poses.kind in ("list", "around")
        if named and (plan.movement is None or plan.movement.poses == "stay"):
            known.append("pose")
        for name in names:
            checks.one_of("TorchDataset: names", name, tuple(known))
        self._places = {name: fields[name].place for name in names}

    def __len__(self) -> int:
        return len(self._positions)

    def __getitem__(self, position: int) -> Any:
        """Return the sample or sequence at a position, negative ones from the end."""
        try:
            import torch
        except ImportError as error:
            raise ClradarError(f"TorchDataset: expected PyTorch, got {error}") from error
        if not -len(self) <= position < len(self):
            raise IndexError(f"position {position} of a data set of {len(self)} samples")
        places = self._positions[position]
        values = [self._values(int(place)) for place in places.reshape(-1)]
        sample = {
            name: torch.as_tensor(np.stack([own[name] for own in values]) if places.ndim else value)
            for name, value in values[0].items()
        }
        return sample if self._transform is None else self._transform(sample)

    def _values(self, place: int) -> dict[str, Any]:
        path, row = self._rows[place]
        numbers = {"handedness": ("right", "left"), "pose": self.poses}
        with opened_shard(path) as file:
            found = {name: file[own][row] for name, own in self._places.items()}
        return {
            name: numbers[name].index(value.decode()) if name in numbers else np.asarray(value)
            for name, value in found.items()
        }
