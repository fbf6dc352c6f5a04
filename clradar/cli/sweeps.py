"""Sweeps over alpha and over roughness: their folder, options, regions, and what they print."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

import clradar as cl
from clradar.cli.comparison import METRIC_COLUMNS, write_csv
from clradar.cli.console import print_line, print_table, print_text, print_warning, progress_bar
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.groups import recorded, wrong_usage
from clradar.cli.options.measured import (
    DepthMapOptions,
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    grid_text,
)
from clradar.cli.options.scene import PHYSICAL, Estimator, MaterialOptions
from clradar.cli.options.sweep import (
    ALPHAS,
    AlphaOptions,
    PlaceOptions,
    RegionOptions,
    RoughnessOptions,
    read_alphas,
)
from clradar.compare import METRICS
from clradar.errors import CompareError
from clradar.files.hashing import sha256_of_arrays
from clradar.files.json_file import write_json
from clradar.jobs import FolderStore, Job
from clradar.jobs.job import KEY

if TYPE_CHECKING:
    from calibration import RoughnessEstimate, RoughnessSweep, Sweep

TRANSFORM, RESULT = "transform.json", "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
FILES = (KEY, TRANSFORM, RESULT, TABLE, REGION_TABLE, FIGURE)

OWN_NAMES = (*FILES, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""

Swept = TypeVar("Swept")


def sweep_into(
    folder: Path,
    measured: cl.Volume | None,
    scene: cl.Scene,
    run: Callable[..., Swept],
    write: Callable[[Path, Swept, Mapping[str, Any], str], None],
    *,
    source: str,
    origin: Mapping[str, Any],
    align: Mapping[str, Any] | None = None,
    device: cl.Device,
    force: bool = False,
) -> Swept | None:
    """Sweep in a folder, or resume a sweep that was killed there."""
    job = Job(
        folder=folder, work="sweep", own=OWN_NAMES, force=force,
        key={**origin["options"], "clradar": origin["clradar"]}, resumable=_resumable,
    )  # fmt: skip
    with job.held():
        finished = is_finished(folder)
        if not finished:
            if align is not None:
                assert measured is not None
                place = _aligned(folder / TRANSFORM, measured, scene, device, origin, align)
                scene = scene.transformed(place)
            store = FolderStore(folder / WORK)
            if len(store):
                print_line(f"{folder}: resumes with {len(store)} images that are done")
            with progress_bar("sweeping") as progress:
                result = run(scene, store=store, progress=progress)
            with progress_bar("drawing"):
                write(folder, result, origin, source)
        job.clear([WORK])
    return None if finished else result


def _resumable(folder: Path) -> bool:
    done = [folder / TRANSFORM, *(folder / WORK).glob("*.npz")]
    return any(path.is_file() for path in done)


def _aligned(
    path: Path,
    measured: cl.Volume,
    scene: cl.Scene,
    device: cl.Device,
    origin: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> np.ndarray:
    """The pose of the mesh: from the file of an earlier run, or found and written."""
    from calibration import align_mesh
    from measurement_io import read_transform

    if path.is_file():
        return read_transform(path)
    with progress_bar("aligning") as progress:
        found = align_mesh(measured, scene, device=device, progress=progress, **settings)
    write_json(path, {**found.to_dict(), **origin}, force=False)
    print_text(found.report())
    return found.transform


def write_results(folder: Path, result: Sweep, origin: Mapping[str, Any], source: str) -> None:
    """Write figure and tables of a sweep over alpha, and last the JSON file."""
    from calibration.roughness.figure import sweep_figure
    from clradar.plot import save_figure

    save_figure(sweep_figure(result), folder / FIGURE, force=True)
    write_csv(folder / TABLE, ("alpha", "seed", *METRICS, "score"), _rows(result))
    if result.regions is not None:
        names = ("region", "alpha", "seed", result.estimate.metric, "score")
        write_csv(folder / REGION_TABLE, names, _region_rows(result))
    write_json(folder / RESULT, {"measured": source, **result.to_dict(), **origin}, force=True)


def _rows(result: Sweep) -> Iterator[Sequence[Any]]:
    """One row per alpha and seed: the metrics, and the score."""
    for i, alpha in enumerate(result.alphas):
        for k, seed in enumerate(result.seeds):
            values = [getattr(result.metrics[k][i], name) for name in METRICS]
            yield float(alpha), seed, *values, float(result.estimate.score[k, i])


def _region_rows(result: Sweep) -> Iterator[Sequence[Any]]:
    """One row per region, alpha and seed, all other regions at their best alpha."""
    assert result.regions is not None
    for name, found in zip(result.regions.names, result.regions.estimates, strict=True):
        for i, alpha in enumerate(result.alphas):
            for k, seed in enumerate(result.seeds):
                yield name, float(alpha), seed, float(found.values[k, i]), float(found.score[k, i])


def is_finished(folder: Path) -> bool:
    """Whether all results are there; the last to be written is RESULT."""
    return all((folder / name).is_file() for name in RESULTS)


@dataclass(frozen=True, slots=True)
class SweepKind:
    """What is swept over."""

    record: dict[str, Any]
    run: Callable[..., Any]
    write: Callable[..., None]
    show: Callable[..., None]
    estimator: Estimator | None = None

    def check_measured(self, path: Path, content: cl.Volume | cl.Capture) -> None:
        """Raise where the measurement is an image, and parts of the aperture are asked for."""

        if self.estimator == PHYSICAL and isinstance(content, cl.Volume):
            raise CompareError(
                f"{path}: expected a capture with --roughness-mm, got a volume: roughness is told "
                "from images by parts of the aperture"
            )


def over_roughness(options: RoughnessOptions) -> SweepKind:
    """A sweep over roughness and correlation length."""
    heights_m, lengths_m = options.grid_m()

    def run(
        radar: dict[str, Any],
        content: cl.Capture,
        volume: cl.Volume,
        scene: cl.Scene,
        **more: Any,
    ) -> RoughnessSweep:
        from calibration import sweep_roughness

        return sweep_roughness(
            content, scene, heights_m, lengths_m, calibrated=options.calibrated, **more
        )

    record = {
        "roughness_m": heights_m.tolist(),
        "correlation_m": lengths_m.tolist(),
        "calibrated": options.calibrated,
    }
    return SweepKind(record, run, write_roughness, print_roughness, PHYSICAL)


def print_roughness(result: RoughnessSweep) -> None:
    """Print medians and 68 % of the probability of each region, and what they tell."""

    def cell(interval: Any, scale: float) -> str:
        ends = f"{scale * interval.low:.3g} to {scale * interval.high:.3g}"
        return f"{scale * interval.median:.3g} ({ends})"

    rows = [
        [one.name, cell(one.roughness_m, 1e3), cell(one.correlation_m, 1e3), cell(one.slope, 1)]
        for one in result.estimates
    ]
    print_table(("region", "h, mm", "l, mm", "slope"), rows)
    print_text(result.report())


def write_roughness(
    folder: Path, result: RoughnessSweep, origin: Mapping[str, Any], source: str
) -> None:
    """Write figure, table and last the JSON file."""
    from calibration.roughness.roughness_figure import roughness_figure
    from clradar.plot import save_figure

    save_figure(roughness_figure(result), folder / FIGURE, force=True)
    quantities = ("roughness_m", "correlation_m", "slope")
    limits = ("median", "low", "high", "low95", "high95")
    names = [f"{quantity}_{limit}" for quantity in quantities for limit in limits]

    def row(one: RoughnessEstimate) -> list[Any]:
        numbers = [getattr(getattr(one, q), limit) for q in quantities for limit in limits]
        return [one.name, *numbers, one.text()]

    write_csv(folder / TABLE, ("region", *names, "told"), map(row, result.estimates))
    write_json(folder / RESULT, {"measured": source, **result.to_dict(), **origin}, force=True)


def over_alpha(alphas: AlphaOptions, imaging: ImagingOptions, depth: DepthMapOptions) -> SweepKind:
    """A sweep over alpha."""

    values = read_alphas(ALPHAS if alphas.alpha is None else alphas.alpha)

    def run(
        radar: dict[str, Any], content: cl.Volume | cl.Capture, volume: cl.Volume, scene: cl.Scene,
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
        device: cl.Device,
    ) -> None:

        self.align = {"search_deg": place.search_deg} if place.align else None
        self.scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit))
        self.labels = regions.read(self.scene, place.unit)
        self.matrix = place.matrix()
        self.image = ImageInput.open(measured, frames)
        self.radar = self.image.radar_or(radar)
        self.grid = sweep_grid(self.image, voxels, imaging, device)
        self.files = [
            *self.image.files, mesh, *place.files, *regions.files, *made_of.material_files,
            *radar.files,
        ]  # fmt: skip

    @property
    def placed(self) -> cl.Scene:
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


def sweep_grid(
    image: ImageInput, voxels: GridOptions, imaging: ImagingOptions, device: cl.Device
) -> cl.VoxelGrid:
    """The grid of a volume; for a capture that of the options, or one that shows the object."""
    if image.grid is None:
        return common_grid(voxels, image, device=device)
    if voxels.given:
        raise wrong_usage("--x-mm, --y-mm, --z-mm", "there is no capture to image")
    window = image.content.meta.get("window", imaging.window)
    if window != imaging.window:
        print_warning(
            f"{image.path}: was formed with the window '{window}'; simulations are with "
            f"'{imaging.window}' (--window)"
        )
    return image.grid


def digest(image: cl.Volume | cl.Capture) -> str:
    """The SHA-256 of everything in a capture or volume that a result depends on."""

    if isinstance(image, cl.Volume):
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
