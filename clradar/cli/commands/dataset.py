"""``clradar dataset``: make training data after a plan: posed hands, simulated and imaged."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from clradar.cli.console import (
    counted,
    print_error,
    print_line,
    print_text,
    print_warning,
    progress_bar,
)
from clradar.cli.options.common import DEVICES, WorkerOptions
from clradar.cli.options.groups import argument, option, output_option, wrong_usage
from clradar.cli.outputs import check_outputs, check_place_of_folder

if TYPE_CHECKING:
    from clradar.dataset.plan.plan import Plan
    from clradar.jobs import Where


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


def command(
    *,
    plan: Path | None = argument(
        None, "The plan of the data set, see docs/datasets.md.", metavar="PLAN.toml"
    ),
    output: Path | None = output_option(
        None, "Folder of the data set; with --replay the file to write."
    ),
    schema: bool = option(False, "Print the JSON schema of plans, for editors, and end."),
    dry_run: bool = option(
        False, "Make one sample and estimate time and space of all; write none."
    ),
    repetition: ReplayOptions,
    processes: WorkerOptions,
    retry: bool = option(False, "Try the samples again that were set aside."),
    device: str | None = DEVICES,
    force: bool = option(
        False,
        "Remove the data set that is in the folder, of this plan or another, and begin "
        "anew; with --replay replace the file.",
    ),
) -> None:
    """Makes training data: posed hands, simulated and imaged, with their parameters as labels. The
    same command again resumes where it stopped. A sample that cannot be made is set aside; the exit
    status is 1 as long as any is.
    """

    if schema:
        from clradar.dataset import plan_schema

        print_text(json.dumps(plan_schema(), indent=1))
        return
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
    make(wanted, output, processes.where(device), force=force, retry=retry)


def checked_plan(path: Path) -> Plan:
    """The plan of a file; of several mistakes each is printed on its line, below their number."""
    from clradar.dataset.plan.plan import PlanError, read_plan

    try:
        return read_plan(path)
    except PlanError as error:
        for line in str(error).splitlines():
            print_error(line)
        raise typer.Exit(1) from None


def make(plan: Plan, output: Path, where: Where, *, force: bool, retry: bool) -> None:
    """Make a data set, or resume one."""
    from clradar.dataset.runs import run

    with progress_bar("samples") as progress:
        result = run(plan, output, where=where, force=force, retry=retry, progress=progress)
    there = result.samples - len(result.aside)
    print_line(f"{output}: {there} of {result.samples} samples, {result.made} of them made now")
    if result.aside:
        count = counted(len(result.aside), "sample")
        print_error(f"{output}: {count} set aside; --retry tries again")
        raise typer.Exit(1)


def print_estimate(plan: Plan, device: str | None) -> None:
    """Estimate time and space of a plan from one sample that is made for it."""
    from clradar.dataset.trial import estimate

    with progress_bar("making two samples"):
        _, _, lines = estimate(plan, device=device)
    for line in lines:
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
    from clradar.dataset.trial import replay

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
