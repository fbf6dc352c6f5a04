"""``clradar align``: find the motion of an image or a mesh onto a measured image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import print_text, progress_bar
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.outputs import write
from clradar.jobs import open_devices
from clradar.model import checks


def command(
    *,
    measured: Path = opt.MEASURED,
    output: Path = opt.output_option("JSON file for transform and report."),
    simulated: Path | None = opt.argument("Volume or capture; not with --mesh.", without="--mesh"),
    mesh: Path | None = opt.option("Align this mesh instead of an image.", metavar="MESH"),
    unit: opt.UnitOptions,
    search: opt.SearchOptions,
    quick: bool = opt.option(
        "Without the simulations that correct the bias of a mesh: up to some millimetres "
        "off where it is specular.",
        False,
        needs="--mesh",
    ),
    dynamic_range_db: float | None = opt.option(
        "Depth points are this far below the maximum at most. [default: 15; mesh: 20]",
        check=checks.positive,
    ),
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    frames: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """The 4 x 4 matrix in the JSON file, "transform", moves image or mesh onto MEASURED, as
    `clradar simulate --transform` does. --frame and --variant are those of MEASURED. A mesh is more
    exact than an image: docs/calibration.md.
    """
    from calibration import align, align_mesh

    path = mesh or simulated
    if path is None:
        raise opt.wrong_usage("SIMULATED, --mesh", "expected one of the two")
    if opt.given(radar) and mesh is None:
        names = ", ".join(opt.given(radar))
        raise opt.wrong_usage(names, "expected --mesh with it, which is simulated")
    settings: dict[str, Any] = {"search_deg": search.search_deg}
    if dynamic_range_db is not None:
        settings["dynamic_range_db"] = dynamic_range_db
    scene = None if mesh is None else cl.Scene.from_mesh(mesh, unit=unit.unit)
    opened = open_devices(device).first
    images = [ImageInput.open(measured, frames)]
    instrument = {} if scene is None else images[0].radar_or(radar)
    if scene is None:
        images.append(ImageInput.open(path))
    grid = common_grid(voxels, *images, device=opened)
    volumes = [image.volume(grid, imaging, opened) for image in images]
    with progress_bar("aligning") as progress:
        if scene is None:
            result = align(*volumes, progress=progress, **settings)
        else:
            result = align_mesh(
                volumes[0], scene, correct_bias=not quick, device=opened, progress=progress,
                **settings, **instrument,
            )  # fmt: skip
    print_text(result.report())
    text = "the transform, its covariance and this report"
    write(output, result.to_dict(), text, grid=opt.grid_text(volumes[0].grid))
