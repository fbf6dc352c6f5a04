"""Runs: make the missing samples of a data set with an engine, and close its shards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clradar.dataset.engine.part_making import (
    Engine,
    Made,
    PartMaker,
    Serial,
    absolute,
    is_device_fault,
)
from clradar.dataset.plan.plan import Plan
from clradar.dataset.sample import found_rig
from clradar.dataset.store.folder import (
    CONTACT_SHEET,
    MANIFEST,
    STATISTICS,
    TABLE,
    Aside,
    DatasetFolder,
    begin,
)
from clradar.dataset.store.repair import queue_corrupt, queue_set_aside
from clradar.dataset.summary.contact_sheet import write_contact_sheet
from clradar.dataset.summary.statistics import write_summary
from clradar.errors import DeviceError, OutputError, warn
from clradar.files.json_differences import differences
from clradar.model.progress import Progress

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
    engine: Engine | None = None,
    force: bool = False,
    retry: bool = False,
    progress: Progress | None = None,
) -> RunResult:
    """Make a data set, or its missing samples.

    Parameters
    ----------
    plan : Plan
    path : Path
        Its folder; a data set of the same plan is resumed.
    device : str or None
        See `clradar.open_device`; of the default engine.
    engine : Engine, optional
        Default: sequential in this process.
    force : bool
        Replace the data set in the folder, of this plan or another.
    retry : bool
        Queue the samples again that earlier runs set aside.
    progress : callable, optional
        Called with (done, total) samples.

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
        The engine's workers differ, or the connection is lost.

    Warns
    -----
    ClradarWarning
        Earlier samples were made with other versions or on another device, files of the folder are
        damaged and made again, or samples are probably not as intended or were set aside.

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
    engine = Serial(device) if engine is None else engine
    made_with = engine.made_with()
    if force or not (path / MANIFEST).exists():
        _check_rigs(plan)  # before a data set is removed, or a folder made
    with begin(path, plan, made_with, force=force) as folder:
        for line in differences(folder.manifest.made_with, made_with):
            warn(f"{path}: has samples made with {line}; their bits depend on it")
        for line in queue_corrupt(folder):
            warn(line)
        if retry:
            queue_set_aside(folder)
        try:
            made = _make_missing(folder, engine, progress)
        finally:
            engine.stop()
            folder.remove_half_written()  # of killed workers
        if not folder.manifest.complete:
            raise OutputError(
                f"{path}: parts that workers wrote are not visible here; the same command resumes"
            )
        folder.tidy()  # parts of workers that Dask took for dead
        finish(folder)
        aside = folder.manifest.aside
        result = RunResult(
            len(made), plan.samples, tuple(aside[sample] for sample in sorted(aside))
        )
    _warn(path, made, result.aside)
    return result


def _make_missing(folder: DatasetFolder, engine: Engine, progress: Progress | None) -> list[Made]:
    """Make the missing samples, close each complete shard, and return what was made."""
    for number in range(folder.plan.n_shards):
        folder.close_shard(number)
    missing = folder.missing()
    if not missing:
        return []
    _check_rigs(folder.plan)
    size, total = folder.plan.output.shard_size, folder.plan.samples
    open_in = Counter(sample // size for sample in missing)
    done = total - len(missing)
    made: list[Made] = []
    failures = 0
    maker = PartMaker(absolute(folder.path), folder.plan, engine.device)
    for outcome in engine.outcomes(missing, maker):
        if isinstance(outcome, Aside):
            folder.set_aside(outcome)
            sample = outcome.sample
            failures = failures + 1 if is_device_fault(outcome) else 0
        else:
            sample = outcome.sample
            made.append(outcome)
            failures = 0
        open_in[sample // size] -= 1
        if not open_in[sample // size]:
            folder.close_shard(sample // size)
        done += 1
        if progress is not None:
            progress(done, total)
        if isinstance(outcome, Aside) and failures == STOP_AFTER:
            raise DeviceError(
                f"{STOP_AFTER} samples in a row failed, the last with {outcome.reason}; "
                "repair the device, then resume with --retry"
            )
    return made


def _check_rigs(plan: Plan) -> None:
    """Raise `ModelError` unless the files of the rigs are those of the plan."""
    for rig in plan.hands.rigs:
        found_rig(rig.model_dump(), (plan.folder,))


def _warn(path: Path, made: Sequence[Made], aside: Sequence[Aside]) -> None:
    """Warn of samples that are not as intended, or that are missing."""
    doubtful = sorted((one for one in made if one.warnings), key=lambda one: one.sample)
    if doubtful:
        warn(
            f"{path}: {len(doubtful)} of {len(made)} samples are probably not as intended, as "
            f"sample {doubtful[0].sample}: {'; '.join(doubtful[0].warnings)}"
        )
    for one in aside[:SHOWN_ASIDE]:
        warn(f"sample {one.sample} was set aside after {one.attempts} attempts: {one.reason}")
    if len(aside) > SHOWN_ASIDE:
        warn(f"{len(aside) - SHOWN_ASIDE} more were set aside; see manifest.json")


def finish(folder: DatasetFolder) -> None:
    """Write the statistics and the contact sheet of a complete data set, if they are missing."""
    manifest = folder.manifest
    if not manifest.complete:
        return
    if not all((folder.path / name).is_file() for name in (STATISTICS, TABLE)):
        write_summary(folder.path, manifest)
    if not (folder.path / CONTACT_SHEET).is_file():
        write_contact_sheet(folder.path, manifest)
