"""``clradar diagnose``: find the convention a capture was written in: axes, sign, mirror, order."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.console import print_line, print_table, print_warning, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.outputs import provenance, save
from clradar.errors import ModelError
from clradar.files.json_file import write_json
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from calibration import Diagnosis, Hypothesis

COARSE_GRID_MM = ((-100.0, 100.0, 4.0), (-100.0, 100.0, 4.0), (260.0, 340.0, 10.0))


def command(
    *,
    capture: Path = opt.CAPTURE,
    output: Path | None = opt.output_option(
        "Figure of all images: .png, .pdf or .svg.", None, "--figure", check=parse.figure
    ),
    json: Path | None = opt.written("File for the result, in metres."),
    fix_to: Path | None = opt.written("The capture in clradar's convention (HDF5)."),
    expect_mm: tuple[float, ...] | None = opt.option(
        "Rough position (20 mm) of a known target: tells the image from its mirror image.",
        metavar="X,Y,Z",
        parse=parse.position_mm,
    ),
    voxels: opt.GridOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """Forms a coarse image under each of eight hypotheses and compares how sharp they are. The
    range profile shows where to image; with one of --x-mm, --y-mm, --z-mm, the grid is that of the
    options, by default -100:100:4, -100:100:4, 260:340:10. See docs/diagnose.md.
    """
    from calibration import apply_convention, diagnose

    grid = voxels.grid(COARSE_GRID_MM) if voxels.given else None
    expected_m = None if expect_mm is None else parse.metres(expect_mm)
    loaded, sources = opt.open_frame(capture, frames)
    opened = open_devices(device).first
    with progress_bar("imaging") as progress:
        result = diagnose(
            loaded, grid=grid, expected_m=expected_m, device=opened, progress=progress
        )
    if result.scores:
        print_scores(result)
    print_line(result.recommendation)
    origin = provenance(sources)
    if json is not None:
        write_json(json, {"capture": str(capture), **result.to_dict(), **origin}, force=force)
        print_line(f"{json}: the result, in metres")
    if output is not None and result.scores:
        draw(output, result, title_of(capture, loaded.meta), force=force)
        print_line(f"{output}: the image under each hypothesis")
    elif output is not None:
        print_warning(f"{output}: not drawn, since there is no image")
    if fix_to is not None:
        if result.best is None:
            raise ModelError(f"{capture}: not written, since its convention is not known")
        others = [f"'{h.label}'" for h in result.candidates[1:]]
        others += [] if result.mirror_known else ["the mirror image"]
        if others:
            print_warning(f"{capture}: {' / '.join(others)} cannot be ruled out")
        save(fix_to, apply_convention(loaded, result.best), origin, force=force)
        print_line(f"{fix_to}: the capture with '{result.best.label}' undone")


COLUMNS = ("axes", "phase", "frequencies", "sharpness (dB)", "brightest at x, y, z (mm)", "")


def print_scores(result: Diagnosis) -> None:
    """Print one row per hypothesis, the sharpest first."""
    rows = []
    for score in sorted(result.scores, key=lambda s: -np.nan_to_num(s.relative_db, nan=-np.inf)):
        h, place = score.hypothesis, "n/a"
        if score.image is not None:
            place = ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)
        row = ["[rx, tx]" if h.swapped else "[tx, rx]", "exp(+j)" if h.conjugated else "exp(-j)"]
        row += ["descending" if h.reversed else "ascending", decibels(score.relative_db), place]
        rows.append([*row, mark_of(result, h)])
    print_table(COLUMNS, rows, right=COLUMNS[3:5])


def draw(path: Path, result: Diagnosis, title: str, *, force: bool) -> None:
    """Draw the images, a row for each order of axes."""
    from clradar.plot import panels_figure, save_figure

    panels: dict[bool, list[Any]] = {}
    for score in result.scores:
        h, level = score.hypothesis, decibels(score.relative_db)
        label = f"{'BEST: ' * (mark_of(result, h) == 'best')}{h.label}\n{level} dB"
        panels.setdefault(h.swapped, []).append((label, score.image))
    save_figure(panels_figure(list(panels.values()), title), path, force=force)


def mark_of(result: Diagnosis, hypothesis: Hypothesis) -> str:
    """Whether a hypothesis is the best, or one of those that remain."""
    left = [replace(candidate, mirrored=False) for candidate in result.candidates]
    if hypothesis not in left:
        return ""
    return "best" if result.best and hypothesis == left[0] else "ambiguous"


def decibels(relative_db: float) -> str:
    """A level for a table."""
    if math.isnan(relative_db):
        return "n/a"
    return f"{relative_db:.1f}" if relative_db > -100 else "< -100"
