"""Make data sets: shard by shard, here or by workers; and single samples again."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clradar.dataset.folder import (
    MANIFEST,
    OWN_NAMES,
    PARTS,
    SHARDS,
    SUMMARIES,
    Manifest,
    manifest_of,
    part_name,
    read_manifest,
    shard_name,
    stored_sample,
    write_manifest,
)
from clradar.dataset.plan.plan import Plan, plan_record
from clradar.dataset.sample import Sample, make_sample, recipe
from clradar.dataset.shards import (
    Aside,
    failed_of,
    new_shard,
    opened_shard,
    read_stored,
    samples_of,
)
from clradar.errors import ClradarError, DeviceError, MeasurementError, handled_warnings, warn
from clradar.files.failures import fail
from clradar.files.hashing import sha256_of
from clradar.files.json_file import differences
from clradar.jobs.job import Job
from clradar.jobs.outcome import ATTEMPTS, made_with, reason_of
from clradar.jobs.where import Where
from clradar.model.progress import Progress
from clradar.opencl import Device, forget_devices, open_device

SHOWN_ASIDE = 20  # samples that were set aside and are named in warnings
STOP_AFTER = 10  # consecutive samples that fail in the device before the run ends


@dataclass(frozen=True, slots=True)
class RunResult:
    """Counts of a run: samples that it made, samples of the plan, and what is set aside, by earlier
    runs too."""

    made: int
    samples: int
    aside: tuple[Aside, ...]


def run(
    plan: Plan,
    path: str | os.PathLike[str],
    *,
    device: str | None = None,
    where: Where | None = None,
    force: bool = False,
    retry: bool = False,
    progress: Progress | None = None,
) -> RunResult:
    """Make a data set, or its missing shards.

    Parameters
    ----------
    plan : Plan
    path : path-like
        Its folder; a data set of the same plan is resumed.
    where : clradar.jobs.Where, optional
        In place of `device`: worker processes, or a Dask scheduler.
    force : bool
        Replace the data set in the folder, of this plan or another.
    retry : bool
        Make the samples again that earlier runs set aside.

    Warns
    -----
    ClradarWarning
        Samples are of other versions or devices, probably not as intended, or were set aside.

    Examples
    --------
    >>> from clradar.dataset import read_plan, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> result.made, result.samples, result.aside
    (2, 2, ())
    """
    path = Path(path)
    rigs = [file for rig in plan.hands.rigs for file in rig.files(plan.folder).values()]
    where = replace(where or Where(device), files=tuple(rigs))
    job = Job(
        folder=path, work="run of a data set", key=Manifest(plan=plan).record(), own=OWN_NAMES,
        resumable=lambda folder: any(any((folder / n).glob("*.h5")) for n in (SHARDS, PARTS)),
        force=force, key_name=MANIFEST,
        compared=lambda key: plan_record(manifest_of(path / MANIFEST, key).plan) if key else key,
    )  # fmt: skip
    for rig in plan.hands.rigs:
        rig.check(plan.folder)  # before a data set is removed, or a folder made
    with job.held():
        if force:
            write_manifest(path, Manifest(plan=plan))  # nothing is set aside any more
            job.clear(OWN_NAMES[1:])
        (path / SHARDS).mkdir(exist_ok=True)
        dataset = _Run(plan, path)
        again = {sample // plan.output.shard_size for sample in dataset.manifest.aside if retry}
        if shards := sorted({*dataset.manifest.missing, *again}):
            job.clear(SUMMARIES)
            (path / PARTS).mkdir(exist_ok=True)
            dataset.make(shards, where, progress)
        write_manifest(path, dataset.manifest)
        job.clear([PARTS])
    return dataset.result()


@dataclass(slots=True)
class Made:
    """How many samples of a shard were made, with their warnings."""

    made_with: dict[str, Any]
    warnings: dict[int, str] = field(default_factory=dict)
    count: int = 0
    sha256: str = ""


@dataclass(frozen=True, slots=True)
class ShardMaker:
    """Work of a `Where`: makes the samples of a shard, and puts it in its place whole."""

    folder: Path
    plan: Plan

    def run(self, number: int, opened: Device, progress: Progress) -> Made:
        """Make a shard; what an earlier one has of it is kept, and parts of version 1."""
        made, samples = Made(made_with(opened)), self.plan.shard_samples(number)
        target = self.folder / shard_name(number)
        with new_shard(target, self.plan) as shard:
            for done, sample in enumerate(samples, start=1):
                attempts = attempts_at(self.folder, sample)
                try:
                    if kept := self._stored(target, sample):
                        shard.add(*kept)
                    elif isinstance(found := self._attempt(sample, opened, made, attempts), Aside):
                        shard.fail(found)
                    else:
                        shard.add(found, made.made_with)
                finally:
                    attempts.unlink(missing_ok=True)
                progress(done, len(samples))
        made.sha256 = sha256_of(target)
        return made

    def _stored(self, target: Path, sample: int) -> tuple[Sample, Mapping[str, Any]] | None:
        for path in (target, self.folder / part_name(sample)):
            try:
                return read_stored(path, sample, self.plan)
            except MeasurementError:  # it is not there, or damaged
                continue
        return None

    def _attempt(self, sample: int, opened: Device, made: Made, attempts: Path) -> Sample | Aside:
        """Make a sample, or say why there is none; a killed process counts as an attempt, too."""
        reason = "its worker process died each time"
        while not attempts.exists() or attempts.stat().st_size < ATTEMPTS:
            with attempts.open("ab") as file:
                file.write(b".")
            texts: list[str] = []
            try:
                with handled_warnings(texts.append):  # for the process that shows them
                    device = open_device(opened.info.selector)
                    found = make_sample(recipe(self.plan, sample), device, rigs=self.plan.folder)
            except Exception as error:
                reason = reason_of(error)
                if isinstance(error, DeviceError):
                    forget_devices()  # a context may stay unusable after a failed launch
                continue
            if texts:
                made.warnings[sample] = "; ".join(texts)
            made.count += 1
            return found
        return Aside(sample=sample, reason=reason, attempts=ATTEMPTS)


def attempts_at(folder: Path, sample: int) -> Path:
    """Return the file with a byte for each attempt at a sample; a temporary one of the run."""
    return folder / PARTS / f".{sample}.tmp"


class _Run:
    """A run, and what it knows of its data set."""

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self.manifest = read_manifest(path)
        self.manifest.plan = plan  # with the folder of rigs
        self._made = self._failures = 0
        self._warned: dict[int, str] = {}
        self._makers: Mapping[str, Any] | None = None
        for number in sorted(self.manifest.shards):
            try:
                self._take(number)
            except MeasurementError as error:
                warn(f"{error}; its samples are made again")
                (path / shard_name(number)).unlink()
                self.manifest.shards.remove(number)

    def make(self, shards: Sequence[int], where: Where, progress: Progress | None) -> None:
        """Make shards; one that killed its workers again, without the sample that did it twice."""
        maker = ShardMaker(Path(os.path.abspath(self.path)), self.plan)  # links are not followed
        again = set[int]()
        while shards:
            killed = []
            for number, (result, _) in where.outcomes(maker.run, shards, self.path, progress):
                samples = self.plan.shard_samples(number)
                if isinstance(result, Made):
                    self._took(number, result)
                elif type(result) is not ClradarError:
                    raise result
                elif number in again and not any(
                    attempts_at(self.path, n).exists() for n in samples
                ):
                    raise ClradarError(f"samples {samples[0]} to {samples[-1]}: {result}")
                else:
                    killed.append(number)
            shards, progress = killed, None
            again |= {*killed}

    def _take(self, number: int, sha256: str = "") -> None:
        """Take in a shard that is there: what it has, and what failed, as it or, of 0.2, the
        manifest says."""
        file, samples = self.path / shard_name(number), self.plan.shard_samples(number)
        with opened_shard(file) as shard:
            there, failed = {*samples_of(shard)}, failed_of(shard)
        known = self.manifest.aside
        failed = {n: known[n] for n in known.keys() & {*samples} - there} | failed
        if there | {*failed} != {*samples}:
            fail(file, f"the samples {samples[0]} to {samples[-1]}", "others, or fewer")
        aside = {n: own for n, own in known.items() if n not in samples} | failed
        self.manifest.set_aside = tuple(aside[n] for n in sorted(aside))
        self.manifest.shards.add(number)
        known_sha256 = self.manifest.sha256.get(file.name)
        self.manifest.sha256[file.name] = sha256 or known_sha256 or sha256_of(file)

    def _took(self, number: int, made: Made) -> None:
        """Take in a shard that was made now."""
        manifest, before = self.manifest, (self.manifest.made_with, self.manifest.set_aside)
        if self._makers != made.made_with:  # all workers are alike
            for line in differences(manifest.made_with or made.made_with, made.made_with):
                warn(f"{self.path}: has samples made with {line}; their bits depend on it")
        self._makers = made.made_with
        manifest.made_with = manifest.made_with or made.made_with
        self._take(number, made.sha256)
        if (manifest.made_with, manifest.set_aside) != before:
            write_manifest(self.path, manifest)
        self._made += made.count
        self._warned |= made.warnings
        aside = manifest.aside
        for sample in self.plan.shard_samples(number):
            reason = aside[sample].reason if sample in aside else ""
            refused = reason.startswith(f"{DeviceError.__name__}: ")
            self._failures = self._failures + 1 if refused else 0
            if self._failures == STOP_AFTER:
                raise DeviceError(
                    f"{STOP_AFTER} samples in a row failed, the last with {reason}; "
                    "repair the device, then resume with --retry"
                )

    def result(self) -> RunResult:
        """Warn of samples that are not as intended, or that are missing, and count all."""
        if self._warned:
            first = min(self._warned)
            warn(
                f"{self.path}: {len(self._warned)} of {self._made} samples are probably not as "
                f"intended, as sample {first}: {self._warned[first]}"
            )
        aside = self.manifest.set_aside
        for one in aside[:SHOWN_ASIDE]:
            warn(f"sample {one.sample} was set aside after {one.attempts} attempts: {one.reason}")
        if len(aside) > SHOWN_ASIDE:
            warn(f"{len(aside) - SHOWN_ASIDE} more were set aside; see manifest.json")
        return RunResult(self._made, self.plan.samples, aside)


# Samples again, and what one costs


@dataclass(frozen=True, slots=True)
class Replay:
    """A sample that was made again, beside the stored one."""

    sample: Sample
    stored_in: str  # file of the stored one, relative to the data set
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

    Returns a record with `sample`, `stored_in`, `differences` of bits, and `made_otherwise`,
    versions and devices that differ. `device` and `rigs` are as for `make_sample`.

    Examples
    --------
    >>> from clradar.dataset import read_plan, replay, run
    >>> result = run(read_plan("plan.toml"), "letters")
    >>> again = replay("letters", 1)
    >>> again.stored_in, again.differences
    ('shards/shard-00000.h5', ())
    """
    manifest, opened = read_manifest(Path(folder)), open_device(device)
    if index not in manifest.stored:
        fail(Path(folder), "a sample that is stored", f"{index}, of {manifest.plan.samples}")
    stored, then = stored_sample(Path(folder), manifest, index)
    made = make_sample(stored.recipe, opened, rigs=rigs)
    changed = tuple(differences(then, made_with(opened)))
    return Replay(made, manifest.place_of(index), tuple(_different(stored, made)), changed)


def _different(stored: Sample, made: Sample) -> Iterator[str]:
    for name, one in stored.arrays.items():
        other = made.arrays[name]
        if (one.shape, one.dtype) != (other.shape, other.dtype):
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
