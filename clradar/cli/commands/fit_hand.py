"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line, progress_bar
from clradar.cli.hand_fit_folder import FIGURE, FILES, FittedImages, print_fit, write_fit
from clradar.cli.hand_sequence import FIGURE as MOVEMENT
from clradar.cli.hand_sequences import fit_sequences
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.opening import open_written
from clradar.cli.options.common import DevicesOption, ForceOption, OpenOption
from clradar.cli.options.groups import REQUIRED, argument, given, output_option, recorded
from clradar.cli.options.hand import ShapeOptions
from clradar.cli.options.hand_fit import HandFitOptions, fit_settings, sequence_settings
from clradar.cli.options.imaging import GridOptions, ImagingOptions, grid_text
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.rig import RigFileOptions
from clradar.cli.options.sequence import SequenceOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_folder, whole_folder
from clradar.cli.provenance import provenance


def command(
    *,
    measured: list[Path] = argument(
        REQUIRED,
        "Volume, capture or recording; several recordings with --frames.",
        metavar="MEASURED...",
    ),
    output: Path = output_option(REQUIRED, "New folder.", metavar="DIR"),
    fitting: HandFitOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frame: FrameOptions,
    sequence: SequenceOptions,
    radar: RadarOptions,
    device: DevicesOption = None,
    force: ForceOption = False,
    show: OpenOption = False,
) -> None:
    """Joint angles within their limits, place, alpha, and with --fit-shape the hand's size, so that
    the hand looks like MEASURED. No mesh is needed. DIR gets pose.toml (for `clradar hand` and data
    sets), placed.ply (for `clradar simulate`), fit.json with what the measurement tells and what
    not, the hand's simulation (capture.h5, volume.h5), two pictures and the metrics: all or
    nothing. Captures are imaged first, on the grid of the options. See docs/hand-fit.md.

    With --frames each frame of a recording is fitted from the one before, without simulations; DIR
    gets frames/, a table and figures over time, and resumes. Of several recordings each gets a
    folder in DIR. See docs/hand-movement.md.
    """
    from calibration import fit_hand
    from clradar.opencl import open_devices

    read = [*fitting.files, *rigged.files, *radar.files]
    if sequence.of_frames(measured):
        if given(radar):
            raise wrong_usage(", ".join(given(radar)), "a recording has its antennas")
        made_by = recorded(fitting, shape, rigged, imaging, frame, voxels)
        folders = fit_sequences(
            sequence, measured, output, frame, voxels, imaging,
            settings=sequence_settings(fitting, shape, rigged),
            origin=provenance("fit-hand", made_by, read), device=device, force=force,
        )  # fmt: skip
        open_written(show, folders[0] / MOVEMENT)
        return
    source = measured[0]
    check_folder(output, force=force, replaced=FILES, inputs=[source, *read])
    settings = fit_settings(fitting, shape, rigged)
    voxels.grid()  # wrong usage is reported before a file is read
    image = ImageInput.open(source, frame)
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
        measured=source,
        grid=grid_text(volume.grid),
    )
    origin = provenance("fit-hand", options, [*image.files, *read])
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_fit(made, images, str(source), origin)
    print_fit(fit)
    print_line(f"{output}: {', '.join(FILES)}")
    open_written(show, output / FIGURE)
