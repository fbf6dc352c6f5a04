"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import clradar as cl
from clradar.cli import comparison, parse
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_table, progress_bar
from clradar.cli.inputs import Measurement, measurement
from clradar.cli.outputs import check_folder, provenance, whole_folder
from clradar.errors import ClradarWarning
from clradar.files.json_file import write_json
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from typing import Any

    from calibration import HandFit

POSE, HAND_FIT, OVERLAY = "pose.toml", "fit.json", "overlay.png"
FILES = (POSE, HAND_FIT, OVERLAY, *comparison.SIMULATION_FILES)


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(opt.HandOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = opt.option(
        "Where the fit starts: a name (`clradar hand --list`), a pose file, the folder of an "
        "earlier fit, several of them, or all: every letter.",
        "all",
        "--pose",
        "--start",
        metavar="POSE,...",
    )
    alpha: float | str = opt.alpha_or_fit()
    quick: bool = opt.option(
        "Without the simulations that correct the bias and find alpha: less exact.", False
    )


def command(
    *,
    measured: Path = opt.MEASURED,
    output: Path = opt.output_option("New folder.", opt.REQUIRED, metavar="DIR", folder=True),
    fitting: HandFitOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    frame: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """Joint angles within their limits, place, alpha, and with --fit-shape the hand's size, so that
    the hand looks like MEASURED. No mesh is needed. DIR gets pose.toml (for `clradar hand` and data
    sets), placed.ply (for `clradar simulate`), fit.json with what the measurement tells and what
    not, the hand's simulation (capture.h5, volume.h5), two pictures and the metrics: all or
    nothing. Captures are imaged first, on the grid of the options. See docs/hand-fit.md.
    """
    from calibration import fit_hand

    starts = opt.StartNames(fitting.pose)
    read = [*starts.files, *opt.files_of(fitting)]
    check_folder(output, force=force, replaced=FILES, inputs=[measured, *read, *radar.files])
    alpha = None if fitting.alpha == parse.FIT else fitting.alpha
    settings = {**fitting.settings(starts), "alpha": alpha, "closed_loop": not fitting.quick}
    opened = open_devices(device).first
    found = measurement(measured, frame, radar, voxels, imaging, opened)
    with progress_bar("fitting") as progress:
        fit = fit_hand(found.volume, device=opened, progress=progress, **settings, **found.radar)
    origin = provenance([*found.files, *read], grid=opt.grid_text(found.volume.grid))
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_hand_fit(made, found, fit, fitting.seed, opened, origin)
    print_hand_fit(fit)
    print_line(f"{output}: {', '.join(FILES)}")


def write_hand_fit(
    folder: Path,
    measured: Measurement,
    fit: HandFit,
    seed: int,
    device: cl.Device,
    origin: dict[str, Any],
) -> None:
    """Write all files of a fit into `folder`; the hand before and after is simulated for them."""
    from calibration.hand_fit.figure import hand_fit_figure
    from calibration.registration.radar import Radar
    from clradar.hand import write_pose
    from clradar.plot import save_figure

    used = Radar.of("fit_hand", measured.radar.get("array"), measured.radar.get("waveform"))

    def imaged(scene: cl.Scene) -> tuple[cl.Capture, cl.Volume]:
        with progress_bar("simulating") as progress:
            capture = cl.simulate(
                scene, used.array, used.waveform, seed=seed, device=device, progress=progress
            )
        grid = measured.volume.grid
        return capture, cl.backproject(capture, grid, check_grid=False, device=device)

    before, (capture, after) = imaged(fit.started)[1], imaged(fit.scene)
    name, source = f"{fit.pose.name}, fitted to {measured.path.name}", str(measured.path)
    write_pose(folder / POSE, replace(fit.pose, name=name, description="", source=source))
    write_json(folder / HAND_FIT, {**fit.to_dict(), **origin}, force=False)
    with progress_bar("drawing"):
        save_figure(hand_fit_figure(measured.volume, fit), folder / OVERLAY)
    labels = [f"Before: '{fit.start}', moved", "After"]
    if (surface := comparison.simulated_surface(after.meta)) is not None:
        labels[1] += f", {surface}"
    with warnings.catch_warnings():
        # That the start is another pose is no news; the table has what differs.
        warnings.simplefilter("ignore", ClradarWarning)
        compared = comparison.Comparison.of([measured.volume, before, after], labels)
    metrics = dict(zip(("before", "after"), (m.to_dict() for m in compared.metrics), strict=True))
    simulated = (fit.scene, capture, after)
    comparison.write_simulation(folder, measured.path, simulated, compared, metrics, origin)


DIGIT_COLUMNS = (
    "digit", "tip x, y, z (mm)", "sd (mm)", "tip determined", "angles determined", "as in the start"
)  # fmt: skip
BASIN_COLUMNS = ("pose", "start", "hand", "deviance", "tips apart (mm)")


def print_hand_fit(fit: HandFit) -> None:
    """Print tips, determined angles and basins as tables, and what remains of the report."""
    print_table(DIGIT_COLUMNS, digit_rows(fit), right=DIGIT_COLUMNS[1:3])
    if len(fit.basins) > 1:
        # One row for each pose in which the fit came to rest, with the tips' largest distance.
        basins = [
            [
                str(number), basin.start, basin.handedness, f"{basin.deviance:.1f}",
                f"{1e3 * fit.tips_apart_m(basin).max():.0f}",
            ]
            for number, basin in enumerate(fit.basins, start=1)
        ]  # fmt: skip
        print_table(BASIN_COLUMNS, basins, right=BASIN_COLUMNS[3:])
    print_line(fit.summary())
    if fit.remarks():
        print_line(f"Doubtful: see the {counted(len(fit.remarks()), 'warning')} above.")


def digit_rows(fit: HandFit) -> list[list[str]]:
    """One row for each digit, and one for the arch of the palm."""
    from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    rows = []
    for digit, angles in ANGLES_OF_DIGIT.items():
        names, where = ANGLE_NAMES[angles], ["", "", ""]
        unsure = [n.removeprefix(f"{digit}-finger-").removeprefix(f"{digit}-")
                  for n in names if n in fit.untold]  # fmt: skip
        if digit in DIGITS:
            number = DIGITS.index(digit)
            at_m, std_m = fit.tips_m[number], fit.tip_std_m[number]
            if np.isfinite(at_m).all():
                place = ", ".join(f"{1e3 * v:.1f}" for v in at_m)
                where = [place, f"{1e3 * std_m:.1f}", "yes" if fit.told_tips[number] else "no"]
        determined = f"{np.count_nonzero(fit.told_angles[angles])} of {len(names)}"
        rows.append([digit, *where, determined, ", ".join(unsure)])
    return rows
