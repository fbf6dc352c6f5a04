"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli import comparison, options as opt, parse, tables
from clradar.cli.console import print_line, progress_bar
from clradar.cli.inputs import Measurement, measurement
from clradar.cli.outputs import check_folder, whole_folder, write
from clradar.errors import ClradarWarning
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from calibration import HandFit

POSE, HAND_FIT, OVERLAY = "pose.toml", "fit.json", "overlay.png"
FILES = (POSE, HAND_FIT, OVERLAY, *comparison.SIMULATION_FILES)


def command(
    *,
    measured: Path = opt.MEASURED,
    output: Path = opt.output_option("New folder.", metavar="DIR", folder=True),
    fitting: opt.HandFitOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    frame: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Finds joint angles, place and alpha; no mesh is needed. DIR gets pose.toml (for `clradar
    hand` and data sets), placed.ply, fit.json with what the measurement tells and what not, the
    hand's simulation, two pictures and the metrics: all or nothing. See docs/hand-fit.md.
    """
    from calibration import fit_hand

    starts = opt.StartNames(fitting.pose)
    check_folder(output, FILES)
    alpha = None if fitting.alpha == parse.FIT else fitting.alpha
    settings = {**fitting.settings(starts), "alpha": alpha, "closed_loop": not fitting.quick}
    opened = open_devices(device).first
    found = measurement(measured, frame, radar, voxels, imaging, opened)
    with progress_bar("fitting") as progress:
        fit = fit_hand(found.volume, device=opened, progress=progress, **settings, **found.radar)
    with whole_folder(output, FILES) as made:
        write_hand_fit(made, found, fit, fitting.seed, opened)
    tables.print_hand_fit(fit)
    print_line(f"{output}: {', '.join(FILES)}")


def write_hand_fit(
    folder: Path, measured: Measurement, fit: HandFit, seed: int, device: cl.Device
) -> None:
    """Write all files of a fit into `folder`; the hand before and after is simulated for them."""
    from calibration.hand_fit.figure import hand_fit_figure
    from calibration.registration.radar import Radar
    from clradar.hand import write_pose

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
    more: dict[str, Any] = {"grid": opt.grid_text(measured.volume.grid)}
    write(folder / HAND_FIT, fit.to_dict(), **more)
    write(folder / OVERLAY, partial(hand_fit_figure, measured.volume, fit))
    labels = [f"Before: '{fit.start}', moved", "After"]
    if (surface := comparison.simulated_surface(after.meta)) is not None:
        labels[1] += f", {surface}"
    with warnings.catch_warnings():
        # That the start is another pose is no news; the table has what differs.
        warnings.simplefilter("ignore", ClradarWarning)
        compared = comparison.Comparison.of([measured.volume, before, after], labels)
    metrics = dict(zip(("before", "after"), (m.to_dict() for m in compared.metrics), strict=True))
    simulated = (fit.scene, capture, after)
    comparison.write_simulation(folder, measured.path, simulated, compared, metrics, **more)
