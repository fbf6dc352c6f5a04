"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.call import plain
from clradar.cli.comparison import write_csv
from clradar.cli.console import print_line, print_table, print_text, print_warning, progress_bar
from clradar.cli.inputs import Content, Measurement, measurement
from clradar.cli.outputs import check_place_of_folder, provenance, settings_of
from clradar.compare import METRIC_TABLE, METRICS
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import CompareError
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.hashing import sha256_of_arrays
from clradar.files.json_file import write_json
from clradar.files.json_text import parse_json
from clradar.jobs import FolderStore, Job, open_devices
from clradar.jobs.job import KEY
from clradar.model import checks

if TYPE_CHECKING:
    from calibration import Regions

RESULT = "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
OWN_NAMES = (KEY, RESULT, TABLE, REGION_TABLE, FIGURE, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""

LIMITS = ("median", "low", "high", "low95", "high95")


def _at_least_one(option: str, value: int) -> int:
    return checks.whole(option, value, 1)


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alphas and the seeds to simulate with."""

    alpha: tuple[float, ...] = opt.option(
        f"{parse.RANGE_RULE}, or a list with commas; in [0, 1].",
        "0:1:0.1",
        metavar="RANGE",
        without="--roughness-mm",
        parse=parse.ascending("alphas", (0.0, 1.0), least=2),
    )
    seeds: int = opt.option(
        "Simulations per alpha, each its own seed.", 3, metavar="N", check=_at_least_one
    )
    seed: int = opt.option("The first seed.", 0, metavar="N")

    estimator = None

    def run(self, measured: Measurement, scene: cl.Scene, **settings: Any) -> Any:
        """Sweep over alpha."""
        import calibration

        return calibration.sweep(
            measured.volume, scene, np.array(self.alpha), **measured.radar, **settings
        )

    def write(self, folder: Path, result: Any) -> None:
        """Write figure and tables."""
        from calibration.roughness.figures import sweep_figure
        from clradar.plot import save_figure

        save_figure(sweep_figure(result), folder / FIGURE, force=True)
        rows = [
            [float(alpha), seed, *(getattr(result.metrics[k][i], name) for name in METRICS)]
            for i, alpha in enumerate(result.alphas)
            for k, seed in enumerate(result.seeds)
        ]
        write_csv(folder / TABLE, ("alpha", "seed", *METRICS), rows)
        if result.regions:
            regions = [[r.name, *(getattr(r.interval, n) for n in LIMITS)] for r in result.regions]
            write_csv(folder / REGION_TABLE, ("region", *LIMITS), regions)

    def show(self, result: Any) -> None:
        """Print the metrics over alpha, as mean and deviation over the seeds, and the best."""

        def cell(values: np.ndarray, digits: int) -> str:
            if not np.isfinite(values).all():
                return "n/a"
            spread = f" \N{PLUS-MINUS SIGN} {values.std(ddof=1):.{digits}f}"
            return f"{values.mean():.{digits}f}{spread if len(values) > 1 else ''}"

        rows = []
        for i, alpha in enumerate(result.alphas):
            cells = [cell(m.scale * result.of(m.field)[:, i], m.digits) for m in METRIC_TABLE]
            rows.append([f"{alpha:g}", *cells, "nearest" if i == result.nearest else ""])
        names = ("alpha", *(one.name for one in METRIC_TABLE), "")
        print_table(names, rows, right=names[:-1])
        print_text(result.report())


def _lengths_mm(noun: str, bounds_m: tuple[float, float]) -> Any:
    return parse.ascending(noun, (1e3 * bounds_m[0], 1e3 * bounds_m[1]))


@dataclass(frozen=True, kw_only=True)
class RoughnessOptions:
    """Roughness and correlation lengths to simulate with, in place of alphas."""

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

    estimator = opt.PHYSICAL

    def run(self, measured: Measurement, scene: cl.Scene, **settings: Any) -> Any:
        """Sweep over roughness and correlation length."""
        import calibration

        if isinstance(measured.content, cl.Volume):
            raise CompareError(
                f"{measured.path}: expected a capture with --roughness-mm, got a volume: roughness "
                "is estimated from images by parts of the aperture"
            )
        for name in ("method", "window", "dynamic_range_db"):  # of images of the whole aperture
            del settings[name]
        lengths_m = (np.array(mm) / 1e3 for mm in (self.roughness_mm, self.correlation_mm))
        return calibration.sweep_roughness(
            measured.content, scene, *lengths_m, calibrated=self.calibrated, **settings
        )

    def write(self, folder: Path, result: Any) -> None:
        """Write figure and table."""
        from calibration.roughness.figures import roughness_figure
        from clradar.plot import save_figure

        save_figure(roughness_figure(result), folder / FIGURE, force=True)
        quantities = ("roughness_m", "correlation_m", "slope")
        pairs = [(quantity, limit) for quantity in quantities for limit in LIMITS]
        rows = [
            [one.name, *(getattr(getattr(one, q), limit) for q, limit in pairs), one.text()]
            for one in result.estimates
        ]
        write_csv(folder / TABLE, ("region", *map("_".join, pairs), "told"), rows)

    def show(self, result: Any) -> None:
        """Print medians and 68 % of the probability of each region, and what they mean."""

        def cell(interval: Any, scale: float) -> str:
            ends = f"{scale * interval.low:.3g} to {scale * interval.high:.3g}"
            return f"{scale * interval.median:.3g} ({ends})"

        rows = [
            [one.name, cell(one.roughness_m, 1e3), cell(one.correlation_m, 1e3), cell(one.slope, 1)]
            for one in result.estimates
        ]
        print_table(("region", "h, mm", "l, mm", "slope"), rows)
        print_text(result.report())


PARTS, FINGERS = "parts", "fingers"

LIMIT_BYTES = 2**28


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Regions of the mesh that have an alpha each."""

    regions: str | None = opt.option(
        "Find an alpha for each named part, for fingers and palm, or for the regions of a file: "
        ".npy or .json with a label per face, or .json with region: [parts].",
        metavar="parts|fingers|FILE",
    )

    @property
    def files(self) -> list[Path]:
        """The file of regions, if there is one."""
        return [] if self.regions in (None, PARTS, FINGERS) else [Path(str(self.regions))]

    def read(self, scene: cl.Scene) -> Regions | None:
        """The regions of a mesh."""
        from calibration import Regions

        if self.regions is None:
            return None
        if self.regions == PARTS:
            return Regions.of_parts(scene)
        if self.regions == FINGERS:
            return Regions.of_fingers(scene)
        return _read_regions(Path(self.regions), scene)


def command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file.", opt.REQUIRED, metavar="MESH"),
    output: Path = opt.output_option(
        "New folder, or one to resume.", opt.REQUIRED, metavar="DIR", folder=True
    ),
    alphas: AlphaOptions,
    roughness: RoughnessOptions,
    made_of: opt.MaterialOptions,
    regions: RegionOptions,
    place: opt.PlacementOptions,
    simulation: opt.SimulationOptions,
    radar: opt.RadarOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
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

    read = [mesh, *opt.files_of(place, regions, made_of)]
    check_place_of_folder(output, replaced=OWN_NAMES, inputs=[measured, *read])
    if regions.regions is not None and simulation.max_bounces > 1:
        text = "expected 1 with --regions: a path of two bounces belongs to no single region"
        raise opt.wrong_usage("--max-bounces", text)
    kind = alphas if roughness.roughness_mm is None else roughness
    settings = simulation.settings(seed=alphas.seed, estimator=kind.estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit))
    labels, matrix = regions.read(scene), place.matrix()
    found = measurement(measured, frames, radar, voxels, imaging, devices.first)
    own = found.content.meta.get("window", imaging.window)
    if own != imaging.window and isinstance(found.content, cl.Volume):
        print_warning(
            f"{measured}: was formed with the window '{own}'; simulations are with "
            f"'{imaging.window}' (--window)"
        )
    grid = opt.grid_text(found.volume.grid)
    origin = provenance([*found.files, *read], grid=grid)
    key = settings_of(
        origin, grid=grid, measured_sha256=digest(found.content), mesh_sha256=scene.digest(),
        regions=None if labels is None else list(labels.names),
        regions_sha256=None if labels is None else sha256_of_arrays(labels.face),
        transform=None if matrix is None else matrix.tolist(), frame=None, variant=None,
        radar_sha256=digest_of_radar(**found.radar),
        device=dict(devices.first.describe()), packages=origin["packages"],
    )  # fmt: skip
    range_db = depth.dynamic_range_db
    depth_map_of(found.volume, range_db, str(measured))  # raises before a folder is made
    placed = scene if matrix is None else scene.transformed(matrix)
    check_within_grid(placed, found.volume.grid)
    sweep_into(
        output, kind, found, placed, origin, key, force=force, seeds=alphas.seeds, regions=labels,
        settings=settings, device=devices, dynamic_range_db=range_db, **imaging.arguments,
    )  # fmt: skip


