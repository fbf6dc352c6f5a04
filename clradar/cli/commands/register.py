"""``clradar register``: find the pose of a measured mesh, and simulate it there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import clradar as cl
from clradar.cli.console import print_line, print_text
from clradar.cli.fits import FILES, RegistrationOptions, registered, write_registration
from clradar.cli.inputs import measurement
from clradar.cli.options.common import DEVICE, FORCE, MEASURED
from clradar.cli.options.groups import REQUIRED, argument, output_option
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.options.scene import MaterialOptions
from clradar.cli.outputs import check_folder, provenance, whole_folder
from clradar.jobs import open_devices


def command(
    *,
    measured: Path = MEASURED,
    mesh: Path = argument("Mesh file, placed anywhere.", REQUIRED, metavar="MESH"),
    output: Path = output_option("New folder.", REQUIRED, metavar="DIR"),
    registration: RegistrationOptions,
    made_of: MaterialOptions,
    voxels: GridOptions,
    frames: FrameOptions,
    radar: RadarOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Writes into DIR the placed mesh, the transform (for `clradar simulate --transform`), the
    simulated capture and its volume, a figure and the metrics: all or nothing. Captures are imaged
    first, on the grid of the options. Done when a round moves the mesh by less than 0.1 mm.
    """
    registration = replace(registration, estimator=made_of.estimator(registration.estimator))
    alpha = registration.alpha_value()
    read = [mesh, *made_of.material_files]
    check_folder(output, force=force, replaced=FILES, inputs=[measured, *read, *radar.files])
    scene = cl.Scene.from_mesh(mesh, alpha=0.5 if alpha is None else alpha, unit=registration.unit)
    scene = made_of.on(scene)
    opened = open_devices(device).first
    found = measurement(measured, frames, radar, voxels, ImagingOptions(), opened)
    result = registered(found, scene, registration, opened)
    origin = provenance(
        "register", [*found.files, *read], registration, made_of, frames, radar,
        measured=measured, mesh=mesh, grid=grid_text(found.volume.grid),
    )  # fmt: skip
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_registration(made, found, result, origin)
    print_text(result.alignment.report())
    print_line(f"{output}: {', '.join(FILES)}")
