"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.comparison import write_csv
from clradar.cli.console import print_line, progress_bar
from clradar.cli.inputs import measurement
from clradar.cli.outputs import begun, check_folder, write
from clradar.cli.tables import print_sweep
from clradar.jobs import KEY, FolderStore, open_devices
from clradar.versions import package_versions

RESULT, TABLE, REGION_TABLE, FIGURE = "sweep.json", "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
OWN_NAMES = (KEY, RESULT, TABLE, REGION_TABLE, FIGURE, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""


def command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file."),
    output: Path = opt.output_option("New folder, or one to resume.", metavar="DIR", folder=True),
    alphas: opt.AlphaOptions,
    roughness: opt.RoughnessOptions,
    made_of: opt.MaterialOptions,
    regions: opt.RegionOptions,
    place: opt.PlacementOptions,
    simulation: opt.SimulationOptions,
    radar: opt.RadarOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Simulates MESH, where --transform has it, at every alpha with several seeds, and compares
    each image with MEASURED. DIR gets a figure, tables and the settings. The same command resumes
    where a killed one stopped; other settings are refused, unless --force begins anew. See
    docs/sweep.md.

    With --roughness-mm it estimates roughness and correlation length in millimetres, of a MESH of
    given --material.
    """
    from calibration.roughness.figures import figure_of
    from calibration.roughness.sweep import check_within_grid
    from clradar.compare import depth_map_of

    check_folder(output, OWN_NAMES, resumed=True)
    kind = alphas if roughness.roughness_mm is None else roughness
    settings = simulation.settings(seed=alphas.seed, estimator=kind.estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit, transform=place.matrix()))
    labels = regions.read(scene, settings.max_bounces)
    found = measurement(measured, frames, radar, voxels, imaging, devices.first)
    images = {**imaging.arguments, "dynamic_range_db": depth.dynamic_range_db}
    # What cannot be compared replaces no earlier sweep.
    depth_map_of(found.volume, depth.dynamic_range_db, str(measured))
    check_within_grid(scene, found.volume.grid)
    grid = opt.grid_text(found.volume.grid)
    job = begun(
        output, "sweep", OWN_NAMES, f"{WORK}/*.npz", grid=grid, frame=None, variant=None,
        regions=None if labels is None else list(labels.names),
        device=devices.first.describe(), packages=package_versions(),
    )  # fmt: skip
    how: dict[str, Any] = {
        "seeds": alphas.seeds, "regions": labels, "settings": settings, "device": devices,
    }  # fmt: skip
    with job.held():
        if finished := all((output / name).is_file() for name in RESULTS):
            print_line(f"{output}: finished before with these settings; nothing to do")
        else:
            how["store"] = store = FolderStore(output / WORK)
            if len(store):
                print_line(f"{output}: resumes with {len(store)} images that are done")
            with progress_bar("sweeping") as how["progress"]:
                result = kind.sweep(found, scene, images, **how)
            write(output / FIGURE, partial(figure_of, result), force=True)
            for name, table in zip((TABLE, REGION_TABLE), result.tables(), strict=False):
                write_csv(output / name, *table)
            record = {"measured": str(measured), **result.to_dict()}
            write(output / RESULT, record, force=True, grid=grid)
        job.clear([WORK])
    if not finished:
        print_sweep(result)
        print_line(f"{output}: {', '.join(RESULTS)}")
