"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line, progress_bar
from clradar.cli.hand_fit_folder import FILES, FittedImages, print_fit, write_fit
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.common import DEVICES, FORCE, MEASURED
from clradar.cli.options.groups import REQUIRED, output_option, recorded
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
    output: Path = output_option(REQUIRED, "New folder.", metavar="DIR"),
    fitting: HandFitOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frame: FrameOptions,
    radar: RadarOptions,
    device: str | None = DEVICES,
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

    read = [*StartNames(fitting.pose).files, *rigged.files, *radar.files]
    check_folder(output, force=force, replaced=FILES, inputs=[measured, *read])
    settings = fitting.fit_settings(shape, rigged)
    voxels.grid()  # wrong usage is reported before a file is read
    image = ImageInput.open(measured, frame)
    instrument = image.radar_or(radar)
    opened = open_devices(device).first
    grid = common_grid(voxels, image, device=opened)
    volume = image.volume(grid, imaging, opened)
    with progress_bar("fitting") as progress:
        fit = fit_hand(volume, device=opened, progress=progress, **settings, **instrument)
    images = FittedImages.of(volume, fit, instrument, fitting.seed, opened)
    options = recorded(
        fitting,
        shape,
        rigged,
        imaging,
        frame,
        radar,
        measured=measured,
        grid=grid_text(volume.grid),
    )
    origin = provenance("fit-hand", options, [*image.files, *read])
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_fit(made, images, str(measured), origin)
    print_fit(fit)
    print_line(f"{output}: {', '.join(FILES)}")
