"""Readers of data sets: an `xarray.Dataset` of Dask arrays; a map-style one for PyTorch."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.folder import Manifest, read_manifest, shard_name, stored_sample
from clradar.dataset.plan.plan import plan_record
from clradar.dataset.sample import Sample
from clradar.dataset.shards import (
    ARRAYS,
    LABELS,
    MESH,
    NAMES,
    arrays_of,
    dims_of,
    labels_of,
    opened_shard,
    place_of,
    samples_of,
)
from clradar.errors import ClradarError, MissingPackage
from clradar.files.failures import fail
from clradar.files.json_file import to_json
from clradar.model import checks

if TYPE_CHECKING:
    import xarray

CHUNK_BYTES = 2**25  # of Dask arrays


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

    ``xarray.open_mfdataset("letters/shards/*.h5")`` opens shards, too, without what is in `attrs`.

    Parameters
    ----------
    folder : path-like
        As ``clradar dataset`` writes it, complete or not.

    Returns
    -------
    xarray.Dataset
        Along `sample`, the number in the plan: products and labels, as Dask arrays that read their
        shard when they are computed, and `pose`, `handedness` and `rig` as coordinates. Meshes, of
        which each has its own length, are in `read_sample` alone. In `attrs`: `plan` and
        `made_with` as JSON, `complete`, `set_aside`. ``make_sample(view.recipe.values[0])`` makes a
        sample again.

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
        import h5netcdf  # noqa: F401
        import xarray
    except ImportError as error:
        raise MissingPackage(
            f"open_dataset: expected xarray, h5netcdf and dask, got {error}; "
            "pip install xarray h5netcdf 'dask[array]'"
        ) from error
    manifest, counts = _stored(folder)
    parts = [_view(path) for path, count in counts.items() if count]
    how: Any = {"data_vars": "minimal", "coords": "minimal", "compat": "override"}
    view = xarray.concat(parts, "sample", **how)
    view.attrs = {
        "complete": int(not manifest.missing),
        "set_aside": len(manifest.set_aside),
        "plan": to_json("plan", plan_record(manifest.plan)),
        "made_with": to_json("made_with", manifest.made_with),
    }
    for coordinate in view.coords.values():
        coordinate.load()
    return view


def _view(path: Path) -> xarray.Dataset:
    """Return the samples of a shard, in chunks of about `CHUNK_BYTES`."""
    import xarray

    with opened_shard(path) as file:
        is_old = file.attrs["clradar_version"] == 1
    found = _old_view(path) if is_old else xarray.open_dataset(path, engine="h5netcdf")
    n_samples = found.sizes["sample"]
    row_bytes = max((found[n].nbytes // n_samples for n in ARRAYS if n in found), default=1)
    return found.chunk(sample=max(1, CHUNK_BYTES // row_bytes))


def _old_view(path: Path) -> xarray.Dataset:
    """Return the samples of a shard of version 1, which stays open."""
    import dask.array
    import h5py
    import xarray

    file = h5py.File(path)
    found: dict[str, Any] = {}
    for name, axis in file["entry/axes"].items():
        units = {"units": axis.attrs["units"]} if "units" in axis.attrs else {}
        found[name] = (dims_of(name), _texts(axis[:]), {"long_name": name, **units})
    for name, field in {**ARRAYS, **LABELS}.items():
        if (place := place_of(file, name)) in file:
            data, units = file[place], {} if field.units is None else {"units": field.units}
            values = dask.array.from_array(data, data.chunks) if name in ARRAYS else data[:]
            attributes = {"long_name": field.long_name, **units}
            found[name] = (("sample", *field.axes), _texts(values), attributes)
    view = xarray.Dataset(found)
    return view.set_coords([name for name in (*NAMES, "tx_m", "rx_m") if name in found])


def _texts(values: Any) -> Any:
    return np.char.decode(values, "utf-8").astype(object) if values.dtype.kind == "S" else values


def read_sample(folder: str | os.PathLike[str], sample: int) -> Sample:
    """Return a stored sample of a data set with its recipe and all of its arrays.

    Examples
    --------
    >>> from clradar.dataset import read_plan, read_sample, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> read_sample("letters", 1).arrays["joints"].shape
    (25, 3)
    """
    return stored_sample(Path(folder), read_manifest(Path(folder)), sample)[0]


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
        known = [n for n, own in fields.items() if own.dtype != "text" and not n.startswith(MESH)]
        known += ["handedness", "pose"] if self.poses else ["handedness"]
        for name in names:
            checks.one_of("TorchDataset: names", name, tuple(known))
        self._names = tuple(names)

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
            sample: Any = {n: np.asarray(file[place_of(file, n)][row]) for n in self._names}
        for name, texts in (("handedness", ("right", "left")), ("pose", self.poses)):
            if name in sample:
                sample[name] = texts.index(sample[name].item().decode())
        sample = {name: torch.as_tensor(value) for name, value in sample.items()}
        return sample if self._transform is None else self._transform(sample)
