"""``clradar diagnose``: find the convention a capture was written in: axes, sign, mirror, order."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import print_line, print_table, print_warning, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.options.common import CAPTURE, DEVICE, FORCE
from clradar.cli.options.groups import option, output_option
from clradar.cli.options.measured import FrameOptions, GridOptions, axis_option, grid_text
from clradar.cli.outputs import check_figure, check_outputs, provenance, save
from clradar.cli.parse import position_m
from clradar.errors import ModelError
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import Diagnosis, Score

COLUMNS = ("axes", "phase", "frequencies", "sharpness (dB)", "brightest at x, y, z (mm)", "")

COARSE_GRID_MM = ("-100:100:4", "-100:100:4", "260:340:10")


def _default(axis: int) -> str:
    return f"around the echo; {COARSE_GRID_MM[axis]} if another axis is given"


@dataclass(frozen=True, kw_only=True)
class SearchGridOptions(GridOptions):
    """The voxel grid, in millimetres: that of the options if one of them is given."""

    x_mm: str | None = axis_option("x", _default(0))
    y_mm: str | None = axis_option("y", _default(1))
    z_mm: str | None = axis_option("z", _default(2))


@dataclass(frozen=True, kw_only=True)
class DiagnosisFiles:
    """Files of a diagnosis, none of which has to be written."""

    output: Path | None = output_option(None, "Figure of all images: .png, .pdf or .svg.")
    json: Path | None = option(None, "File for the result, in metres.")
    fix_to: Path | None = option(None, "Also write the capture in clradar's convention (HDF5).")


def command(
    *,
    capture: Path = CAPTURE,
    files: DiagnosisFiles,
    expect_mm: str | None = option(
        None,
        "Rough position (20 mm) of a known target: separates the image from its mirror image.",
        metavar="X,Y,Z",
    ),
    voxels: SearchGridOptions,
    frames: FrameOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Forms a coarse image under each of eight hypotheses and compares how sharp they are. The
    range profile shows where to image; with one of --x-mm, --y-mm, --z-mm, the grid is that of the
    options, whose steps should be coarse (4 mm). See docs/diagnose.md.
    """
    from calibration import diagnose
    from clradar.plot import save_figure

    expected_m = None if expect_mm is None else position_m("--expect-mm", expect_mm)
    grid = voxels.grid(COARSE_GRID_MM) if voxels.given else None
    check_figure(files.output)
    check_outputs([files.output, files.json, files.fix_to], force=force, inputs=[capture])
    loaded, sources = frames.open(capture)
    opened = cl.open_device(device)
    with progress_bar("imaging") as progress:
        result = diagnose(
            loaded, grid=grid, expected_m=expected_m, device=opened, progress=progress
        )
    if result.scores:
        print_scores(result)
    print_line(result.recommendation)
    options = {"expect_mm": expect_mm, "grid": None if grid is None else grid_text(grid)}
    origin = provenance("diagnose", sources, frames, **options)
    if files.json is not None:
        record = {"capture": str(capture), **result.to_dict(), **origin}
        write_json(files.json, record, force=force)
        print_line(f"{files.json}: the result, in metres")
    if files.output is not None and result.scores:
        save_figure(figure_of(result, title_of(capture, loaded.meta)), files.output, force=force)
        print_line(f"{files.output}: the image under each hypothesis")
    elif files.output is not None:
        print_warning(f"{files.output}: not drawn, since there is no image")
    if files.fix_to is not None:
        save(files.fix_to, fixed(capture, loaded, result), origin, force=force)
        assert result.best is not None
        print_line(f"{files.fix_to}: the capture with '{result.best.label}' undone")


def fixed(source: Path, capture: cl.Capture, result: Diagnosis) -> cl.Capture:
    """The capture in clradar's convention."""
    from calibration import apply_convention

    if result.best is None:
        raise ModelError(f"{source}: not written, since its convention is not known")
    others = [f"'{h.label}'" for h in result.candidates[1:]]
    others += [] if result.mirror_known else ["the mirror image"]
    if others:
        print_warning(f"{source}: {' / '.join(others)} cannot be ruled out")
    return apply_convention(capture, result.best)


def print_scores(result: Diagnosis) -> None:
    """Print one row per hypothesis, the sharpest first."""

    def rank(score: Score) -> float:
        return math.inf if math.isnan(score.relative_db) else -score.relative_db

    rows = []
    left = [replace(candidate, mirrored=False) for candidate in result.candidates]
    for score in sorted(result.scores, key=rank):
        h = score.hypothesis
        mark = "" if h not in left else "best" if result.best and h == left[0] else "ambiguous"
        place_mm = "n/a"
        if score.image is not None:
            place_mm = ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)
        row = ["[rx, tx]" if h.swapped else "[tx, rx]", "exp(+j)" if h.conjugated else "exp(-j)"]
        row += ["descending" if h.reversed else "ascending", _decibels(score), place_mm, mark]
        rows.append(row)
    print_table(COLUMNS, rows, right=COLUMNS[3:5], keys=3)


def _decibels(score: Score) -> str:
    if math.isnan(score.relative_db):
        return "n/a"
    return f"{score.relative_db:.1f}" if score.relative_db > -100 else "< -100"


def figure_of(result: Diagnosis, name: str) -> Any:
    """The figure: a row for each order of axes, a column for sign and order."""
    from clradar.plot import panels_figure

    rows: dict[bool, list[Any]] = {}
    for score in result.scores:
        h = score.hypothesis
        is_best = result.best is not None and h == replace(result.best, mirrored=False)
        label = f"{'BEST: ' * is_best}{h.label}\n{_decibels(score)} dB"
        rows.setdefault(h.swapped, []).append((label, score.image))
    return panels_figure(list(rows.values()), name)
