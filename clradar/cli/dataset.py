"""``clradar dataset``."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from clradar.cli.options import DeviceOption, wrong_usage
from clradar.cli.output import (
    check_outputs,
    print_error,
    print_line,
    print_warning,
    progress_bar,
)
from clradar.errors import ClusterError

if TYPE_CHECKING:
    from clradar.dataset.engine.serial import Engine
    from clradar.dataset.plan.plan import Plan

SHOWN_ASIDE = 20
"""Samples set aside that are named at the end; the manifest has all."""


def command(
    plan: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Argument(metavar="PLAN.toml", help="What is to be made, see docs/datasets.md."),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "-o", "--output", help="Folder of the data set; with --replay the file to write."
        ),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Make one sample and say what all would take; write none."),
    ] = False,
    replay: Annotated[
        Optional[tuple[Path, int]],  # noqa: UP045
        typer.Option(
            "--replay",
            metavar="DIR N",
            help="Make sample N of a data set again and hold it against the stored one, bit by "
            "bit.",
        ),
    ] = None,
    rigs: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--rigs",
            metavar="FOLDER",
            help="With --replay: what the plan's names of rig files are relative to. [default: the "
            "current folder, then the data set's]",
        ),
    ] = None,
    workers: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--workers",
            metavar="N",
            min=1,
            help="Make samples in N processes, each with a GPU or a share of the cores. "
            "[default: in this process]",
        ),
    ] = None,
    scheduler: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Make samples on the workers of a Dask scheduler, tcp://HOST:PORT; see "
            "docs/datasets-cluster.md.",
        ),
    ] = None,
    retry: Annotated[
        bool,
        typer.Option("--retry", help="Try the samples again that were set aside."),
    ] = False,
    device: DeviceOption = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Remove the data set that is in the folder, of this plan or another, and begin "
            "anew; with --replay replace the file.",
        ),
    ] = False,
) -> None:
    """Makes training data: posed hands, simulated and imaged, with what they are made of as labels.
    The same command again goes on where it stopped. A sample that cannot be made is set aside; the
    exit status is 1 as long as any is.
    """
    if workers is not None and scheduler is not None:
        raise wrong_usage("--scheduler", "expected no --workers with it: it has its own")
    if replay is not None:
        if plan is not None or dry_run:
            raise wrong_usage("--replay", "expected no plan and no --dry-run with it")
        replay_sample(replay[0], replay[1], device, output, force, rigs)
        return
    if rigs is not None:
        raise wrong_usage("--rigs", "expected it with --replay only: a plan's own folder counts")
    if plan is None:
        raise wrong_usage("PLAN.toml", "expected a plan, or --replay DIR N")
    wanted = checked_plan(plan)
    if dry_run:
        print_estimate(wanted, device)
        return
    if output is None:
        raise wrong_usage("-o", "expected the folder of the data set, or --dry-run")
    with engine(workers, scheduler, device) as chosen:
        make(wanted, output, chosen, force=force, retry=retry)


def checked_plan(path: Path) -> Plan:
    """Return a plan; all its mistakes are printed, each on its line."""
    from clradar.dataset.plan.reader import read_plan
    from clradar.dataset.plan.table import PlanError

    try:
        return read_plan(path)
    except PlanError as error:
        for mistake in error.mistakes:
            print_error(mistake)
        raise typer.Exit(1) from None


@contextmanager
def engine(workers: int | None, scheduler: str | None, device: str | None) -> Iterator[Engine]:
    """Yield what makes the samples: this process, new ones, or those of a running cluster."""
    from clradar.dataset.engine.serial import Serial

    if workers is None and scheduler is None:
        yield Serial(device)
        return
    try:
        from clradar.dataset.engine.cluster import dashboard_text, local_cluster, running_cluster
        from clradar.dataset.engine.distributed import Distributed
    except ImportError as error:
        raise ClusterError(
            f"--workers and --scheduler need Dask: pip install 'clradar[dataset]' ({error})"
        ) from error
    _quiet_dask()
    if scheduler is not None:
        with running_cluster(scheduler) as client:
            print_line(dashboard_text(client))
            yield Distributed(client, device)
        return
    from clradar.dataset.engine.worker_resources import worker_resources

    assert workers is not None
    with local_cluster(worker_resources(workers, device)) as (client, end):
        print_line(dashboard_text(client))
        # Each worker has its device in CLRADAR_DEVICE.
        yield Distributed(client, end_workers=end)


def _quiet_dask() -> None:
    """Silence Dask's own words: what becomes of samples and workers is said here."""
    # Dask gives some of its loggers levels of their own, so that the parent's does not count.
    known = list(logging.root.manager.loggerDict)
    for name in {"distributed", "tornado.application", "asyncio", *known}:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def make(plan: Plan, output: Path, chosen: Engine, *, force: bool, retry: bool) -> None:
    """Make a data set, or go on with one."""
    from clradar.dataset.engine.run import run

    try:
        with progress_bar("samples") as progress:
            result = run(
                plan,
                output,
                engine=chosen,
                force=force,
                retry=retry,
                progress=progress,
                warn=print_warning,
            )
    except KeyboardInterrupt:
        print_error(f"interrupted; the same command goes on with {output}")
        raise
    for aside in result.aside[:SHOWN_ASIDE]:
        print_warning(
            f"sample {aside.sample} was set aside after {aside.attempts} attempts: {aside.reason}"
        )
    if len(result.aside) > SHOWN_ASIDE:
        print_warning(f"{len(result.aside) - SHOWN_ASIDE} more were set aside; see manifest.json")
    there = result.samples - len(result.aside)
    print_line(f"{output}: {there} of {result.samples} samples, {result.made} of them made now")
    if result.aside:
        count = len(result.aside)
        print_error(
            f"{output}: {count} sample{'s' if count > 1 else ''} set aside; --retry tries again"
        )
        raise typer.Exit(1)


def print_estimate(plan: Plan, device: str | None) -> None:
    """Say what a plan would take, from one sample that is made for it."""
    from clradar.dataset.engine.estimate import estimate

    for line in estimate(plan, device=device).lines():
        print_line(line)


def replay_sample(
    folder: Path,
    index: int,
    device: str | None,
    output: Path | None,
    force: bool,
    rigs: Path | None,
) -> None:
    """Make one sample again and say whether it is the stored one."""
    from clradar.dataset.engine.replay import replay

    check_outputs([output], force=force)
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
    count = len(found.differences)
    print_error(
        f"sample {index}: {count} difference{'s' if count > 1 else ''} to that in "
        f"{folder / found.stored_in}"
    )
    raise typer.Exit(1)
