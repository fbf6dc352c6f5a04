"""``clradar image``."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated, Optional

import typer

from clradar.cli.images import form_image, recording_files, save_image
from clradar.cli.options import (
    DEFAULT_DYNAMIC_RANGE_DB,
    DeviceOption,
    DynamicRangeOption,
    ForceOption,
    FrameOption,
    Method,
    MethodOption,
    ToleranceOption,
    VariantOption,
    Window,
    WindowOption,
    XOption,
    YOption,
    ZOption,
    grid_text,
    voxel_grid,
)
from clradar.cli.output import check_outputs, print_line, print_warning


def command(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE", help="Native capture, recorded .npy frame, or radar folder."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Volume to write (HDF5).")],
    png: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--png", help="Also draw amplitude and depth: .png, .pdf or .svg."),
    ] = None,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    method: MethodOption = Method.fast,
    tolerance_db: ToleranceOption = None,
    window: WindowOption = Window.rect,
    dynamic_range_db: DynamicRangeOption = DEFAULT_DYNAMIC_RANGE_DB,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Without options the grid is that of the paper: 201 x 201 x 81 voxels of 1 mm."""
    from clradar import open_device
    from clradar.model import checks
    from clradar.plot import image_figure, save_figure
    from measurement_io import open_capture

    grid = voxel_grid(x_mm, y_mm, z_mm)
    checks.positive("--dynamic-range-db", dynamic_range_db)
    if png is not None:
        check_figure_name(png)
    check_outputs([output, png], force=force, inputs=[capture])
    loaded = open_capture(capture, frame=frame, variant=None if variant is None else variant.value)
    opened = open_device(device)
    start_s = perf_counter()
    volume = form_image(loaded, grid, method.value, window.value, opened, "imaging", tolerance_db)
    took_s = perf_counter() - start_s
    options = {
        "method": method.value,
        "window": window.value,
        "grid": grid_text(grid),
        "frame": frame,
        "variant": None if variant is None else variant.value,
    }
    inputs = recording_files(capture, loaded.meta)
    save_image(output, volume, "image", options, inputs, force=force)
    print_line(f"{output}: {grid_text(grid)}, {took_s:.1f} s on {opened.info.label}")
    if png is not None and not volume.data.any():
        print_warning(f"{png}: not drawn, since the image is zero everywhere")
    elif png is not None:
        figure = image_figure(volume, capture.name, dynamic_range_db=dynamic_range_db)
        save_figure(figure, png, force=force)
        print_line(f"{png}: amplitude and depth, {dynamic_range_db:g} dB")


def check_figure_name(path: Path) -> None:
    """Raise unless a figure can be written under this name."""
    from clradar.errors import OutputError
    from clradar.plot import SUFFIXES

    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(
            f"{path}: expected a name that ends in {', '.join(SUFFIXES)}, got '{path.suffix}'"
        )
