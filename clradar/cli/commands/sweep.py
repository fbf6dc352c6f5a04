"""``sweep``: the alpha, or the roughness, whose simulations are most like a measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

import calibration
import clradar as cl
from clradar.cli import console, images as img, options as opt, outputs as out, parse
from clradar.compare.images import depth_map_of
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import CompareError, warn
from clradar.jobs import KEY, FolderStore, open_devices
from clradar.model import checks
from clradar.versions import package_versions


def _lengths_mm(noun: str, bounds_m: tuple[float, float]) -> Any:
    return parse.ascending(noun, (1e3 * bounds_m[0], 1e3 * bounds_m[1]))


@dataclass(frozen=True, kw_only=True)
class SweptOptions:
    """Alphas, or in their place roughness and correlation lengths; and the seeds."""

    alpha: tuple[float, ...] = opt.option(
        f"{parse.RANGE_RULE}, or a list with commas; in [0, 1].",
        "0:1:0.1",
        metavar="RANGE",
        without="--roughness-mm",
        parse=parse.ascending("alphas", (0.0, 1.0), least=2),
    )
    seeds: int = opt.option(
        "Simulations per alpha, each its own seed.",
        3,
        check=partial(checks.whole, low=1),
    )
    seed: int = opt.option("The first seed.", 0)
    roughness_mm: tuple[float, ...] | None = opt.option(
        "In place of --alpha: RMS heights of the surface, at least three; heights times lengths "
        "times --seeds are 30 or more; as --alpha. Try 0.1:0.6:0.1.",
        metavar="RANGE",
        parse=_lengths_mm("heights", PLAUSIBLE_ROUGHNESS_M),
    )
    correlation_mm: tuple[float, ...] = opt.option(
        "Correlation lengths, as above; a single one is taken for known.",
        "1.5,3,6",
        metavar="RANGE",
        needs="--roughness-mm",
        parse=_lengths_mm("lengths", PLAUSIBLE_CORRELATION_M),
    )
    calibrated: bool = opt.option(
        "MEASURED is in S-parameters, and its level counts.", False, needs="--roughness-mm"
    )

    def sweep(
        self, measured: img.Measurement, scene: cl.Scene, images: Mapping[str, Any], **how: Any
    ) -> calibration.Sweep | calibration.RoughnessSweep:
        """Sweep over alpha by `images`, or over roughness, for which whole ones are not formed."""
        if self.roughness_mm is None:
            window = images["window"]
            own = measured.content.meta.get("window", window)
            if own != window and isinstance(measured.content, cl.Volume):
                warn(
                    f"{measured.path}: was formed with the window '{own}'; simulations are with "
                    f"'{window}' (--window)"
                )
            return calibration.sweep(
                measured.volume, scene, np.array(self.alpha), **measured.radar, **images, **how
            )
        if isinstance(measured.content, cl.Volume):
            raise CompareError(
                f"{measured.path}: expected a capture with --roughness-mm, got a volume: roughness "
                "is estimated from images by parts of the aperture"
            )
        lengths_m = (np.array(mm) / 1e3 for mm in (self.roughness_mm, self.correlation_mm))
        return calibration.sweep_roughness(
            measured.content, scene, *lengths_m, calibrated=self.calibrated, **how
        )


RESULT, TABLE, REGION_TABLE, FIGURE = "sweep.json", "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
OWN_NAMES = (KEY, RESULT, TABLE, REGION_TABLE, FIGURE, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""


def sweep_command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file."),
    output: Path = opt.output_option("New folder, or one to resume.", metavar="DIR", folder=True),
    swept: SweptOptions,
    made_of: opt.MaterialOptions,
    regions: Literal["parts", "fingers"] | None = opt.option(
        "Find an alpha for each named part, or for fingers and palm."
    ),
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

    out.check_folder(output, OWN_NAMES, resumed=True)
    estimator = None if swept.roughness_mm is None else opt.PHYSICAL
    settings = simulation.settings(seed=swept.seed, estimator=estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit, transform=place.matrix()))
    labels = None
    if regions is not None:
        if settings.max_bounces > 1:
            text = "expected 1 with --regions: a path of two bounces belongs to no single region"
            raise opt.wrong_usage("--max-bounces", text)
        kind = calibration.Regions
        labels = kind.of_parts(scene) if regions == "parts" else kind.of_fingers(scene)
    found = img.Measurement(measured, frames, radar, voxels, imaging, devices.first)
    images = {**imaging.arguments, "dynamic_range_db": depth.dynamic_range_db}
    # What cannot be compared replaces no earlier sweep.
    depth_map_of(found.volume, depth.dynamic_range_db, str(measured))
    check_within_grid(scene, found.volume.grid)
    grid = opt.grid_text(found.volume.grid)
    job = out.begun(
        output, "sweep", OWN_NAMES, f"{WORK}/*.npz", grid=grid, frame=None, variant=None,
        regions=None if labels is None else list(labels.names),
        device=devices.first.describe(), packages=package_versions(),
    )  # fmt: skip
    how: dict[str, Any] = {
        "seeds": swept.seeds, "regions": labels, "settings": settings, "device": devices,
    }  # fmt: skip
    with job.held():
        if finished := all((output / name).is_file() for name in RESULTS):
            console.line(f"{output}: finished before with these settings; nothing to do")
        else:
            how["store"] = store = FolderStore(output / WORK)
            if len(store):
                console.line(f"{output}: resumes with {len(store)} images that are done")
            with console.bar("sweeping") as how["progress"]:
                result = swept.sweep(found, scene, images, **how)
            out.write(output / FIGURE, partial(figure_of, result), force=True)
            for name, table in zip((TABLE, REGION_TABLE), result.tables(), strict=False):
                img.write_csv(output / name, *table)
            record = {"measured": str(measured), **result.to_dict()}
            out.write(output / RESULT, record, force=True, grid=grid)
        job.clear([WORK])
    if not finished:
        console.text(result.report())
        console.line(f"{output}: {', '.join(RESULTS)}")
