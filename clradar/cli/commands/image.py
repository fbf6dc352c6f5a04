"""``clradar image``."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from clradar.cli.console import print_line, print_warning
from clradar.cli.inputs import form_image, recording_files
from clradar.cli.options.common import (
    DEFAULT_DYNAMIC_RANGE_DB,
    CaptureArgument,
    DeviceOption,
    DynamicRangeOption,
    ForceOption,
)
from clradar.cli.options.groups import recorded
from clradar.cli.options.imaging import GridOptions, ImagingOptions, grid_text
from clradar.cli.options.recording import FrameOptions
from clradar.cli.outputs import check_figure, check_outputs, save
from clradar.cli.provenance import provenance


def command(
    capture: CaptureArgument,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="Volume to write (HDF5).")],
    png: Annotated[
        Path | None,
        typer.Option("--png", help="Also draw amplitude and depth: .png, .pdf or .svg."),
    ] = None,
    voxels: GridOptions,
    imaging: ImagingOptions,
    tolerance_db: Annotated[
        float | None,
        typer.Option(
            "--tolerance-db",
            metavar="DB",
            help="Error of fast, RMS over the image's RMS, -80 to -30. [default: -50]",
        ),
    ] = None,
    dynamic_range_db: DynamicRangeOption = DEFAULT_DYNAMIC_RANGE_DB,
    frames: FrameOptions,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Without options the grid is that of the paper: 201 x 201 x 81 voxels of 1 mm."""
    from clradar import open_device
    from clradar.model import checks
    from clradar.plot import image_figure, save_figure
    from measurement_io import open_capture

    grid = voxels.grid()
    checks.positive("--dynamic-range-db", dynamic_range_db)
    check_figure(png)
    check_outputs([output, png], force=force, inputs=[capture])
    loaded = open_capture(capture, **frames.chosen)
    opened = open_device(device)
    start_s = perf_counter()
    volume = form_image(loaded, grid, imaging, opened, "imaging", tolerance_db)
    took_s = perf_counter() - start_s
    options = recorded(imaging, frames, grid=grid_text(grid))
    origin = provenance("image", options, recording_files(capture, loaded.meta))
    save(output, volume, origin, force=force)
    print_line(f"{output}: {grid_text(grid)}, {took_s:.1f} s on {opened.info.label}")
    if png is not None and not volume.data.any():
        print_warning(f"{png}: not drawn, since the image is zero everywhere")
    elif png is not None:
        figure = image_figure(volume, capture.name, dynamic_range_db=dynamic_range_db)
        save_figure(figure, png, force=force)
        print_line(f"{png}: amplitude and depth, {dynamic_range_db:g} dB")
