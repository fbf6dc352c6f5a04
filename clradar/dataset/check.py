"""What a data set is, whether it is whole, what a sample costs, and samples made again."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta
from math import prod
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clradar.dataset.folder import SHARDS, Manifest, read_manifest, shard_name
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import Sample, make_sample
from clradar.dataset.shards import (
    ARRAYS,
    arrays_of,
    labels_of,
    new_shard,
    opened_shard,
    read_sample,
    samples_of,
)
from clradar.errors import ClradarError
from clradar.files.atomic import TEMPORARY
from clradar.files.failures import clean, shown
from clradar.files.hashing import sha256_of
from clradar.files.json_differences import differences
from clradar.jobs.outcome import made_with
from clradar.model.progress import Progress
from clradar.opencl import open_device
from measurement_io import CheckReport, Description, Fact

BLOCK_BYTES = 2**28
"""Of an array that is in memory at a time."""

MOST_LISTED = 10
"""Samples listed in a problem."""


def describe_dataset(folder: Path) -> Description:
    """Describe a data set from its manifest and the sizes of its shards, which are not opened."""
    manifest = read_manifest(folder)
    plan, closed, complete = manifest.plan, len(manifest.shards), not manifest.missing
    names = [pose.name for pose in plan.poses.poses]
    size = sum((folder / shard_name(number)).stat().st_size for number in manifest.shards)
    stored, aside = len(manifest.stored), len(manifest.aside)
    text = f"yes, but for {aside} set aside" if aside else "yes"
    device = manifest.made_with.get("device", {})
    shards = f"{closed} of {plan.n_shards}, {size / 2**20:.1f} MiB"
    facts = [
        Fact("samples", f"{stored} of {plan.samples}", {"stored": stored, "plan": plan.samples}),
        Fact("complete", text if complete else "no", complete),
        Fact("set aside", f"{aside}", sorted(manifest.aside)),
        Fact("shards", shards, {"closed": closed, "plan": plan.n_shards, "bytes": size}),
        Fact("products", ", ".join(plan.output.products), list(plan.output.products)),
        Fact("poses", f"{plan.poses.kind} of {len(names)}: {clean(', '.join(names))}", names),
        Fact("seed", f"{plan.seed}", plan.seed),
        Fact("made with", clean(json.dumps(device)), dict(manifest.made_with)),
    ]
    return Description(shown(folder), "data set", tuple(facts), (), tuple(_missing(manifest)))


def check_dataset(folder: Path, progress: Progress | None = None) -> CheckReport:
    """Verify a data set by reading all of it: SHA-256 and checksums, and what readers need."""
    try:
        manifest = read_manifest(folder)
    except ClradarError as error:
        return CheckReport(shown(folder), (), error.mistakes or (clean(error),))
    checked = ["manifest: its plan is whole and has no mistakes"]
    problems = [*_missing(manifest), *_foreign_files(folder, manifest)]
    before = len(problems)
    for done, number in enumerate(sorted(manifest.shards), start=1):
        try:
            found = [f"{shard_name(number)}: {p}" for p in _problems(folder, manifest, number)]
        except ClradarError as error:
            found = [clean(error)]
        problems += (f"{p}; delete the file, and the same command makes it again" for p in found)
        if progress is not None:
            progress(done, len(manifest.shards))
    if len(problems) == before:
        known = sum(shard_name(n).split("/")[1] in manifest.sha256 for n in manifest.shards)
        checked += [
            f"shards: {len(manifest.shards)}, {known} by their SHA-256: samples in order",
            f"samples: {len(manifest.stored)}, labels are there",
            f"{', '.join(manifest.plan.output.products)}: finite numbers",
        ]
    if manifest.aside:
        samples = _listed(sorted(manifest.aside))
        checked.append(f"set aside, with their reasons in the manifest: {samples}")
    return CheckReport(shown(folder), tuple(checked), tuple(problems))


def _missing(manifest: Manifest) -> Iterator[str]:
    if missing := manifest.missing:
        yield f"not complete: shards {_listed(missing)} are missing; the same command makes them"


def _foreign_files(folder: Path, manifest: Manifest) -> Iterator[str]:
    own = {shard_name(number) for number in manifest.shards}
    for path in sorted((folder / SHARDS).glob("*")):
        if path.match(TEMPORARY):
            yield f"{SHARDS}/{clean(path.name)}: left over; the same command removes it"
        elif f"{SHARDS}/{path.name}" not in own:
            yield f"{SHARDS}/{clean(path.name)}: is not of this data set; it can be removed by hand"


def _problems(folder: Path, manifest: Manifest, number: int) -> Iterator[str]:
    """What is wrong with a shard."""
    path, plan = folder / shard_name(number), manifest.plan
    known = manifest.sha256.get(path.name)
    if known is not None and (found := sha256_of(path)) != known:
        yield f"expected the SHA-256 {known}, got {found}"
        return
    samples = [n for n in plan.shard_samples(number) if n not in manifest.aside]
    with opened_shard(path) as file:
        if (there := samples_of(file)) != samples:
            yield f"expected the samples {_listed(samples)}, got {_listed(there)}"
            return
        for name, label in labels_of(plan).items() if samples else ():
            if label.place not in file or len(file[label.place][:]) != len(samples):
                yield f"labels/{name}: expected one for each sample"
        for name in arrays_of(plan.output.products) if samples else ():
            bad = sorted({samples[row] for row in _not_finite(file, name)})
            if bad and not (name == "joints" and plan.hands.rigs):  # a rig may lack some
                yield f"{name}: expected finite numbers, got others in the samples {_listed(bad)}"


def _not_finite(file: Any, name: str) -> Iterator[int]:
    """Read all of an array; yield rows of samples with numbers that are not finite."""
    data = file[ARRAYS[name].place]
    step = max(1, BLOCK_BYTES // max(1, prod(data.shape[1:]) * data.dtype.itemsize))
    for at in range(0, len(data), step):
        block = data[at : at + step].reshape(-1, max(1, prod(data.shape[1:])))
        wrong = np.isinf(block) if name == "depth_map" else ~np.isfinite(block)
        rows = at + np.flatnonzero(wrong.any(axis=1))
        if ARRAYS[name].ragged:
            first = file[f"{ARRAYS[name].place}_first"][:]
            rows = np.searchsorted(first, rows, side="right") - 1
        yield from rows.tolist()


def _listed(numbers: Sequence[int]) -> str:
    more = len(numbers) - MOST_LISTED
    text = ", ".join(map(str, numbers[:MOST_LISTED]))
    return f"{text} and {more} more" if more > 0 else text or "none"


# Samples


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
    rigs: str | os.PathLike[str] = "",
) -> Replay:
    """Make sample `index` of a data set again and compare it with the stored one.

    Returns a record with `sample`, `stored_in` (None where it is not stored, and made from the
    plan), `differences` of bits, and `made_otherwise`, versions and devices that differ. `device`
    and `rigs` are as for `make_sample`.

    Examples
    --------
    >>> from clradar.dataset import read_plan, replay, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> again = replay("letters", 1)
    >>> again.stored_in, again.differences
    ('shards/shard-00000.h5', ())
    """
    manifest = read_manifest(Path(folder))
    wanted, place = recipe(manifest.plan, index), manifest.place_of(index)
    opened = open_device(device)
    if index not in manifest.stored:
        return Replay(make_sample(wanted, opened, rigs=rigs), None, (), ())
    stored, then = read_sample(Path(folder) / place, index, manifest.plan)
    made = make_sample(stored.recipe, opened, rigs=rigs)
    changed = tuple(differences(then, made_with(opened)))
    return Replay(made, place, tuple(_different(stored, made)), changed)


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

    The first sample builds kernels and fills caches, so the second counts. The last value is text.
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
        f"all {plan.samples} samples: {timedelta(seconds=round(all_s))} (hours:minutes:seconds) "
        f"one after the other, {all_bytes / 2**20:.3g} MiB",
    ]
    return all_s, all_bytes, text
