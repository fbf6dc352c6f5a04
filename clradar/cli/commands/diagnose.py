"""``clradar diagnose``: find the convention a capture was written in: axes, sign, mirror, order."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.fits import decibels, mark_of, print_scores
from clradar.cli.inputs import title_of
from clradar.cli.options.common import CAPTURE, DEVICE, FORCE
from clradar.cli.options.groups import option, output_option
from clradar.cli.options.measured import FrameOptions, GridOptions, grid_text
from clradar.cli.outputs import check_figure, check_outputs, provenance, save
from clradar.cli.parse import position_m
from clradar.errors import ModelError
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    pass

COARSE_GRID_MM = ("-100:100:4", "-100:100:4", "260:340:10")


def command(
    *,
    capture: Path = CAPTURE,
    output: Path | None = output_option(
        "Figure of all images: .png, .pdf or .svg.", None, "--figure"
    ),
    json: Path | None = option("File for the result, in metres.", panel="Output"),
    fix_to: Path | None = option("The capture in clradar's convention (HDF5).", panel="Output"),
    expect_mm: str | None = option(
        "Rough position (20 mm) of a known target: tells the image from its mirror image.",
        metavar="X,Y,Z",
    ),
    voxels: GridOptions,
    frames: FrameOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Forms a coarse image under each of eight hypotheses and compares how sharp they are. The
    range profile shows where to image; with one of --x-mm, --y-mm, --z-mm, the grid is that of the
    options, by default -100:100:4, -100:100:4, 260:340:10. See docs/diagnose.md.
    """
    from calibration import apply_convention, diagnose
    from clradar.jobs import open_devices
    from clradar.plot import panels_figure, save_figure

    expected_m = None if expect_mm is None else position_m("--expect-mm", expect_mm)
    grid = voxels.grid(COARSE_GRID_MM) if voxels.given else None
    check_figure(output)
    check_outputs([output, json, fix_to], force=force, inputs=[capture])
    loaded, sources = frames.open(capture)
    opened = open_devices(device).first
    settings: dict[str, Any] = {"grid": grid, "expected_m": expected_m, "device": opened}
    with progress_bar("imaging") as progress:
        result = diagnose(loaded, progress=progress, **settings)
    if result.scores:
        print_scores(result)
    print_line(result.recommendation)
    options = {"expect_mm": expect_mm, "grid": None if grid is None else grid_text(grid)}
    origin = provenance("diagnose", sources, frames, **options)
    if json is not None:
        record = {"capture": str(capture), **result.to_dict(), **origin}
        write_json(json, record, force=force)
        print_line(f"{json}: the result, in metres")
    if output is not None and result.scores:
        panels: dict[bool, list[Any]] = {}  # a row for each order of axes
        for score in result.scores:
            h, level = score.hypothesis, decibels(score.relative_db)
            label = f"{'BEST: ' * (mark_of(result, h) == 'best')}{h.label}\n{level} dB"
            panels.setdefault(h.swapped, []).append((label, score.image))
        figure = panels_figure(list(panels.values()), title_of(capture, loaded.meta))
        save_figure(figure, output, force=force)
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
