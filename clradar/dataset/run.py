"""Make a data set: which samples are missing, an engine that makes them, and their shards."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clradar import __version__
from clradar.dataset.contact_sheet import write_contact_sheet
from clradar.dataset.folder import (
    CONTACT_SHEET,
    STATISTICS,
    TABLE,
    Aside,
    DatasetFolder,
    begin,
    part_path,
)
from clradar.dataset.make import make_sample
from clradar.dataset.plan import Plan
from clradar.dataset.recipe import recipe
from clradar.dataset.shard import write_sample
from clradar.dataset.summary import write_summary
from clradar.errors import OutputError
from clradar.opencl import Device, open_device
from clradar.trace import Progress
from clradar.versions import package_versions
from measurement_io.failures import clean

ATTEMPTS = 2
"""How often a sample is tried before it is set aside."""


@dataclass(frozen=True, slots=True)
class PartMaker:
    """Makes one sample and writes its part. Can be sent to another process.

    Attributes
    ----------
    folder : Path
        Of the data set; every process that makes parts has to see it under this name.
    plan : Plan
    device : str or None
        See `clradar.open_device`; opened where the part is made.
    """

    folder: Path
    plan: Plan
    device: str | None = None

    def __call__(self, sample: int) -> int:
        """Make sample `sample`, write its part whole or not at all, return its number."""
        device = open_device(self.device)
        made = make_sample(recipe(self.plan, sample), device)
        target = part_path(self.folder, sample)
        output = self.plan.output
        write_sample(target, made, made_with(device), compression=output.compression, force=True)
        return sample


Outcome = int | Aside
"""A sample that is made, or why it is not."""

Engine = Callable[[Sequence[int], PartMaker], Iterator[Outcome]]
"""Makes the parts of samples in any order, and yields what became of each as soon as it is known.

An `OutputError` of a part (a full disk) ends the run; any other error is the sample's.
"""


def serial(samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
    """Make one sample after the other in this process: the engine that needs nothing."""
    for sample in samples:
        yield _tried(sample, make)


def _tried(sample: int, make: PartMaker) -> Outcome:
    for attempt in range(1, ATTEMPTS + 1):
        try:
            return make(sample)
        except OutputError:
            raise
        except Exception as error:
            if attempt == ATTEMPTS:
                return Aside(sample, clean(f"{type(error).__name__}: {error}"), attempt)
    raise AssertionError("unreachable")


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


def made_with(device: Device) -> dict[str, Any]:
    """Return the versions and the device that a sample's bits depend on."""
    return {
        "clradar": __version__,
        "packages": package_versions(),
        "python": platform.python_version(),
        "device": dict(device.describe()),
    }


def run(
    plan: Plan,
    path: Path,
    *,
    device: str | None = None,
    engine: Engine = serial,
    force: bool = False,
    progress: Progress | None = None,
) -> RunResult:
    """Make a data set, or what is missing of it.

    Parameters
    ----------
    plan : Plan
    path : Path
        Its folder; one that was begun with the same plan is gone on with.
    device : str or None
        See `clradar.open_device`.
    engine : callable
        See `Engine`.
    force : bool
        Remove the data set of another plan that is in the folder.
    progress : callable, optional
        Called with (done, total) samples.

    Raises
    ------
    OutputError
        Another plan's data set is in the folder, or it cannot be written to.
    """
    with begin(path, plan, made_with(open_device(device)), force=force) as folder:
        folder.close_ready_shards()
        missing = folder.missing()
        done = plan.samples - len(missing)
        made = 0
        for outcome in engine(missing, PartMaker(path, plan, device)):
            if isinstance(outcome, Aside):
                folder.set_aside(outcome)
                sample = outcome.sample
            else:
                sample = outcome
                made += 1
            folder.close_shard_of(sample)
            done += 1
            if progress is not None:
                progress(done, plan.samples)
        finish(folder)
        aside = folder.manifest.aside
        return RunResult(made, plan.samples, tuple(aside[sample] for sample in sorted(aside)))


def finish(folder: DatasetFolder) -> None:
    """Write statistics and contact sheet of a complete data set, where they are not there."""
    manifest = folder.manifest
    if not manifest.complete:
        return
    if not all((folder.path / name).is_file() for name in (STATISTICS, TABLE)):
        write_summary(folder.path, manifest)
    if not (folder.path / CONTACT_SHEET).is_file():
        write_contact_sheet(folder.path, manifest)