def sweep_into(
    folder: Path,
    kind: AlphaOptions | RoughnessOptions,
    measured: Measurement,
    scene: cl.Scene,
    origin: Mapping[str, Any],
    key: Mapping[str, Any],
    *,
    force: bool,
    **settings: Any,
) -> None:
    """Sweep in a folder, or resume a sweep that was killed there."""
    job = Job(
        folder=folder, work="sweep", own=OWN_NAMES, force=force, key=plain(dict(key)),
        resumable=lambda at: any(at.glob(f"{WORK}/*.npz")),
    )  # fmt: skip
    with job.held():
        finished = all((folder / name).is_file() for name in RESULTS)
        if not finished:
            store = FolderStore(folder / WORK)
            if len(store):
                print_line(f"{folder}: resumes with {len(store)} images that are done")
            with progress_bar("sweeping") as progress:
                result = kind.run(measured, scene, store=store, progress=progress, **settings)
            with progress_bar("drawing"):
                kind.write(folder, result)
                record = {"measured": str(measured.path), **result.to_dict(), **origin}
                write_json(folder / RESULT, record, force=True)
        job.clear([WORK])
    if finished:
        print_line(f"{folder}: finished before with these settings; nothing to do")
    else:
        kind.show(result)
        print_line(f"{folder}: {', '.join(RESULTS)}")


