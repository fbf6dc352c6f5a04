"""``clradar diagnose``: find the convention a capture was written in: axes, sign, mirror, order."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli import options as opt, parse, tables
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.outputs import write
from clradar.errors import ModelError
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calibration import Diagnosis

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
        "Rough position (20 mm) of a known target: decides between equally sharp images.",
        metavar="X,Y,Z",
        parse=parse.position_mm,
    ),
    voxels: opt.GridOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Compares how sharp coarse images are under eight hypotheses. The range profile shows where to
    image; with a range, the grid is that of the options, by default -100:100:4, -100:100:4,
    260:340:10. See docs/diagnose.md.
    """
    from calibration import apply_convention, diagnose

    grid = voxels.grid(COARSE_GRID_MM) if opt.given(voxels) else None
    expected_m = None if expect_mm is None else opt.scaled(expect_mm, 1e3)
    loaded = opt.open_frame(capture, frames)
    opened = open_devices(device).first
    with progress_bar("imaging") as progress:
        result = diagnose(
            loaded, grid=grid, expected_m=expected_m, device=opened, progress=progress
        )
    if result.scores:
        tables.print_scores(result)
    print_line(result.recommendation)
    write(json, {"capture": str(capture), **result.to_dict()}, "the result, in metres")
    if result.scores:
        figure = partial(figure_of, result, title_of(capture, loaded.meta))
        write(output, figure, "the image under each hypothesis")
    elif output is not None:
        print_warning(f"{output}: not drawn, since there is no image")
    if fix_to is not None:
        if result.best is None:
            raise ModelError(f"{capture}: not written, since its convention is not known")
        others = [f"'{h.label}'" for h in result.candidates[1:]]
        others += [] if result.mirror_known else ["the mirror image"]
        if others:
            print_warning(f"{capture}: {' / '.join(others)} cannot be ruled out")
        fixed = apply_convention(loaded, result.best)
        write(fix_to, fixed, f"the capture with '{result.best.label}' undone")


def figure_of(result: Diagnosis, title: str) -> Figure:
    """The images, a row for each order of axes."""
    from clradar.plot import panels_figure

    panels: dict[bool, list[Any]] = {}
    for score in result.scores:
        h, level = score.hypothesis, tables.decibels(score.relative_db)
        label = f"{'BEST: ' * (tables.mark_of(result, h) == 'best')}{h.label}\n{level} dB"
        panels.setdefault(h.swapped, []).append((label, score.image))
    return panels_figure(list(panels.values()), title)
