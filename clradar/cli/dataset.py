"""``clradar dataset``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from clradar.cli.options import DeviceOption, ForceOption, wrong_usage
from clradar.cli.output import (
    check_outputs,
    print_error,
    print_line,
    print_warning,
    progress_bar,
)

if TYPE_CHECKING:
    from clradar.dataset.plan import Plan

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
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Makes training data: posed hands, simulated and imaged, with what they are made of as labels.
    The same command again goes on where it stopped.
    """
    if replay is not None:
        if plan is not None or dry_run:
            raise wrong_usage("--replay", "expected no plan and no --dry-run with it")
        replay_sample(replay[0], replay[1], device, output, force)
        return
    if plan is None:
        raise wrong_usage("PLAN.toml", "expected a plan, or --replay DIR N")
    wanted = checked_plan(plan)
    if dry_run:
        print_estimate(wanted, device)
        return
    if output is None:
        raise wrong_usage("-o", "expected the folder of the data set, or --dry-run")
    make(wanted, output, device, force)


def checked_plan(path: Path) -> Plan:
    """Return a plan; all its mistakes are printed, each on its line."""
    from clradar.dataset.plan_reader import read_plan
    from clradar.dataset.plan_table import PlanError

    try:
        return read_plan(path)
    except PlanError as error:
        for mistake in error.mistakes:
            print_error(mistake)
        raise typer.Exit(1) from None


def make(plan: Plan, output: Path, device: str | None, force: bool) -> None:
    """Make a data set, or go on with one."""
    from clradar.dataset.run import run

    with progress_bar("samples") as progress:
        result = run(plan, output, device=device, force=force, progress=progress)
    for aside in result.aside[:SHOWN_ASIDE]:
        print_warning(
            f"sample {aside.sample} was set aside after {aside.attempts} attempts: {aside.reason}"
        )
    if len(result.aside) > SHOWN_ASIDE:
        print_warning(f"{len(result.aside) - SHOWN_ASIDE} more were set aside; see manifest.json")
    there = result.samples - len(result.aside)
    print_line(f"{output}: {there} of {result.samples} samples, {result.made} of them made now")


def print_estimate(plan: Plan, device: str | None) -> None:
    """Say what a plan would take, from one sample that is made for it."""
    from clradar.dataset.estimate import estimate

    for line in estimate(plan, device=device).lines():
        print_line(line)


def replay_sample(
    folder: Path, index: int, device: str | None, output: Path | None, force: bool
) -> None:
    """Make one sample again and say whether it is the stored one."""
    from clradar.dataset.replay import replay

    check_outputs([output], force=force)
    found = replay(folder, index, device=device, output=output, force=force)
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
