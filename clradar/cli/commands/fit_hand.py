"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line, progress_bar
from clradar.cli.fits import HAND_FILES, print_hand_fit, write_hand_fit
from clradar.cli.inputs import measurement
from clradar.cli.options.common import DEVICE, FORCE, MEASURED
from clradar.cli.options.groups import REQUIRED, output_option
from clradar.cli.options.hand import HandFitOptions, RigFileOptions, ShapeOptions, StartNames
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.outputs import check_folder, provenance, whole_folder


def command(
    *,
    measured: Path = MEASURED,
    output: Path = output_option("New folder.", REQUIRED, metavar="DIR"),
    fitting: HandFitOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frame: FrameOptions,
    radar: RadarOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Joint angles within their limits, place, alpha, and with --fit-shape the hand's size, so that
    the hand looks like MEASURED. No mesh is needed. DIR gets pose.toml (for `clradar hand` and data
    sets), placed.ply (for `clradar simulate`), fit.json with what the measurement tells and what
    not, the hand's simulation (capture.h5, volume.h5), two pictures and the metrics: all or
    nothing. Captures are imaged first, on the grid of the options. See docs/hand-fit.md.
    """
    from calibration import fit_hand
    from clradar.jobs import open_devices

    read = [*StartNames(fitting.pose).files, *rigged.files]
    check_folder(output, force=force, replaced=HAND_FILES, inputs=[measured, *read, *radar.files])
    settings = fitting.fit_settings(shape, rigged)
    opened = open_devices(device).first
    found = measurement(measured, frame, radar, voxels, imaging, opened)
    with progress_bar("fitting") as progress:
        fit = fit_hand(found.volume, device=opened, progress=progress, **settings, **found.radar)
    origin = provenance(
        "fit-hand", [*found.files, *read], fitting, shape, rigged, imaging, frame, radar,
        measured=measured, grid=grid_text(found.volume.grid),
    )  # fmt: skip
    with whole_folder(output, force=force, replaced=HAND_FILES) as made:
        write_hand_fit(made, found, fit, fitting.seed, opened, origin)
    print_hand_fit(fit)
    print_line(f"{output}: {', '.join(HAND_FILES)}")
