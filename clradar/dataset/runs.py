"""Make data sets: shard by shard, here or by workers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
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
from clradar.dataset.sample import found_rig, make_sample
from clradar.dataset.shards import (
    assemble,
    failed_of,
    opened_shard,
    sample_of,
    samples_of,
    write_sample,
)
from clradar.dataset.summary import write_summaries
from clradar.errors import (
    ClradarError,
    DeviceError,
    MeasurementError,
    OutputError,
    handled_warnings,
    warn,
)
from clradar.files.atomic import new_folder
from clradar.files.json_differences import differences
from clradar.jobs.job import Job
from clradar.jobs.lock import remove_temporaries
from clradar.jobs.outcome import ATTEMPTS, Aside, reason_of
from clradar.jobs.resources import made_with
from clradar.jobs.where import Where
from clradar.model.progress import Progress
from clradar.opencl import forget_devices, open_device

SHOWN_ASIDE = 20
"""Samples that were set aside and are named in warnings."""

STOP_AFTER = 10
"""Consecutive samples that fail in the device before the run ends."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """Counts of a run.

    Attributes
    ----------
    made : int
        Samples of this run.
    samples : int
        Of the plan.
    aside : tuple of Aside
        Samples that are set aside, by earlier runs too.
    """

    made: int
    samples: int
    aside: tuple[Aside, ...]


def run(
    plan: Plan,
    path: Path,
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
    path : Path
        Its folder; a data set of the same plan is resumed.
    device : str or None
        See `clradar.open_device`.
    where : clradar.jobs.Where, optional
        In place of `device`: worker processes, or a Dask scheduler.
    force : bool
        Replace the data set in the folder, of this plan or another.
    retry : bool
        Make the samples again that earlier runs set aside.
    progress : callable, optional
        Called with (done, total) units of work.

    Raises
    ------
    ModelError
        The file of a rig is not that of the plan.
    OutputError
        The folder has a data set of another plan, another process writes it, or it cannot be
        written.
    DeviceError
        There is no such device, or it failed for `STOP_AFTER` samples in a row.
    ClusterError
        The workers differ, or the connection is lost.

    Warns
    -----
    ClradarWarning
        Earlier samples were made with other versions or on another device, shards are damaged and
        made again, or samples are probably not as intended or were set aside.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan, run
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> result = run(read_plan("plan.toml"), Path("letters"))
    >>> result.made, result.samples, result.aside
    (2, 2, ())
    >>> sorted(path.name for path in Path("letters").iterdir() if path.is_file())
    ['contact-sheet.png', 'manifest.json', 'statistics.csv', 'statistics.json']
    """
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
        _check_rigs(plan)  # before a data set is removed, or a folder made
    with job.held():
        if force:
            job.clear(OWN_NAMES[1:])
        (path / SHARDS).mkdir(exist_ok=True)
        dataset = _Run(plan, path, _known(path, plan))
        shards = dataset.to_make(retry)
        if shards:
            _check_rigs(plan)
            job.clear(SUMMARIES)
            try:
                dataset.make(shards, where, progress)
            finally:
                remove_temporaries(path / SHARDS)  # of killed workers
        if not read_manifest(path).complete:
            raise OutputError(
                f"{path}: shards that workers wrote are not visible here; the same command resumes"
            )
        write_manifest(path, dataset.manifest)
        job.clear([PARTS])
        write_summaries(path, dataset.manifest)
    return dataset.result()


def _check_rigs(plan: Plan) -> None:
    """Raise `ModelError` unless the files of the rigs are those of the plan."""
    for rig in plan.hands.rigs:
        found_rig(rig, (plan.folder,))


def _known(path: Path, plan: Plan) -> Manifest:
    """Return what is there; shards that are damaged, or lack samples without a reason, go."""
    before = read_manifest(path)
    known = Manifest(plan, before.made_with)  # equal, with the folder of its rigs
    for number in range(plan.n_shards):
        samples, file = plan.shard_samples(number), path / shard_name(number)
        failed = {sample: before.aside[sample] for sample in samples if sample in before.aside}
        if number in before.shards:
            try:
                with opened_shard(file) as shard:
                    there = samples_of(shard)
                    failed = {n: a for n, a in failed.items() if n not in there} | failed_of(shard)
                fault = None if {*there, *failed} == {*samples} else f"{file}: lacks samples"
            except MeasurementError as error:
                fault = str(error)
            if fault is not None:
                warn(f"{fault}; its samples are made again")
                file.unlink()
                continue
            known.shards.add(number)
        known.aside |= failed
    return known


