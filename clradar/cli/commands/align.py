"""``clradar align``: find the motion of an image or a mesh onto a measured image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli.console import print_line, print_text, progress_bar
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.common import DEVICE, FORCE, MEASURED, SearchOptions, UnitOptions
from clradar.cli.options.groups import argument, given, option, output_option, wrong_usage
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.outputs import check_outputs, provenance
from clradar.files.json_file import write_json


@dataclass(frozen=True, kw_only=True)
class AlignedOptions(UnitOptions, SearchOptions):
    """The image or the mesh to align with the measurement, and the search for its pose."""

    simulated: Path | None = argument(
        None, "Volume or capture; not with --mesh.", metavar="[SIMULATED]"
    )
    mesh: Path | None = option(None, "Align this mesh instead of an image.", metavar="MESH")
    quick: bool = option(
        False,
        "Without the simulations that correct the bias of a mesh: up to some millimetres "
        "off where it is specular.",
        needs="--mesh",
    )
    dynamic_range_db: float | None = option(
        None,
        "Depth points are this far below the maximum at most. [default: 15; mesh: 20]",
        metavar="DB",
    )

    def path(self) -> Path:
        """The file of the image or of the mesh."""
        path = self.mesh if self.simulated is None else self.simulated
        if path is None or (self.simulated is not None and self.mesh is not None):
            raise wrong_usage("SIMULATED, --mesh", "expected one of the two")
        return path

    def settings(self) -> dict[str, Any]:
        """Settings of both `calibration.align` and `calibration.align_mesh`."""
        from clradar.model import checks

        found = {"search_deg": checks.positive("--search-deg", self.search_deg)}
        if self.dynamic_range_db is not None:
            cut_db = checks.positive("--dynamic-range-db", self.dynamic_range_db)
            found["dynamic_range_db"] = cut_db
        return found


def command(
    *,
    measured: Path = MEASURED,
    output: Path | None = output_option(None, "JSON file for transform and report.  [required]"),
    aligned: AlignedOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frames: FrameOptions,
    radar: RadarOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """The 4 x 4 matrix in the JSON file, "transform", moves the simulated object, or the mesh, onto
    the measured one: `clradar simulate --transform` takes the file. Captures are imaged first, on
    the grid of the options. --frame and --variant are those of MEASURED. Mesh against measurement
    is the more exact of the two: see docs/calibration.md.
    """
    from calibration import align, align_mesh

    if output is None:
        raise wrong_usage("-o", "expected a JSON file to write")
    path, settings = aligned.path(), aligned.settings()
    if given(radar) and aligned.mesh is None:
        raise wrong_usage(", ".join(given(radar)), "expected --mesh with it, which is simulated")
    check_outputs([output], force=force, inputs=[measured, path, *radar.files])
    voxels.grid()  # wrong usage is reported before a file is read
    # A mesh that cannot be read should not cost an image first.
    scene = None if aligned.mesh is None else cl.Scene.from_mesh(path, unit=aligned.unit)
    opened = cl.open_device(device)
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
            bias = not aligned.quick
            result = align_mesh(
                volumes[0], scene, correct_bias=bias, device=opened, progress=progress,
                **settings, **instrument,
            )  # fmt: skip
    origin = provenance(
        "align", [*images[0].files, path, *radar.files], aligned, imaging, frames, radar,
        measured=measured, grid=grid_text(volumes[0].grid),
    )  # fmt: skip
    write_json(output, {**result.to_dict(), **origin}, force=force)
    print_text(result.report())
    print_line(f"{output}: the transform, its covariance and this report")