def digest(image: Content) -> str:
    """The SHA-256 of everything in a capture or volume that a result depends on."""
    if isinstance(image, cl.Volume):
        return sha256_of_arrays(image.data, image.grid.x_m, image.grid.y_m, image.grid.z_m)
    radar = digest_of_radar(image.array, image.waveform)
    return sha256_of_arrays(image.data, np.frombuffer(radar.encode(), np.uint8))


def digest_of_radar(array: cl.AntennaArray, waveform: cl.Waveform) -> str:
    """The SHA-256 of the antennas' places and of the frequencies."""
    return sha256_of_arrays(array.tx_m, array.rx_m, waveform.frequencies_hz)


def _read_regions(path: Path, scene: cl.Scene) -> Regions:
    """A number or string for each face, or names of parts by region."""
    from calibration import Regions

    expected = "'parts', 'fingers', or a .npy or .json file with a label for each face"
    content = read_bytes(path, expected, LIMIT_BYTES)
    with reading(path, expected):
        if path.suffix.lower() == ".npy":
            labels: Any = np.load(path, allow_pickle=False)
            if labels.dtype.kind not in "iu":
                fail(path, "whole numbers", f"{labels.dtype}")
        else:
            labels = parse_json(content.decode("utf-8-sig"))
        if isinstance(labels, dict):
            if not all(_all_are(names, str) for names in labels.values()):
                fail(path, "lists of names of parts", "something else")
            return Regions.of_parts(scene, labels)
        if isinstance(labels, list) and not (_all_are(labels, int) or _all_are(labels, str)):
            fail(path, "a list of whole numbers or of strings", "something else")
        if np.shape(labels) != (scene.n_faces,):
            fail(path, f"{scene.n_faces} labels, one per face", f"shape {np.shape(labels)}")
        return Regions.of_labels(labels)


def _all_are(values: Any, kind: type) -> bool:
    return isinstance(values, list) and all(type(value) is kind for value in values)
