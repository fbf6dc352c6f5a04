"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.comparison import METRIC_COLUMNS
from clradar.cli.console import print_line, print_table, print_text, print_warning
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.opening import open_written
from clradar.cli.options.common import (
    DevicesOption,
    ForceOption,
    MeasuredArgument,
    OpenOption,
    SearchOptions,
)
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, recorded
from clradar.cli.options.imaging import DepthMapOptions, GridOptions, ImagingOptions, grid_text
from clradar.cli.options.materials import MaterialOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.simulation import PlacementOptions, SimulationOptions
from clradar.cli.options.values import RANGE_RULE, ascending, wrong_usage
from clradar.cli.outputs import check_place_of_folder
from clradar.cli.provenance import package_versions, provenance
from clradar.cli.roughness_sweep import RoughnessOptions, SweepKind, over_roughness
from clradar.compare import METRICS
from clradar.files.hashing import sha256_of_arrays

if TYPE_CHECKING:
    from calibration import Regions, Sweep
    from clradar import Capture, Device, Scene, Volume, VoxelGrid

ALPHA_RULE = f"{RANGE_RULE}, or a list with commas"
PARTS, FINGERS = "parts", "fingers"
ALPHAS = "0:1:0.1"


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alphas and the seeds to simulate with."""

    alpha: str | None = option(
        None, f"{ALPHA_RULE}; in [0, 1]. [default: {ALPHAS}]", metavar="RANGE"
    )
    seeds: int = option(3, "Simulations per alpha, each its own seed.", metavar="N")
    seed: int = option(0, "The first seed.", metavar="N")
    # The default of `calibration.sweep`, whose import would slow the help down.
    metric: str = option(
        "db_correlation", "Which metric the best alpha has; see docs/metrics.md.", metavar="NAME"
    )

    def check(self) -> None:
        """Raise unless there is such a metric, and a seed."""
        from clradar.model import checks

        if self.metric not in METRICS:
            known = ", ".join(METRICS)
            raise wrong_usage("--metric", f"expected one of {known}, got '{self.metric}'")
        checks.whole("--seeds", self.seeds, 1)


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Regions of the mesh that have an alpha each."""

    regions: str | None = option(
        None,
        "Find an alpha for each named part, for fingers and palm, or for the regions of a "
        "file: .npy or .json with a label per face, or .json with region: [parts].",
        metavar="parts|fingers|FILE",
    )
    joints: Path | None = option(
        None,
        "For --regions fingers: joint name: [x, y, z] in the unit of the mesh, as "
        "`clradar hand --joints` writes it. Not needed where palm and fingers are parts.",
        metavar="JOINTS.json",
    )

    def check(self, max_bounces: int) -> None:
        """Raise unless the options go together."""
        if self.joints is not None and self.regions != FINGERS:
            raise wrong_usage("--joints", "expected --regions fingers with it")
        if self.regions is not None and max_bounces > 1:
            raise wrong_usage(
                "--max-bounces",
                "expected 1 with --regions: a path of two bounces belongs to no single region",
            )

    @property
    def files(self) -> list[Path]:
        """Files of joints and regions."""
        named = self.regions not in (None, PARTS, FINGERS)
        return [
            *([] if self.joints is None else [self.joints]),
            *([Path(str(self.regions))] if named else []),
        ]

    def read(self, scene: Scene, unit: str) -> Regions | None:
        """The regions of a mesh as it is in its file, whose unit is that of the joints."""
        from calibration import Regions
        from clradar.cli.region_files import read_joints, read_regions
        from clradar.model.plausible import MESH_UNITS_M

        if self.regions is None:
            return None
        if self.regions == PARTS:
            return Regions.of_parts(scene)
        if self.regions == FINGERS:
            joints = None if self.joints is None else MESH_UNITS_M[unit] * read_joints(self.joints)
            return Regions.of_fingers(scene, joints)
        return read_regions(Path(self.regions), scene)


@dataclass(frozen=True, kw_only=True)
class PlaceOptions(PlacementOptions, SearchOptions):
    """The position of the mesh, given or to be found."""

    align: bool = option(False, "Find the pose of the mesh first, as `clradar align`.")

    def __post_init__(self) -> None:
        if self.align and self.transform is not None:
            raise wrong_usage("--transform, --align", "expected one of the two")


