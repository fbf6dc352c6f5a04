"""Replay: make one sample of a data set again, and compare it bit by bit with the stored one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clradar.dataset.engine.part_making import made_with
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import Sample, make_sample
from clradar.dataset.store.confined_reader import read_sample
from clradar.dataset.store.folder import read_manifest, refuse_own, stored_path
from clradar.dataset.store.shard_schema import data_bytes
from clradar.dataset.store.shard_writer import write_sample
from clradar.files.json_differences import differences
from clradar.opencl import open_device


@dataclass(frozen=True, slots=True)
class Replay:
    """A sample that was made again.

    Attributes
    ----------
    sample : Sample
    stored_in : str or None
        The file with the stored one, relative to the data set; None if there is none.
    differences : tuple of str
        One line per array or key of the recipe that differs; empty if all bits are the same.
    made_otherwise : tuple of str
        Versions and devices that differ from those that made the stored one.
    """

    sample: Sample
    stored_in: str | None
    differences: tuple[str, ...]
    made_otherwise: tuple[str, ...]


def replay(
    folder: Path,
    index: int,
    *,
    device: str | None = None,
    output: Path | None = None,
    force: bool = False,
    rigs: Path | None = None,
) -> Replay:
    """Make sample `index` of a data set again, from the plan alone.

    Parameters
    ----------
    folder : Path
    index : int
    device : str or None
        See `clradar.open_device`.
    output : Path, optional
        File to write the sample to, as a shard of one sample; none of the data set's own.
    force : bool
        Replace an existing file.
    rigs : Path, optional
        The folder that the plan's names of rig files are relative to; by default the current
        folder, then the data set's.

    Raises
    ------
    ModelError
        The plan has no such sample, or the file of its rig is not that of the plan.
    MeasurementError
        The folder is no data set, or damaged.
    OutputError
        The output is a file of the data set, exists already, or cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan, replay, run
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> result = run(read_plan("plan.toml"), Path("letters"))
    >>> again = replay(Path("letters"), 1)
    >>> again.stored_in, again.differences
    ('shards/shard-00000.h5', ())
    """
    manifest = read_manifest(folder)
    if output is not None:
        refuse_own(folder, output)
    wanted = recipe(manifest.plan, index)
    opened_device = open_device(device)
    now = made_with(opened_device)
    folders = (Path(), folder) if rigs is None else rigs
    made = make_sample(wanted, opened_device, rigs=folders)
    if output is not None:
        compression = manifest.plan.output.compression
        write_sample(output, made, now, compression=compression, force=force)
    path = stored_path(folder, manifest, index)
    if path is None:
        return Replay(made, None, (), ())
    stored, then = read_sample(path, index, data_bytes(wanted))
    found = _different(stored, made)
    return Replay(made, str(path.relative_to(folder)), tuple(found), tuple(differences(then, now)))


def _different(stored: Sample, made: Sample) -> list[str]:
    found = [f"recipe: {line}" for line in differences(dict(stored.recipe), dict(made.recipe))]
    for name in dict.fromkeys([*stored.arrays, *made.arrays]):
        one, other = stored.arrays.get(name), made.arrays.get(name)
        if one is None or other is None:
            found.append(f"{name}: {'not stored' if one is None else 'not made'}")
        elif (one.shape, one.dtype) != (other.shape, other.dtype):
            found.append(f"{name}: {one.dtype} {one.shape}, now {other.dtype} {other.shape}")
        elif one.tobytes() != other.tobytes():
            found.append(f"{name}: {_deviation(one, other)}")
    return found


def _deviation(one: np.ndarray, other: np.ndarray) -> str:
    changed = int(np.count_nonzero((one != other) & ~(np.isnan(one) & np.isnan(other))))
    with np.errstate(invalid="ignore"):
        error = np.nanmax(np.abs(other.astype(np.complex128) - one))
        peak = np.nanmax(np.abs(one))
    return f"{changed} of {one.size} numbers differ, by up to {error:.3g}; the peak is {peak:.3g}"
