"""``clradar inspect``: describe what a file or a recording holds, or verify it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import typer

from clradar.cli.console import counted, print_error, print_text, progress_bar
from clradar.cli.options.groups import REQUIRED, argument, option
from clradar.errors import MeasurementError


def command(
    file: Path = argument(
        REQUIRED,
        "Capture, volume, recorded .npy frame, radar folder, the <object>/<distance> "
        "folder that holds one, or the folder of a data set.",
        metavar="FILE",
    ),
    check: bool = option(False, "Read and verify everything; exit status 1 if damaged."),
    as_json: bool = option(False, "Print JSON for programs.", names=("--json",)),
) -> None:
    """Reads and changes nothing."""
    from clradar.dataset.store.check import check_dataset, describe_dataset
    from clradar.dataset.store.folder import is_dataset
    from measurement_io import check_file, describe

    dataset = is_dataset(file)
    if check:
        with progress_bar("checking") as progress:
            report = check_dataset(file, progress) if dataset else check_file(file)
        record: dict[str, Any] = {
            "path": report.path,
            "ok": report.ok,
            "checked": list(report.checked),
            "problems": list(report.problems),
        }
        print_text(json.dumps(record, indent=2) if as_json else str(report))
        if not report.ok:
            print_error(f"{file}: {counted(len(report.problems), 'problem')} found")
            raise typer.Exit(1)
        return
    try:
        found = describe_dataset(file) if dataset else describe(file)
    except MeasurementError as error:
        if dataset or not file.is_dir():
            raise
        raise MeasurementError(
            f"{error}; nor is it a data set, which has manifest.json and shards"
        ) from error
    text = json.dumps(found.to_dict(), indent=2, allow_nan=False) if as_json else str(found)
    print_text(text)