def command(
    *,
    measured: MeasuredArgument,
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
    device: DevicesOption = None,
    force: ForceOption = False,
    show: OpenOption = False,
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
    from clradar.cli import sweep_folder
    from clradar.compare import depth_map_of
    from clradar.opencl import open_devices

    read = [measured, mesh, *place.files, *regions.files, *made_of.files]
    check_place_of_folder(output, replaced=sweep_folder.OWN_NAMES, inputs=read)
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
    result = sweep_folder.sweep_into(
        output, volume, inputs.placed, run, kind.write,
        source=str(measured), origin=origin, force=force, device=opened,
        align=None if inputs.align is None else {**inputs.align, **image.radar},
    )  # fmt: skip
    if result is None:
        print_line(f"{output}: finished before with these settings; nothing to do")
    else:
        kind.show(result)
        print_line(f"{output}: {', '.join(sweep_folder.RESULTS)}")
    open_written(show, output / sweep_folder.FIGURE)


def check_together(
    alphas: AlphaOptions, roughness: RoughnessOptions, made_of: MaterialOptions
) -> None:
    """Raise where options of one kind of sweep are given with the other."""
    if roughness.given:
        if alphas.alpha is not None:
            raise wrong_usage("--alpha, --roughness-mm", "expected one of the two")
        return
    roughness.check_alone()
    if made_of.given:
        raise wrong_usage("--material", "expected --roughness-mm with it: alpha has no material")


def over_alpha(alphas: AlphaOptions, imaging: ImagingOptions, depth: DepthMapOptions) -> SweepKind:
    """A sweep over alpha."""
    from clradar.cli.sweep_folder import write_results

    values = read_alphas(ALPHAS if alphas.alpha is None else alphas.alpha)

    def run(
        radar: dict[str, Any], content: Volume | Capture, volume: Volume, scene: Scene,
        **options: Any,
    ) -> Sweep:  # fmt: skip
        from calibration import sweep

        return sweep(
            volume, scene, values, metric=alphas.metric, dynamic_range_db=depth.dynamic_range_db,
            **radar, **recorded(imaging), **options,
        )  # fmt: skip

    record = {"alphas": values.tolist(), "metric": alphas.metric}
    return SweepKind(record, run, write_results, print_result)


class SweepInputs:
    """The mesh, its regions and its position; the measurement, its radar and its grid."""

    def __init__(
        self,
        place: PlaceOptions,
        mesh: Path,
        made_of: MaterialOptions,
        regions: RegionOptions,
        measured: Path,
        frames: FrameOptions,
        radar: RadarOptions,
        voxels: GridOptions,
        imaging: ImagingOptions,
        device: Device,
    ) -> None:
        from clradar import Scene

        self.align = {"search_deg": place.search_deg} if place.align else None
        self.scene = made_of.on(Scene.from_mesh(mesh, unit=place.unit))
        self.labels = regions.read(self.scene, place.unit)
        self.matrix = place.matrix()
        self.image = ImageInput.open(measured, frames)
        self.radar = self.image.radar_or(radar)
        self.grid = sweep_grid(self.image, voxels, imaging, device)
        self.files = [
            *self.image.files, mesh, *place.files, *regions.files, *made_of.files,
            *radar.files,
        ]  # fmt: skip

    @property
    def placed(self) -> Scene:
        """The mesh at the given transform."""
        return self.scene if self.matrix is None else self.scene.transformed(self.matrix)

    def record(self) -> dict[str, Any]:
        """Settings and digests that a folder has to have been begun with."""
        band_hz = self.radar["waveform"].frequencies_hz
        return {
            "measured_sha256": digest(self.image.content),
            "mesh_sha256": self.scene.digest(),
            "regions": None if self.labels is None else list(self.labels.names),
            "regions_sha256": None if self.labels is None else sha256_of_arrays(self.labels.face),
            "transform": None if self.matrix is None else self.matrix.tolist(),
            "align": self.align,
            "frequencies_ghz": [float(band_hz[0] / 1e9), float(band_hz[-1] / 1e9), len(band_hz)],
            "grid": grid_text(self.grid),
        }


def read_alphas(text: str) -> np.ndarray:
    """The alphas of ``FIRST:LAST:STEP`` or of a list, shape (A,), float64."""
    return ascending("--alpha", text, "alphas", (0.0, 1.0), least=2)


def sweep_grid(
    image: ImageInput, voxels: GridOptions, imaging: ImagingOptions, device: Device
) -> VoxelGrid:
    """The grid of a volume; for a capture that of the options, or one that shows the object."""
    if image.grid is None:
        return common_grid(voxels, image, device=device)
    if given(voxels):
        raise wrong_usage("--x-mm, --y-mm, --z-mm", "there is no capture to image")
    window = image.content.meta.get("window", imaging.window)
    if window != imaging.window:
        print_warning(
            f"{image.path}: was formed with the window '{window}'; simulations are with "
            f"'{imaging.window}' (--window)"
        )
    return image.grid


def digest(image: Volume | Capture) -> str:
    """The SHA-256 of everything in a capture or volume that a result depends on."""
    from clradar import Volume

    if isinstance(image, Volume):
        return sha256_of_arrays(image.data, image.grid.x_m, image.grid.y_m, image.grid.z_m)
    antennas_m = image.array.tx_m, image.array.rx_m
    return sha256_of_arrays(image.data, *antennas_m, image.waveform.frequencies_hz)


def print_result(result: Sweep) -> None:
    """Print the metrics over alpha, as mean and deviation over the seeds, and the best alpha."""

    def cell(values: np.ndarray, digits: int) -> str:
        if not np.isfinite(values).all():
            return "n/a"
        if len(values) == 1:
            return f"{values[0]:.{digits}f}"
        return f"{values.mean():.{digits}f} \N{PLUS-MINUS SIGN} {values.std(ddof=1):.{digits}f}"

    found = result.estimate
    rows = []
    for i, alpha in enumerate(result.alphas):
        cells = [cell(f * result.of(name)[:, i], n) for name, f, n in METRIC_COLUMNS.values()]
        mark = "best" if i == found.grid_best else "alike" if found.alike[i] else ""
        rows.append([f"{alpha:g}", *cells, cell(found.score[:, i], 4), mark])
    names = ("alpha", *METRIC_COLUMNS, "score", "")
    print_table(names, rows, right=names[:-1])
    print_text(result.report())
