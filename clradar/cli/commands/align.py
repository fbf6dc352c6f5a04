"""``clradar align``: find the motion of an image or a mesh onto a measured image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli.console import print_line, print_text, progress_bar
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.common import DEVICE, FORCE, MEASURED, SearchOptions, UnitOptions
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, wrong_usage
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.outputs import check_outputs, provenance
from clradar.files.json_file import write_json
from clradar.jobs import open_devices
from clradar.model import checks


@dataclass(frozen=True, kw_only=True)
class AlignedOptions(UnitOptions, SearchOptions):
    """The image or the mesh to align with the measurement, and the search for its pose."""

    simulated: Path | None = argument("Volume or capture; not with --mesh.", metavar="[SIMULATED]")
    mesh: Path | None = option("Align this mesh instead of an image.", metavar="MESH")
    quick: bool = option(
        "Without the simulations that correct the bias of a mesh: up to some millimetres "
        "off where it is specular.",
        False,
        needs="--mesh",
    )
    dynamic_range_db: float | None = option(
        "Depth points are this far below the maximum at most. [default: 15; mesh: 20]"
    )

    def path(self) -> Path:
        """The file of the image or of the mesh."""
        path = self.mesh if self.simulated is None else self.simulated
        if path is None or (self.simulated is not None and self.mesh is not None):
            raise wrong_usage("SIMULATED, --mesh", "expected one of the two")
        return path

    def settings(self) -> dict[str, Any]:
        """Settings of both `calibration.align` and `calibration.align_mesh`."""
        cut = {} if self.dynamic_range_db is None else {"dynamic_range_db": self.dynamic_range_db}
        known = {"search_deg": self.search_deg, **cut}
        return {n: checks.positive("--" + n.replace("_", "-"), v) for n, v in known.items()}


def command(
    *,
    measured: Path = MEASURED,
    output: Path = output_option("JSON file for transform and report.", REQUIRED),
    aligned: AlignedOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frames: FrameOptions,
    radar: RadarOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """The 4 x 4 matrix in the JSON file, "transform", moves the simulated object, or the mesh, onto
    the measured one, as `clradar simulate --transform` does. Captures are imaged first. --frame and
    --variant are those of MEASURED. A mesh is more exact than an image: docs/calibration.md.
    """
    from calibration import align, align_mesh

    path, settings = aligned.path(), aligned.settings()
    if given(radar) and aligned.mesh is None:
        raise wrong_usage(", ".join(given(radar)), "expected --mesh with it, which is simulated")
    check_outputs([output], force=force, inputs=[measured, path, *radar.files])
    voxels.grid()  # wrong usage is reported before a file is read
    scene = None if aligned.mesh is None else cl.Scene.from_mesh(path, unit=aligned.unit)
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
            more = {"correct_bias": not aligned.quick, "device": opened, **settings, **instrument}
            result = align_mesh(volumes[0], scene, progress=progress, **more)
    origin = provenance(
        "align", [*images[0].files, path, *radar.files], aligned, imaging, frames, radar,
        measured=measured, grid=grid_text(volumes[0].grid),
    )  # fmt: skip
    write_json(output, {**result.to_dict(), **origin}, force=force)
    print_text(result.report())
    print_line(f"{output}: the transform, its covariance and this report")
