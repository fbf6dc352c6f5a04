"""``clradar bench``: time the core against other libraries on this machine."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.console import print_line, print_text
from clradar.cli.options.common import ForceOption
from clradar.cli.options.groups import option
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs
from clradar.errors import ClradarError
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from clradar.bench.timing import Row


def command(
    device: list[str] | None = option(
        None, "OpenCL device; repeat to compare several in one run.", metavar="NAME"
    ),
    only: list[
        Literal[
            "visibility",
            "bounces",
            "trees",
            "growth",
            "phasors",
            "images",
            "operators",
            "physical",
            "exact",
            "commands",
        ]
    ]
    | None = option(None, "One benchmark; repeat for several. [default: all]"),
    quick: bool = option(False, "Smaller sizes, for a quick run."),
    repeats: int = option(5, "Runs of which the median counts.", metavar="N"),
    json_file: Path | None = option(
        None, "Also write the figures.", names=("--json",), metavar="FILE"
    ),
    force: ForceOption = False,
) -> None:
    """Each piece of work against a peer in the same run, and whether both agree. Ratios matter, not
    seconds: machines differ and are noisy. Install the peers by `pip install clradar[bench]`;
    docs/performance.md has the results.
    """
    import os
    import platform

    from clradar import open_device

    if repeats < 1:
        raise wrong_usage("--repeats", f"expected 1 or more, got {repeats}")
    check_outputs([json_file], force=force)
    opened = [open_device(name) for name in device] if device else [open_device()]
    try:
        from clradar.bench.suite import SUITE, Effort, run_suite
    except ModuleNotFoundError as error:
        raise ClradarError(
            f"the peer {error.name} is not installed; install all of them with: "
            "pip install 'clradar[bench]'"
        ) from error
    names = list(only) if only else list(SUITE)
    effort = Effort(quick, min(repeats, 3) if quick else repeats)
    results: list[dict[str, Any]] = []
    for one in opened:
        print_line(
            f"{one.info.label}, {os.cpu_count()} cores, {platform.machine()}, medians of "
            f"{effort.repeats}"
        )
        rows = []
        for row in run_suite(one, names, effort):
            print_row(row)
            rows.append(asdict(row))
        results.append({"device": dict(one.describe()), "cores": os.cpu_count(), "rows": rows})
    if json_file is not None:
        write_json(json_file, {"repeats": effort.repeats, "results": results}, force=force)


def print_row(row: Row) -> None:
    """Print one piece of work: ours, the peer's, the ratio."""
    lines = [row.work, f"    ours  {row.ours}"]
    if row.peer:
        lines += [f"    peer  {row.peer}", f"    ratio {row.ratio:.1f} x   ({row.check})"]
    print_text("\n".join(lines))
