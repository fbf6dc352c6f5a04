"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import clradar as cl
from clradar.cli.inputs import measurement
from clradar.cli.options.common import DEVICE, FORCE, MEASURED
from clradar.cli.options.groups import REQUIRED, argument, output_option, recorded, wrong_usage
from clradar.cli.options.measured import (
    DepthMapOptions,
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.options.scene import MaterialOptions, PlacementOptions, SimulationOptions
from clradar.cli.options.sweep import AlphaOptions, RegionOptions, RoughnessOptions
from clradar.cli.outputs import check_place_of_folder, package_versions, provenance
from clradar.cli.sweeps import (
    OWN_NAMES,
    check_window,
    digest,
    over_alpha,
    over_roughness,
    sweep_into,
)
from clradar.files.hashing import sha256_of_arrays
from clradar.jobs import open_devices


def command(
    *,
    measured: Path = MEASURED,
    mesh: Path = argument("Mesh file.", REQUIRED, metavar="MESH"),
    output: Path = output_option("New folder, or one to resume.", REQUIRED, metavar="DIR"),
    alphas: AlphaOptions,
    roughness: RoughnessOptions,
    made_of: MaterialOptions,
    regions: RegionOptions,
    place: PlacementOptions,
    simulation: SimulationOptions,
    radar: RadarOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    depth: DepthMapOptions,
    frames: FrameOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Simulates MESH at every alpha with several seeds and compares each image with MEASURED. DIR
    gets sweep.png, sweep.csv, sweep.json and the settings. MESH is where --transform has it, as
    `clradar align --mesh` finds it. The same command resumes where a killed one stopped; other
    settings in the same DIR are refused, unless --force begins anew. Frequencies are those of
    MEASURED, where it is a capture. See docs/sweep.md.

    With --roughness-mm it estimates roughness and correlation length in millimetres, of a MESH
    of given --material, by the physical estimator.
    """
    from calibration.roughness.sweep import check_within_grid
    from clradar.compare import depth_map_of

    read = [mesh, *place.files, *regions.files, *made_of.material_files]
    check_place_of_folder(output, replaced=OWN_NAMES, inputs=[measured, *read])
    if regions.regions is not None and simulation.max_bounces > 1:
        words = "expected 1 with --regions: a path of two bounces belongs to no single region"
        raise wrong_usage("--max-bounces", words)
    range_db = depth.dynamic_range_db
    kind = over_alpha(alphas, recorded(imaging), range_db)
    if roughness.roughness_mm is not None:
        kind = over_roughness(roughness)
    settings = simulation.settings(seed=alphas.seed, estimator=kind.estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit))
    labels, matrix = regions.read(scene, place.unit), place.matrix()
    found = measurement(measured, frames, radar, voxels, imaging, devices.first)
    check_window(found, imaging.window)
    band_hz = found.radar["waveform"].frequencies_hz
    origin = provenance(
        "sweep", [*found.files, *read], imaging, **kind.record,
        measured_sha256=digest(found.content), mesh_sha256=scene.digest(),
        regions=None if labels is None else list(labels.names),
        regions_sha256=None if labels is None else sha256_of_arrays(labels.face),
        transform=None if matrix is None else matrix.tolist(),
        frequencies_ghz=[float(band_hz[0] / 1e9), float(band_hz[-1] / 1e9), len(band_hz)],
        grid=grid_text(found.volume.grid), seeds=alphas.seeds,
        simulation=asdict(settings.resolved()), dynamic_range_db=range_db,
        device=dict(devices.first.describe()), packages=package_versions(),
    )  # fmt: skip
    depth_map_of(found.volume, range_db, str(measured))  # raises before a folder is made
    placed = scene if matrix is None else scene.transformed(matrix)
    check_within_grid(placed, found.volume.grid)
    sweep_into(
        output, kind, found, placed, origin, force=force, seeds=alphas.seeds, regions=labels,
        settings=settings, device=devices,
    )  # fmt: skip