@dataclass(frozen=True, slots=True)
class Work:
    """Samples of a shard; some are known to kill their process, and are not tried.

    One that is not `stored` is only tried, to find whether it does.
    """

    samples: range
    deadly: tuple[Aside, ...] = ()
    stored: bool = True


@dataclass(frozen=True, slots=True)
class Made:
    """How many samples of a shard were made, with their warnings, and which failed."""

    count: int
    failed: Mapping[int, Aside]
    warnings: Mapping[int, str]
    made_with: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ShardMaker:
    """Steps of a `Where`: make the samples of a shard, and put it in its place whole."""

    folder: Path
    plan: Plan
    device: Any = None

    def run(self, work: Work, progress: Progress | None) -> Made:
        """Make a shard. An `OutputError`, such as of a full disk, is no fault of a sample."""
        selector = open_device(self.device).info.selector
        size, level = self.plan.output.shard_size, self.plan.output.compression
        target = self.folder / shard_name(work.samples[0] // size)
        failed = {aside.sample: aside for aside in work.deadly}
        count, warnings = 0, {}
        with new_folder(target) as scratch:
            parts = {sample: scratch / f"{sample:08d}.h5" for sample in work.samples}
            if work.stored:
                self._take_over(target, parts)
            for done, (sample, part) in enumerate(parts.items(), start=1):
                if not part.exists() and sample not in failed:
                    texts: list[str] = []
                    aside = self._try(sample, part, selector, texts)
                    if aside is not None:
                        failed[sample] = aside
                    elif texts:
                        warnings[sample] = "; ".join(texts)
                    count += aside is None
                if progress is not None:
                    progress(done, len(parts))
            if work.stored:
                there = [part for part in parts.values() if part.exists()]
                reasons = [failed[sample] for sample in sorted(failed)]
                assemble(target, there, reasons, compression=level)
        return Made(count, failed, warnings, made_with(open_device(selector)))

    def _take_over(self, target: Path, parts: Mapping[int, Path]) -> None:
        """Take what an earlier shard has, and the parts of version 1; without what is damaged."""
        old = (self.folder / PARTS / part.name for part in parts.values())
        for path in (target, *old):
            if not path.is_file():
                continue
            with suppress(MeasurementError), opened_shard(path) as file:
                for row, sample in enumerate(samples_of(file)):
                    if path == target or parts.get(sample, target).name == path.name:
                        stored, maker = sample_of(file, row, self.plan)
                        level = self.plan.output.compression
                        write_sample(parts[sample], stored, maker, compression=level)

    def _try(self, sample: int, part: Path, selector: str, texts: list[str]) -> Aside | None:
        """Write the part of a sample; return why there is none. Warnings go to `texts`."""
        reason = ""
        for _ in range(ATTEMPTS):
            try:
                device = open_device(selector)
                with handled_warnings(texts.append):  # for the process that shows them
                    made = make_sample(recipe(self.plan, sample), device, rigs=self.plan.folder)
                level = self.plan.output.compression
                write_sample(part, made, made_with(device), compression=level)
                return None
            except OutputError:
                raise
            except Exception as error:
                texts.clear()
                reason = reason_of(error)
                if isinstance(error, DeviceError):
                    forget_devices()  # a context may stay unusable after a failed launch
        return Aside(sample, reason, ATTEMPTS)


class _Run:
    """A run, and what it knows of its data set."""

    def __init__(self, plan: Plan, path: Path, manifest: Manifest) -> None:
        self.plan, self.path, self.manifest = plan, path, manifest
        self._made = self._failures = 0
        self._warned: dict[int, str] = {}
        self._makers: Mapping[str, Any] | None = None

    def to_make(self, retry: bool) -> list[int]:
        """Return the shards that are missing; to retry, also those that lack samples."""
        size = self.plan.output.shard_size
        again = {sample // size for sample in self.manifest.aside} if retry else set()
        return sorted({*self.manifest.missing, *again})

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
        manifest, before = self.manifest, self.manifest.record()
        if self._makers != result.made_with:  # all workers are alike
            for line in differences(dict(manifest.made_with or result.made_with), result.made_with):
                warn(f"{self.path}: has samples made with {line}; their bits depend on it")
        self._makers = result.made_with
        manifest.made_with = manifest.made_with or result.made_with
        manifest.shards.add(work.samples[0] // self.plan.output.shard_size)
        others = {n: aside for n, aside in manifest.aside.items() if n not in work.samples}
        manifest.aside = others | dict(result.failed)
        if manifest.record() != before:
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
