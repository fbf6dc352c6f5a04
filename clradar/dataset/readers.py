"""Readers of data sets: an `xarray.Dataset` of Dask arrays; a map-style one for PyTorch."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.folder import Manifest, read_manifest, shard_name
from clradar.dataset.plan.plan import plan_record
from clradar.dataset.shards import ARRAYS, LABELS, arrays_of, labels_of, opened_shard, samples_of
from clradar.errors import ClradarError, MissingPackage
from clradar.files.failures import fail
from clradar.files.json_file import to_json
from clradar.model import checks

if TYPE_CHECKING:
    import xarray

CHUNK_SIZE = "32 MiB"  # of Dask arrays, about
NAMES = ("sample", "pose", "handedness", "rig")  # labels that are coordinates of the samples


def _stored(folder: str | os.PathLike[str]) -> tuple[Manifest, dict[Path, int]]:
    """The manifest of a data set, and its shards with the number of their samples."""
    manifest = read_manifest(Path(folder))
    counts = {}
    for number in sorted(manifest.shards):
        path = Path(os.path.abspath(folder)) / shard_name(number)  # it is read later, too
        with opened_shard(path) as file:
            counts[path] = len(samples_of(file))
    if not any(counts.values()):
        fail(Path(folder), "a data set with at least one shard of samples", "none")
    return manifest, counts


def open_dataset(folder: str | os.PathLike[str]) -> xarray.Dataset:
    """Return a data set with its axes, units and labels.

    Parameters
    ----------
    folder : path-like
        As ``clradar dataset`` writes it, complete or not.

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
    >>> result = clradar.dataset.run(clradar.dataset.read_plan("plan.toml"), "letters")
    >>> view = clradar.open_dataset("letters")
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
    manifest, counts = _stored(folder)
    attributes = {
        "complete": int(not manifest.missing),
        "set_aside": len(manifest.aside),
        "plan": to_json("plan", plan_record(manifest.plan)),
        "made_with": to_json("made_with", manifest.made_with),
    }
    return _view([path for path, count in counts.items() if count]).assign_attrs(attributes)


def _view(paths: list[Path]) -> xarray.Dataset:
    """Return the samples of shards, with rows of meshes along axes of their own."""
    import dask.array
    import xarray

    fields = {**ARRAYS, **LABELS}
    parts: dict[str, list[Any]] = defaultdict(list)
    rows: dict[str, list[np.ndarray]] = defaultdict(list)  # of each mesh
    coordinates: dict[str, Any] = {}
    for path in paths:
        with opened_shard(path) as file:
            for name, field in ((n, own) for n, own in fields.items() if own.place in file):
                lazy = _Lazy(path, file[field.place])
                chunks = (CHUNK_SIZE, *lazy.shape[1:])
                parts[name].append(dask.array.from_array(lazy, chunks, name=False, asarray=False))
                if field.ragged:
                    rows[name].append(np.diff(file[f"{field.place}_first"][:]))
            for name, axis in file["entry/axes"].items() if not coordinates else ():
                dims = (name[:2], "coordinate") if name in ("tx_m", "rx_m") else (name,)
                coordinates[name] = (dims, _values(axis), _units(axis.attrs.get("units"), name))
    variables: dict[str, Any] = {}
    for name, own in parts.items():
        field = fields[name]
        if field.ragged:
            count = np.concatenate(rows[name])
            end = np.cumsum(count)
            variables |= {f"{name}_first": ("sample", end - count), f"{name}_end": ("sample", end)}
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


class _Lazy:
    """One array of one shard; opens the file for each read, so that it can be pickled."""

    def __init__(self, path: Path, dataset: Any) -> None:
        self.path, self.place = path, dataset.name
        self.shape, self.ndim, self.dtype = dataset.shape, dataset.ndim, dataset.dtype
        if self.dtype.kind == "S":  # no text has more characters than bytes
            self.dtype = np.dtype(f"U{self.dtype.itemsize}")

    def __getitem__(self, key: Any) -> np.ndarray:
        with opened_shard(self.path) as file:
            return _values(file[self.place], key).astype(self.dtype, copy=False)


class TorchDataset:
    """Samples as dictionaries of tensors, for `torch.utils.data.DataLoader`.

    It can be pickled, and forked: no file stays open. Depth maps have NaN where there is no depth.

    Parameters
    ----------
    folder : path-like
    names : sequence of str
        Keys of each sample: products that all have one shape ("max_projection", "volume",
        "joints", ...), labels ("alpha", "angles_rad", ...), "pose" as an index into `poses`,
        "handedness" (0 right, 1 left), and "sample", its number in the plan.
    transform : callable, optional
        Applied to each dictionary.

    Attributes
    ----------
    poses : tuple of str
        Names of the poses, where they have names.

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
    ) -> None:
        manifest, counts = _stored(folder)
        self._rows = [(path, row) for path, count in counts.items() for row in range(count)]
        self._transform, plan = transform, manifest.plan
        self.poses = plan.pose_names
        fields = {**arrays_of(plan.output.products), **labels_of(plan)}
        known = [n for n, own in fields.items() if own.dtype != "text" and not own.ragged]
        known += ["handedness", "pose"] if self.poses else ["handedness"]
        for name in names:
            checks.one_of("TorchDataset: names", name, tuple(known))
        self._places = {name: fields[name].place for name in names}

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, position: int) -> Any:
        """Return the sample at a position, negative ones from the end."""
        try:
            import torch
        except ImportError as error:
            raise ClradarError(f"TorchDataset: expected PyTorch, got {error}") from error
        path, row = self._rows[position]
        with opened_shard(path) as file:
            sample: Any = {n: np.asarray(file[place][row]) for n, place in self._places.items()}
        for name, texts in (("handedness", ("right", "left")), ("pose", self.poses)):
            if name in sample:
                sample[name] = texts.index(sample[name].item().decode())
        sample = {name: torch.as_tensor(value) for name, value in sample.items()}
        return sample if self._transform is None else self._transform(sample)
