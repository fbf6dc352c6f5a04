"""Make a data set: which samples are missing, an engine that makes them, and their shards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from clradar.dataset.engine.serial import Engine, PartMaker, Serial, absolute, is_device_fault
from clradar.dataset.plan.plan import Plan
from clradar.dataset.sample import found_rig
from clradar.dataset.store.folder import (
    CONTACT_SHEET,
    STATISTICS,
    TABLE,
    Aside,
    DatasetFolder,
    begin,
)
from clradar.dataset.store.repair import queue_corrupt, queue_set_aside
from clradar.dataset.summary.contact_sheet import write_contact_sheet
from clradar.dataset.summary.statistics import write_summary
from clradar.errors import DeviceError, OutputError
from clradar.files.json_differences import differences
from clradar.model.progress import Progress

STOP_AFTER = 10
"""Samples in a row that the device refused: then it is the device's fault, not theirs."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run did.

    Attributes
    ----------
    made : int
        Samples of this run.
    samples : int
        Of the plan.
    aside : tuple of Aside
        All that the data set does without, of earlier runs too.
    """

    made: int
    samples: int
    aside: tuple[Aside, ...]


def run(
    plan: Plan,
    path: Path,
    *,
    device: str | None = None,
    engine: Engine | None = None,
    force: bool = False,
    retry: bool = False,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> RunResult:
    """Make a data set, or what is missing of it.

    Parameters
    ----------
    plan : Plan
    path : Path
        Its folder; one that was begun with the same plan is gone on with.
    device : str or None
        See `clradar.open_device`; of the engine that is used if none is given.
    engine : Engine, optional
        One sample after the other in this process by default.
    force : bool
        Remove the data set that is in the folder, of this plan or another, and begin anew.
    retry : bool
        Try the samples again that earlier runs set aside.
    progress : callable, optional
        Called with (done, total) samples.
    warn : callable, optional
        Called with a line about something that may not be meant.

    Raises
    ------
    ModelError
        The file of a rig is not that of the plan.
    OutputError
        Another plan's data set is in the folder, another process makes it, or it cannot be written
        to.
    DeviceError
        There is no such device, or it refused `STOP_AFTER` samples in a row.
    ClusterError
        The engine's workers do not fit, or are gone.
    """
    engine = Serial(device) if engine is None else engine
    made_with = engine.made_with()
    with begin(path, plan, made_with, force=force) as folder:
        if warn is not None:
            for line in differences(folder.manifest.made_with, made_with):
                warn(f"{path}: was begun with {line}; the bits of samples depend on it")
        for line in queue_corrupt(folder):
            if warn is not None:
                warn(line)
        if retry:
            queue_set_aside(folder)
        try:
            made = _make_missing(folder, engine, progress)
        finally:
            engine.stop()
            folder.remove_half_written()  # of workers that were killed
        if not folder.manifest.complete:
            raise OutputError(
                f"{path}: not all parts that were made are seen here; the same command goes on"
            )
        folder.tidy()  # of workers that were taken for dead
        finish(folder)
        aside = folder.manifest.aside
        return RunResult(made, plan.samples, tuple(aside[sample] for sample in sorted(aside)))


def _make_missing(folder: DatasetFolder, engine: Engine, progress: Progress | None) -> int:
    """Make what is missing, close each shard that is complete, return how many were made."""
    folder.close_ready_shards()
    missing = folder.missing()
    if not missing:
        return 0
    for rig in folder.plan.hands.rigs:
        found_rig(asdict(rig), (folder.plan.folder,))
    size, total = folder.plan.output.shard_size, folder.plan.samples
    open_in = Counter(sample // size for sample in missing)
    done = total - len(missing)
    made = refused = 0
    maker = PartMaker(absolute(folder.path), folder.plan, engine.device)
    for outcome in engine.outcomes(missing, maker):
        if isinstance(outcome, Aside):
            folder.set_aside(outcome)
            sample = outcome.sample
            refused = refused + 1 if is_device_fault(outcome) else 0
        else:
            sample = outcome
            made, refused = made + 1, 0
        open_in[sample // size] -= 1
        if not open_in[sample // size]:
            folder.close_shard_of(sample)
        done += 1
        if progress is not None:
            progress(done, total)
        if isinstance(outcome, Aside) and refused == STOP_AFTER:
            raise DeviceError(
                f"{STOP_AFTER} samples in a row were refused, the last by {outcome.reason}; "
                "see to the device, then go on with --retry"
            )
    return made


def finish(folder: DatasetFolder) -> None:
    """Write statistics and contact sheet of a complete data set, where they are not there."""
    manifest = folder.manifest
    if not manifest.complete:
        return
    if not all((folder.path / name).is_file() for name in (STATISTICS, TABLE)):
        write_summary(folder.path, manifest)
    if not (folder.path / CONTACT_SHEET).is_file():
        write_contact_sheet(folder.path, manifest)
