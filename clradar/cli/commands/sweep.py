"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path

from clradar.cli.console import print_line
from clradar.cli.options.common import DEVICES, FORCE, MEASURED
from clradar.cli.options.groups import REQUIRED, argument, output_option, recorded
from clradar.cli.options.measured import (
    DepthMapOptions,
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
)
from clradar.cli.options.scene import MaterialOptions, SimulationOptions
from clradar.cli.options.sweep import AlphaOptions, PlaceOptions, RegionOptions, check_together
from clradar.cli.outputs import check_place_of_folder, package_versions, provenance
from clradar.cli.sweeps import RoughnessOptions, SweepInputs, over_alpha, over_roughness


def command(
    *,
    measured: Path = MEASURED,
    mesh: Path = argument(REQUIRED, "Mesh file.", metavar="MESH"),
    output: Path = output_option(REQUIRED, "New folder, or one to resume.", metavar="DIR"),
    alphas: AlphaOptions,
    roughness: RoughnessOptions,
    made_of: MaterialOptions,
    regions: RegionOptions,
    place: PlaceOptions,
    simulation: SimulationOptions,
    radar: RadarOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    depth: DepthMapOptions,
    frames: FrameOptions,
    device: str | None = DEVICES,
    force: bool = FORCE,
) -> None:
    """Simulates MESH at every alpha with several seeds and compares each image with MEASURED. DIR
    gets sweep.png, sweep.csv, sweep.json, the settings, and with --align the transform. The same
    command resumes where a killed one stopped; other settings in the same DIR are refused, unless
    --force begins anew. Frequencies are those of MEASURED, where it is a capture. The result
    and its uncertainty: docs/sweep.md.

    With --roughness-mm it estimates roughness and correlation length in millimetres, of a MESH
    of given --material, by the physical estimator.
    """
    from calibration.roughness.sweep import check_within_grid
    from clradar.cli import sweeps
    from clradar.compare import depth_map_of
    from clradar.jobs import open_devices

    read = [measured, mesh, *place.files, *regions.files, *made_of.material_files]
    check_place_of_folder(output, replaced=sweeps.OWN_NAMES, inputs=read)
    kind = over_roughness(roughness) if roughness.given else over_alpha(alphas, imaging, depth)
    check_together(alphas, roughness, made_of)
    alphas.check()
    regions.check(simulation.max_bounces)
    settings = simulation.settings(seed=alphas.seed, estimator=kind.estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    opened = devices.first
    inputs = SweepInputs(
        place, mesh, made_of, regions, measured, frames, radar, voxels, imaging, opened
    )
    kind.check_measured(measured, inputs.image.content)
    record = recorded(
        imaging,
        **inputs.record(),
        **kind.record,
        seeds=alphas.seeds,
        simulation=asdict(settings.resolved()),
        dynamic_range_db=depth.dynamic_range_db,
        device=dict(opened.describe()),
        packages=package_versions(),
    )
    image = inputs.image
    origin = provenance("sweep", record, inputs.files)
    volume = image.volume(inputs.grid, imaging, opened)
    # A sweep that is impossible should leave no folder behind.
    depth_map_of(volume, depth.dynamic_range_db, str(measured))
    if inputs.align is None:
        check_within_grid(inputs.placed, volume.grid)
    run = partial(
        kind.run, inputs.radar, image.content, volume, seeds=alphas.seeds, regions=inputs.labels,
        settings=settings, device=devices,
    )  # fmt: skip
    result = sweeps.sweep_into(
        output, volume, inputs.placed, run, kind.write,
        source=str(measured), origin=origin, force=force, device=opened,
        align=None if inputs.align is None else {**inputs.align, **image.radar},
    )  # fmt: skip
    if result is None:
        print_line(f"{output}: finished before with these settings; nothing to do")
    else:
        kind.show(result)
        print_line(f"{output}: {', '.join(sweeps.RESULTS)}")
