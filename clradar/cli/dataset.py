"""``clradar dataset``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clradar.cli.options import DeviceOption
from clradar.cli.output import print_error, print_line, print_warning, progress_bar


def command(
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="What is to be made.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the data set.")],
    device: DeviceOption = None,
) -> None:
    """Makes training data: posed hands, simulated, imaged, with labels. The same command again goes
    on where it stopped.
    """
    from clradar.dataset.plan_reader import read_plan
    from clradar.dataset.plan_table import PlanError
    from clradar.dataset.run import run

    try:
        wanted = read_plan(plan)
    except PlanError as error:
        for mistake in error.mistakes:
            print_error(mistake)
        raise typer.Exit(1) from None
    with progress_bar("samples") as progress:
        result = run(wanted, output, device=device, progress=progress)
    for aside in result.aside:
        print_warning(f"sample {aside.sample} was set aside: {aside.reason}")
    there = result.samples - len(result.aside)
    print_line(f"{output}: {there} of {result.samples} samples, {result.made} made now")
