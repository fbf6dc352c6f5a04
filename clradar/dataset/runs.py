"""Make data sets: shard by shard, here or by workers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clradar.dataset.folder import (
    MANIFEST,
    OWN_NAMES,
    PARTS,
    SHARDS,
    SUMMARIES,
    Manifest,
    manifest_of,
    read_manifest,
    shard_name,
    write_manifest,
)
from clradar.dataset.plan.plan import Plan, plan_record
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import Sample, check_rigs, make_sample
from clradar.dataset.shards import failed_of, new_shard, opened_shard, read_sample, samples_of
from clradar.errors import ClradarError, DeviceError, MeasurementError, handled_warnings, warn
from clradar.files.atomic import remove_temporaries
from clradar.files.failures import fail
from clradar.files.hashing import sha256_of
from clradar.files.json_differences import differences
from clradar.jobs.job import Job
from clradar.jobs.outcome import ATTEMPTS, Aside, made_with, reason_of
from clradar.jobs.where import Where
from clradar.model.progress import Progress
from clradar.opencl import Device, forget_devices, open_device

SHOWN_ASIDE = 20
"""Samples that were set aside and are named in warnings."""

STOP_AFTER = 10
"""Consecutive samples that fail in the device before the run ends."""


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
    names = [name for rig in plan.hands.rigs for name in (rig.file, rig.mapping)]
    rigs = tuple(plan.folder / name for name in names if name is not None)
    where = replace(Where(device) if where is None else where, files=rigs)
    job = Job(
        folder=path, work="run of a data set", key=Manifest(plan).record(), own=OWN_NAMES,
        resumable=lambda folder: any(any((folder / n).glob("*.h5")) for n in (SHARDS, PARTS)),
        force=force, key_name=MANIFEST,
        compared=lambda key: plan_record(manifest_of(path / MANIFEST, key).plan) if key else key,
    )  # fmt: skip
    if force or not (path / MANIFEST).exists():
        check_rigs(plan.hands.rigs, plan.folder)  # before a data set is removed, or a folder made
    with job.held():
        if force:
            job.clear(OWN_NAMES[1:])
        (path / SHARDS).mkdir(exist_ok=True)
        dataset = _Run(plan, path)
        again = {sample // plan.output.shard_size for sample in dataset.manifest.aside if retry}
        shards = sorted({*dataset.manifest.missing, *again})
        if shards:
            check_rigs(plan.hands.rigs, plan.folder)
            job.clear(SUMMARIES)
            try:
                dataset.make(shards, where, progress)
            finally:
                remove_temporaries(path / SHARDS)  # of killed workers
        write_manifest(path, dataset.manifest)
        job.clear([PARTS])
        from clradar.dataset.contact_sheet import write_contact_sheet

        write_contact_sheet(path, dataset.manifest)
    return dataset.result()


@dataclass(frozen=True, slots=True)
class Work:
    """Samples of a shard, without those that kill their process.

    One that is not `stored` is only made, to find whether it does.
    """

    samples: range
    deadly: tuple[Aside, ...] = ()
    stored: bool = True


@dataclass(slots=True)
class Made:
    """How many samples of a shard were made, with their warnings, and which failed."""

    made_with: Mapping[str, Any]
    failed: dict[int, Aside]
    warnings: dict[int, str] = field(default_factory=dict)
    count: int = 0
    sha256: str = ""


@dataclass(frozen=True, slots=True)
class ShardMaker:
    """Steps of a `Where`: make the samples of a shard, and put it in its place whole."""

    folder: Path
    plan: Plan
    device: Any = None

    def run(self, work: Work, progress: Progress | None) -> Made:
        """Make a shard; what an earlier one has of it is kept."""
        opened = open_device(self.device)
        made = Made(made_with(opened), {aside.sample: aside for aside in work.deadly})
        if not work.stored:
            for sample in work.samples:
                self._attempt(sample, opened, made)
            return made
        target = self.folder / Manifest(self.plan).place_of(work.samples[0])
        with new_shard(target, self.plan) as shard:
            for done, sample in enumerate(work.samples, start=1):
                if kept := self._stored(target, sample):
                    shard.add(*kept)
                elif sample not in made.failed and (found := self._attempt(sample, opened, made)):
                    shard.add(found, made.made_with)
                if sample in made.failed:
                    shard.fail(made.failed[sample])
                if progress is not None:
                    progress(done, len(work.samples))
        made.sha256 = sha256_of(target)
        return made

    def _stored(self, target: Path, sample: int) -> tuple[Sample, Mapping[str, Any]] | None:
        """What the shard that is to be replaced has, or the part of a data set of version 1."""
        for path in (target, self.folder / PARTS / f"{sample:08d}.h5"):
            try:
                return read_sample(path, sample, self.plan)
            except MeasurementError:  # it is not there, or damaged
                continue
        return None

    def _attempt(self, sample: int, opened: Device, made: Made) -> Sample | None:
        """Make a sample, or note why there is none."""
        reason = ""
        for _ in range(ATTEMPTS):
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
        made.failed[sample] = Aside(sample, reason, ATTEMPTS)
        return None


def _failed_of(file: Path, samples: range, known: Mapping[int, Aside]) -> dict[int, Aside]:
    """The samples that a shard lacks, with why: as it says, or as is known of shards of 0.2."""
    with opened_shard(file) as shard:
        there, failed = {*samples_of(shard)}, failed_of(shard)
    found = {n: known[n] for n in samples if n in known and n not in there} | failed
    if there | {*found} != {*samples}:
        fail(file, f"the samples {samples[0]} to {samples[-1]}", "others, or fewer")
    return found


class _Run:
    """A run, and what it knows of its data set."""

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        before = read_manifest(path)
        self.manifest = Manifest(plan, before.made_with, before.aside)  # with the folder of rigs
        self._made = self._failures = 0
        self._warned: dict[int, str] = {}
        self._makers: Mapping[str, Any] | None = None
        for number in sorted(before.shards):
            file = path / shard_name(number)
            try:
                failed = _failed_of(file, plan.shard_samples(number), before.aside)
                self.manifest.take(number, failed, before.sha256.get(file.name) or sha256_of(file))
            except MeasurementError as error:
                warn(f"{error}; its samples are made again")
                file.unlink()

    def make(self, shards: Sequence[int], where: Where, progress: Progress | None) -> None:
        """Make shards. Of one that killed its workers each sample is tried alone to find which."""
        works = [Work(self.plan.shard_samples(shard)) for shard in shards]
        for work, reason in [*self._given_up(works, where, progress)]:
            alone = [Work(range(sample, sample + 1), stored=False) for sample in work.samples]
            bad = self._given_up(alone, where, None)
            deadly = tuple(Aside(one.samples[0], why, ATTEMPTS) for one, why in bad)
            for _, again in self._given_up([replace(work, deadly=deadly)], where, None):
                samples = f"{work.samples[0]} to {work.samples[-1]}"
                raise ClradarError(f"samples {samples}: {again}; at first {reason}")

    def _given_up(
        self, works: Sequence[Work], where: Where, progress: Progress | None
    ) -> Iterator[tuple[Work, str]]:
        """Do the work; yield what no worker could do, and why."""
        maker = ShardMaker(Path(os.path.abspath(self.path)), self.plan)  # links are not followed
        for work, (result, _) in where.outcomes(maker, works, self.path, progress):
            if type(result) is ClradarError:
                yield work, str(result)
            elif isinstance(result, ClradarError):
                raise result
            elif work.stored:
                self._take(work, result)

    def _take(self, work: Work, result: Made) -> None:
        manifest, before = self.manifest, (self.manifest.made_with, self.manifest.aside)
        if self._makers != result.made_with:  # all workers are alike
            for line in differences(dict(manifest.made_with or result.made_with), result.made_with):
                warn(f"{self.path}: has samples made with {line}; their bits depend on it")
        self._makers = result.made_with
        manifest.made_with = manifest.made_with or result.made_with
        shard = work.samples[0] // self.plan.output.shard_size
        manifest.take(shard, result.failed, result.sha256)
        if (manifest.made_with, manifest.aside) != before:
            write_manifest(self.path, manifest)
        self._made += result.count
        self._warned |= result.warnings
        for sample in work.samples:
            reason = result.failed[sample].reason if sample in result.failed else ""
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
        aside = tuple(self.manifest.aside[sample] for sample in sorted(self.manifest.aside))
        for one in aside[:SHOWN_ASIDE]:
            warn(f"sample {one.sample} was set aside after {one.attempts} attempts: {one.reason}")
        if len(aside) > SHOWN_ASIDE:
            warn(f"{len(aside) - SHOWN_ASIDE} more were set aside; see manifest.json")
        return RunResult(self._made, self.plan.samples, aside)
