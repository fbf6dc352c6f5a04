"""``clradar diagnose``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.image import check_figure_name
from clradar.cli.images import recording_files
from clradar.cli.options import (
    DeviceOption,
    ForceOption,
    FrameOption,
    VariantOption,
    XOption,
    YOption,
    ZOption,
    grid_text,
    voxel_grid,
    wrong_usage,
)
from clradar.cli.output import (
    check_outputs,
    print_line,
    print_table,
    print_warning,
    progress_bar,
    write_json,
)
from clradar.cli.provenance import provenance
from clradar.cli.simulate import save_with_provenance

if TYPE_CHECKING:
    from calibration import Diagnosis, Score
    from clradar import VoxelGrid

COLUMNS = ("axes", "phase", "frequencies", "x", "sharpness (dB)", "brightest at x, y, z (mm)", "")


def command(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE", help="Native capture, recorded .npy frame, or radar folder."
        ),
    ],
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", help="Figure of all images: .png, .pdf or .svg."),
    ] = None,
    json: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--json", help="File for the result, in metres."),
    ] = None,
    expect_mm: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--expect-mm",
            metavar="X,Y,Z",
            help="Rough position (20 mm) of a known target: tells the image from its mirror image.",
        ),
    ] = None,
    fix_to: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--fix-to", help="Also write the capture in clradar's convention (HDF5)."),
    ] = None,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Forms a coarse image under each of sixteen hypotheses and compares how sharp they are. Where
    to look is found from the range profile; with one of --x-mm, --y-mm, --z-mm, the grid is that
    of the options, whose steps should be coarse (4 mm). See docs/diagnose.md.
    """
    from calibration import apply_convention, diagnose
    from clradar import open_device
    from clradar.errors import ModelError
    from clradar.plot import save_figure
    from measurement_io import open_capture

    expected_m = _position_m(expect_mm)
    grid: VoxelGrid | None = None
    if x_mm is not None or y_mm is not None or z_mm is not None:
        grid = voxel_grid(x_mm or "-100:100:4", y_mm or "-100:100:4", z_mm or "260:340:10")
    if output is not None:
        check_figure_name(output)
    check_outputs([output, json, fix_to], force=force, inputs=[capture])
    loaded = open_capture(capture, frame=frame, variant=None if variant is None else variant.value)
    opened = open_device(device)
    with progress_bar("imaging") as progress:
        result = diagnose(
            loaded, grid=grid, expected_m=expected_m, device=opened, progress=progress
        )
    print_scores(result)
    for reason in result.reasons:
        print_line(f"- {reason}")
    print_line(result.recommendation)
    options = {
        "expect_mm": expect_mm,
        "grid": None if grid is None else grid_text(grid),
        "frame": frame,
        "variant": None if variant is None else variant.value,
    }
    inputs = recording_files(capture, loaded.meta)
    if json is not None:
        record: dict[str, Any] = {"capture": str(capture), **result.to_dict()}
        write_json(json, {**record, **provenance("diagnose", options, inputs)}, force=force)
        print_line(f"{json}: the result, in metres")
    if output is not None and any(s.image is not None for s in result.scores):
        save_figure(figure_of(result, capture.name), output, force=force)
        print_line(f"{output}: the image under each hypothesis")
    elif output is not None:
        print_warning(f"{output}: not drawn, since there is no image")
    if fix_to is None:
        return
    if result.best is None:
        raise ModelError(f"{fix_to}: not written, since the convention of {capture} is not known")
    fixed = apply_convention(loaded, result.best)
    save_with_provenance(fix_to, fixed, "diagnose", options, inputs, force=force)
    print_line(f"{fix_to}: the capture with '{result.best.label}' undone")
    if not result.decided:
        others = " / ".join(f"'{h.label}'" for h in result.candidates[1:])
        print_warning(f"{fix_to}: {others} cannot be ruled out")


def _position_m(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(n) for n in numbers):
        raise wrong_usage("--expect-mm", f"expected X,Y,Z in millimetres, got '{text}'")
    return [n / 1e3 for n in numbers]


def print_scores(result: Diagnosis) -> None:
    """Print one row per hypothesis, the sharpest first."""
    ranked = sorted(
        result.scores, key=lambda s: -s.relative_db if s.relative_db == s.relative_db else math.inf
    )
    rows = []
    for score in ranked:
        h = score.hypothesis
        mark = ""
        if h in result.candidates:
            mark = "best" if h == result.best else "not told apart"
        rows.append(
            [
                "[rx, tx]" if h.swapped else "[tx, rx]",
                "exp(+j)" if h.conjugated else "exp(-j)",
                "descending" if h.reversed else "ascending",
                "mirrored" if h.mirrored else "as given",
                _decibels(score),
                _place(score),
                mark,
            ]
        )
    print_table(COLUMNS, rows, right=COLUMNS[4:6])


def _decibels(score: Score) -> str:
    if math.isnan(score.relative_db):
        return "n/a"
    return f"{score.relative_db:.1f}" if score.relative_db > -100 else "< -100"


def _place(score: Score) -> str:
    if score.image is None:
        return "n/a"
    return ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)


def figure_of(result: Diagnosis, name: str) -> Any:
    """Return the figure: a row for each way of axes and mirror, a column for sign and order."""
    from clradar.plot import panels_figure

    rows: dict[tuple[bool, bool], list[Any]] = {}
    for score in result.scores:
        h = score.hypothesis
        label = f"{h.label} ({_decibels(score)} dB)"
        if h == result.best:
            label = f"BEST: {label}"
        rows.setdefault((h.swapped, h.mirrored), []).append((label, score.image))
    return panels_figure(list(rows.values()), name)
