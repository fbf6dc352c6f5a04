"""``clradar dataset``: make training data after a plan: posed hands, simulated and imaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from clradar.cli.console import counted, print_error, print_line, print_warning, progress_bar
from clradar.cli.opening import open_written, require_picture
from clradar.cli.options.common import DevicesOption, OpenOption
from clradar.cli.options.groups import argument, option, output_option
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs, check_place_of_folder
from clradar.errors import ClusterError

if TYPE_CHECKING:
    from clradar.dataset.engine.part_making import Engine
    from clradar.dataset.plan.plan import Plan


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """The sample of an earlier data set to make again."""

    replay: tuple[Path, int] | None = option(
        None,
        "Make sample N of a data set again and compare it with the stored one, bit by bit.",
        metavar="DIR N",
    )
    rigs: Path | None = option(
        None,
        "With --replay: folder that the plan's names of rig files are relative to. [default: the "
        "current folder, then the data set's]",
        metavar="FOLDER",
    )


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """The processes that make the samples."""

    workers: int | None = option(
        None,
        "Make samples in N processes, each with a GPU or a share of the cores. "
        "[default: one for each of several devices, else in this process]",
        metavar="N",
        min=1,
    )
    scheduler: str | None = option(
        None,
        "Make samples on the workers of a Dask scheduler, tcp://HOST:PORT; see "
        "docs/datasets-cluster.md.",
        metavar="ADDRESS",
    )

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise wrong_usage("--scheduler", "expected no --workers with it: it has its own")

    @contextmanager
    def engine(self, device: str | None) -> Iterator[Engine]:
        """This process, new ones, or those of a running cluster."""
        from clradar.dataset.engine.part_making import Serial
        from clradar.dataset.engine.worker_resources import divided, worker_resources

        workers = None
        if self.scheduler is None:
            workers, device = divided(self.workers, device)
        if workers is None and self.scheduler is None:
            yield Serial(device)
            return
        try:
            from clradar.dataset.engine.cluster import (
                cluster_text,
                local_cluster,
                running_cluster,
                silence,
            )
            from clradar.dataset.engine.distributed import Distributed
        except ImportError as error:
            raise ClusterError(
                "--workers, --scheduler and several devices need Dask: "
                f"pip install 'clradar[dataset]' ({error})"
            ) from error
        silence()
        if self.scheduler is not None:
            with running_cluster(self.scheduler) as client:
                print_line(cluster_text(client))
                yield Distributed(client, device)
            return
        assert workers is not None
        with local_cluster(worker_resources(workers, device)) as (client, end):
            print_line(cluster_text(client))
            # Each worker has its device in CLRADAR_DEVICE.
            yield Distributed(client, end_workers=end)


def command(
    *,
    plan: Path | None = argument(
        None, "The plan of the data set, see docs/datasets.md.", metavar="PLAN.toml"
    ),
    output: Path | None = output_option(
        None, "Folder of the data set; with --replay the file to write."
    ),
    dry_run: bool = option(
        False, "Make one sample and estimate time and space of all; write none."
    ),
    repetition: ReplayOptions,
    processes: EngineOptions,
    retry: bool = option(False, "Try the samples again that were set aside."),
    device: DevicesOption = None,
    force: bool = option(
        False,
        "Remove the data set that is in the folder, of this plan or another, and begin "
        "anew; with --replay replace the file.",
    ),
    show: OpenOption = False,
) -> None:
    """Makes training data: posed hands, simulated and imaged, with their parameters as labels. The
    same command again resumes where it stopped. A sample that cannot be made is set aside; the exit
    status is 1 as long as any is.
    """
    from clradar.dataset.store.folder import CONTACT_SHEET

    made = output if repetition.replay is None and not dry_run else None
    require_picture(show, "PLAN.toml and -o", made)
    if repetition.replay is not None:
        if plan is not None or dry_run:
            raise wrong_usage("--replay", "expected no plan and no --dry-run with it")
        replay_sample(*repetition.replay, device, output, force, repetition.rigs)
        return
    if repetition.rigs is not None:
        raise wrong_usage("--rigs", "expected it with --replay only: a plan's own folder counts")
    if plan is None:
        raise wrong_usage("PLAN.toml", "expected a plan, or --replay DIR N")
    wanted = checked_plan(plan)
    if dry_run:
        print_estimate(wanted, device)
        return
    if output is None:
        raise wrong_usage("-o", "expected the folder of the data set, or --dry-run")
    check_place_of_folder(output)
    with processes.engine(device) as engine:
        make(wanted, output, engine, force=force, retry=retry)
    open_written(show, output / CONTACT_SHEET)


def checked_plan(path: Path) -> Plan:
    """The plan of a file; of several mistakes each is printed on its line, below their number."""
    from clradar.dataset.plan.reader import read_plan
    from clradar.dataset.plan.table import PlanError

    try:
        return read_plan(path)
    except PlanError as error:
        for line in str(error).splitlines():
            print_error(line)
        raise typer.Exit(1) from None


def make(plan: Plan, output: Path, engine: Engine, *, force: bool, retry: bool) -> None:
    """Make a data set, or resume one."""
    from clradar.dataset.engine.run import run

    with progress_bar("samples") as progress:
        result = run(plan, output, engine=engine, force=force, retry=retry, progress=progress)
    there = result.samples - len(result.aside)
    print_line(f"{output}: {there} of {result.samples} samples, {result.made} of them made now")
    if result.aside:
        count = counted(len(result.aside), "sample")
        print_error(f"{output}: {count} set aside; --retry tries again")
        raise typer.Exit(1)


def print_estimate(plan: Plan, device: str | None) -> None:
    """Estimate time and space of a plan from one sample that is made for it."""
    from clradar.dataset.engine.estimate import estimate

    with progress_bar("making two samples"):
        found = estimate(plan, device=device)
    for line in found.lines():
        print_line(line)


def replay_sample(
    folder: Path,
    index: int,
    device: str | None,
    output: Path | None,
    force: bool,
    rigs: Path | None,
) -> None:
    """Make one sample again and compare it with the stored one."""
    from clradar.dataset.engine.replay import replay

    check_outputs([output], force=force)
    with progress_bar("making the sample"):
        found = replay(folder, index, device=device, output=output, force=force, rigs=rigs)
    if output is not None:
        print_line(f"{output}: sample {index}, made again")
    if found.stored_in is None:
        print_warning(f"sample {index} is not in {folder}: there was nothing to compare with")
        return
    if not found.differences:
        print_line(f"sample {index}: the same bits as in {folder / found.stored_in}")
        return
    for line in found.made_otherwise:
        print_warning(f"made otherwise then: {line}")
    for line in found.differences:
        print_line(line)
    count = counted(len(found.differences), "difference")
    print_error(f"sample {index}: {count} to that in {folder / found.stored_in}")
    raise typer.Exit(1)
