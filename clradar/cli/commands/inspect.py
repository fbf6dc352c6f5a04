"""``clradar inspect``: describe what a file or a recording holds, or verify it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import typer

from clradar.cli import options as opt, parse
from clradar.cli.console import counted, print_error, print_text, progress_bar
from clradar.cli.outputs import write
from clradar.errors import MeasurementError


def command(
    file: Path = opt.argument(
        "Capture, volume, recorded .npy frame, radar folder or the one that holds it, or data set.",
    ),
    *,
    check: bool = opt.option("Read and verify everything; exit status 1 if damaged.", False),
    as_json: bool = opt.JSON,
    png: Path | None = opt.written(
        "Also draw it: .png, .pdf or .svg. A capture's echoes and the level of every pair.",
        "--png",
        "-o",
        "--figure",
        without="--check --json",
        check=parse.figure,
    ),
    picture: opt.PictureOptions,
) -> None:
    """Reads, and changes nothing. Nothing is imaged again for the picture."""
    from clradar.cli.comparison import figure_of
    from clradar.dataset.check import check_dataset, describe_dataset
    from clradar.dataset.folder import is_dataset
    from measurement_io import check_file, describe

    dataset = is_dataset(file)
    if dataset and png is not None:
        raise MeasurementError(
            f"{file}: expected a volume, a capture or a recording to draw, got a data set; its "
            "own picture is contact-sheet.png"
        )
    if check:
        with progress_bar("checking") as progress:
            report = (
                check_dataset(file, progress) if dataset else check_file(file, progress=progress)
            )
        record = {**asdict(report), "ok": report.ok}
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
    print_text(json.dumps(found.to_dict(), indent=2, allow_nan=False) if as_json else str(found))
    if png is not None:
        figure = figure_of(file, view=picture.view, plane=picture.slice)
        write(None if figure is None else png, figure, "the picture")
