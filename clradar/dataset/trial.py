"""Single samples: made again and compared with the stored one, or timed to estimate a data set."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clradar.dataset.folder import read_manifest, refuse_own
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import Sample, make_sample
from clradar.dataset.shards import new_shard, read_sample
from clradar.files.json_differences import differences
from clradar.jobs.outcome import made_with
from clradar.opencl import open_device


@dataclass(frozen=True, slots=True)
class Replay:
    """A sample that was made again, beside the stored one."""

    sample: Sample
    stored_in: str | None  # file of the stored one, relative to the data set
    differences: tuple[str, ...]  # a line for each array that differs in a bit
    made_otherwise: tuple[str, ...]  # versions and devices that differ


def replay(
    folder: str | os.PathLike[str],
    index: int,
    *,
    device: str | None = None,
    output: Path | None = None,
    force: bool = False,
    rigs: str | os.PathLike[str] = "",
) -> Replay:
    """Make sample `index` of a data set again, from its recipe; one that is not stored, from the
    plan.

    Parameters
    ----------
    folder : path-like
    index : int
    device : str or None
        See `clradar.open_device`.
    output : Path, optional
        File to write the sample to, as a shard of one sample; none of the data set's own.
    force : bool
        Replace an existing file.
    rigs : path-like
        The folder that the plan's names of rig files are relative to; the current one by default.

    Examples
    --------
    >>> from clradar.dataset import read_plan, replay, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> again = replay("letters", 1)
    >>> again.stored_in, again.differences
    ('shards/shard-00000.h5', ())
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    if output is not None:
        refuse_own(folder, output)
    then: dict[str, Any] = {}
    stored = Sample(recipe(manifest.plan, index), {})
    place = manifest.place_of(index)
    if place is not None:
        stored, then = read_sample(folder / place, index, manifest.plan)
    opened = open_device(device)
    now = made_with(opened)
    made = make_sample(stored.recipe, opened, rigs=rigs)
    if output is not None:
        with new_shard(output, manifest.plan, force=force) as shard:
            shard.add(made, now)
    if place is None:
        return Replay(made, None, (), ())
    return Replay(made, place, tuple(_different(stored, made)), tuple(differences(then, now)))


def _different(stored: Sample, made: Sample) -> Iterator[str]:
    for name in dict.fromkeys([*stored.arrays, *made.arrays]):
        one, other = stored.arrays.get(name), made.arrays.get(name)
        if one is None or other is None:
            yield f"{name}: {'not stored' if one is None else 'not made'}"
        elif (one.shape, one.dtype) != (other.shape, other.dtype):
            yield f"{name}: {one.dtype} {one.shape}, now {other.dtype} {other.shape}"
        elif one.tobytes() != other.tobytes():
            changed = int(np.count_nonzero((one != other) & ~(np.isnan(one) & np.isnan(other))))
            error = np.nanmax(np.abs(other.astype(np.complex128) - one))
            most = f"by up to {error:.3g}; the peak is {np.nanmax(np.abs(one)):.3g}"
            yield f"{name}: {changed} of {one.size} numbers differ, {most}"


def estimate(plan: Plan, *, device: str | None = None) -> tuple[float, float, list[str]]:
    """Make a shard of one sample and one of two, and extrapolate seconds and bytes to all samples.

    The first sample builds kernels and fills caches, so the second one counts. The last value is
    the same in words.
    """
    opened = open_device(device)
    times_s, sizes = [], []
    with tempfile.TemporaryDirectory(prefix="clradar-") as name:
        path, made = Path(name) / "shard.h5", []
        for index in (0, min(1, plan.samples - 1)):
            begun_s = perf_counter()
            made.append(make_sample(recipe(plan, index), opened, rigs=plan.folder))
            with new_shard(path, plan) as shard:
                for one in made:
                    shard.add(one, made_with(opened))
            times_s.append(perf_counter() - begun_s)
            sizes.append(path.stat().st_size)
    (first_s, one_s), one_bytes = times_s, sizes[1] - sizes[0]
    all_s = first_s + (plan.samples - 1) * one_s
    all_bytes = plan.samples * one_bytes + plan.n_shards * max(0, sizes[0] - one_bytes)
    text = [
        f"one sample: {one_s:.2f} s, {one_bytes / 2**20:.3f} MiB (the first of a process "
        f"{first_s:.2f} s) on {opened.info.label}",
        f"all {plan.samples} samples: {all_s / 3600:.3g} h one after the other, "
        f"{all_bytes / 2**30:.3g} GiB",
    ]
    return all_s, all_bytes, text
