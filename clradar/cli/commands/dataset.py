"""``clradar dataset``: make training data after a plan: posed hands, simulated and imaged."""

from __future__ import annotations

import json
from pathlib import Path

from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_text, progress_bar
from clradar.cli.outputs import check_folder
from clradar.cli.tables import print_replay
from clradar.errors import ClradarError
from clradar.jobs import open_devices


def command(
    *,
    plan: Path | None = opt.argument(
        "The plan of the data set, see docs/datasets.md.", metavar="PLAN.toml"
    ),
    output: Path | None = opt.output_option("Folder of the data set.", folder=True),
    schema: bool = opt.option("Print the JSON schema of plans, for editors, and end.", False),
    dry_run: bool = opt.option(
        "Make one sample, estimate time and space of all, write none.", False
    ),
    replay: tuple[Path, int] | None = opt.option(
        "Make sample N of a data set again and compare it with the stored one, bit by bit.",
        metavar="DIR N",
        without="PLAN.toml --dry-run -o",
    ),
    rigs: Path | None = opt.option(
        "Folder of the plan's rig files. [default: the current folder]",
        metavar="FOLDER",
        needs="--replay",
    ),
    processes: opt.WorkerOptions,
    retry: bool = opt.option("Try the samples again that were set aside.", False),
    device: str | None = opt.DEVICE,
    force: bool = opt.option(
        "Remove the data set that is in the folder, of this plan or another, and begin anew.",
        False,
        panel="Output",
    ),
) -> None:
    """The same command again resumes where it stopped. A sample that cannot be made is set aside;
    the exit status is 1 as long as any is.
    """
    from clradar.dataset import plan_schema, run
    from clradar.dataset.check import estimate, replay as make_again
    from clradar.dataset.plan.plan import read_plan

    if schema:
        print_text(json.dumps(plan_schema(), indent=1))
        return
    if replay is not None:
        selector = open_devices(device).infos[0].selector
        with progress_bar("making the sample"):
            found = make_again(*replay, device=selector, rigs=rigs or "")
        print_replay(*replay, found)
        return
    if plan is None:
        raise opt.wrong_usage("PLAN.toml", "expected a plan, or --replay DIR N")
    wanted = read_plan(plan)
    if dry_run:
        with progress_bar("making two samples"):
            _, _, lines = estimate(wanted, device=open_devices(device).infos[0].selector)
        print_text("\n".join(lines))
        return
    if output is None:
        raise opt.wrong_usage("-o", "expected the folder of the data set, or --dry-run")
    check_folder(output, resumed=True)
    where = processes.where(device, files=())
    with progress_bar("samples") as progress:
        result = run(wanted, output, where=where, force=force, retry=retry, progress=progress)
    there = f"{result.samples - len(result.aside)} of {result.samples} samples"
    print_line(f"{output}: {there}, {result.made} of them made now")
    if result.aside:
        count = counted(len(result.aside), "sample")
        raise ClradarError(f"{output}: {count} set aside; --retry tries again")
