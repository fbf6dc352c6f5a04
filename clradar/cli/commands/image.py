"""``clradar image``: form the image of a capture."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Literal

from clradar.cli.console import print_line, print_warning
from clradar.cli.inputs import form_image
from clradar.cli.options.common import (
    CaptureArgument,
    DeviceOption,
    ForceOption,
)
from clradar.cli.options.groups import REQUIRED, option, output_option, recorded
from clradar.cli.options.imaging import DepthMapOptions, GridOptions, ImagingOptions, grid_text
from clradar.cli.options.recording import FrameOptions
from clradar.cli.outputs import check_figure, check_outputs, save
from clradar.cli.provenance import provenance


def command(
    capture: CaptureArgument,
    *,
    output: Path = output_option(REQUIRED, "Volume to write (HDF5)."),
    png: Path | None = option(None, "Also draw amplitude and depth: .png, .pdf or .svg."),
    view: Literal["xy", "xz", "yz"] | None = option(
        None, "Axes of the picture. [default: xy, or across the axis that is thin]"
    ),
    voxels: GridOptions,
    imaging: ImagingOptions,
    tolerance_db: float | None = option(
        None, "Error of fast, RMS over the image's RMS, -80 to -30. [default: -50]", metavar="DB"
    ),
    depth: DepthMapOptions,
    frames: FrameOptions,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Without options the grid is that of the paper: 201 x 201 x 81 voxels of 1 mm."""
    from clradar import open_device
    from clradar.plot import image_figure, save_figure

    grid = voxels.grid()
    check_figure(png)
    check_outputs([output, png], force=force, inputs=[capture])
    loaded, files = frames.open(capture)
    opened = open_device(device)
    start_s = perf_counter()
    volume = form_image(loaded, grid, imaging, opened, "imaging", tolerance_db)
    took_s = perf_counter() - start_s
    options = recorded(imaging, frames, grid=grid_text(grid))
    origin = provenance("image", options, files)
    save(output, volume, origin, force=force)
    print_line(f"{output}: {grid_text(grid)}, {took_s:.1f} s on {opened.info.label}")
    if png is not None and not volume.data.any():
        print_warning(f"{png}: not drawn, since the image is zero everywhere")
    elif png is not None and volume.data.size == 1:
        amplitude = abs(volume.data.item())
        print_warning(
            f"{png}: not drawn, since the image is one voxel, of amplitude {amplitude:.4g}"
        )
    elif png is not None:
        figure = image_figure(
            volume, capture.name, dynamic_range_db=depth.dynamic_range_db, view=view
        )
        save_figure(figure, png, force=force)
        print_line(f"{png}: amplitude and depth, {depth.dynamic_range_db:g} dB")
