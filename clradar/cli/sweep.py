"""``clradar sweep``."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.images import formed, open_image, recording_files
from clradar.cli.options import (
    DEFAULT_DYNAMIC_RANGE_DB,
    DeviceOption,
    DynamicRangeOption,
    ForceOption,
    FrameOption,
    Method,
    MethodOption,
    SearchOption,
    Unit,
    VariantOption,
    Window,
    WindowOption,
    XOption,
    YOption,
    ZOption,
    grid_text,
    voxel_grid,
    wrong_usage,
)
from clradar.cli.output import (
    print_line,
    print_table,
    print_text,
    print_warning,
    progress_bar,
    write_bytes,
    write_json,
)
from clradar.cli.provenance import package_versions, provenance
from clradar.cli.simulation_options import (
    RECEPTION_RADIUS_MM,
    START_GHZ,
    STEPS,
    STOP_GHZ,
    Amplitude,
    AmplitudeOption,
    CreaseOption,
    MaxBouncesOption,
    Normals,
    NormalsOption,
    PatternOption,
    RaysPerFaceOption,
    RaysPerSampleOption,
    ReceptionRadiusOption,
    SamplesOption,
    TransformOption,
)
from clradar.geometry.normals import CREASE_DEG

if TYPE_CHECKING:
    import numpy as np

    from calibration import Regions, Sweep
    from clradar import AntennaArray, Capture, Device, Scene, Volume, Waveform

ALPHAS = "0:1:0.1"
ALPHA_RULE = "FIRST:LAST:STEP, both ends included, or a list with commas"
PARTS, FINGERS = "parts", "fingers"
DECIMALS = 9
"""Of an alpha: 3 * 0.1 is then 0.3, as `clradar simulate --alpha 0.3` has it."""

MOST_ALPHAS = 1001

METRIC = "db_correlation"
"""As in `calibration.sweep`, whose module would make the help slow."""


def command(
    measured: Annotated[
        Path, typer.Argument(metavar="MEASURED", help="Volume, capture or recording.")
    ],
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="Mesh file.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="New folder, or one to go on in.")
    ],
    alpha: Annotated[
        str, typer.Option("--alpha", metavar="RANGE", help=f"{ALPHA_RULE}; in [0, 1].")
    ] = ALPHAS,
    seeds: Annotated[
        int, typer.Option("--seeds", metavar="N", help="Simulations per alpha, each its own seed.")
    ] = 3,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="The first seed.")] = 0,
    metric: Annotated[
        str,
        typer.Option(
            "--metric",
            metavar="NAME",
            help="What the best alpha is chosen by; see docs/metrics.md.",
        ),
    ] = METRIC,
    regions: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--regions",
            metavar="parts|fingers|FILE",
            help="Find an alpha for each named part, for fingers and palm, or for the regions of a "
            "file: .npy or .json with a label per face, or .json with region: [parts].",
        ),
    ] = None,
    joints: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--joints",
            metavar="JOINTS.json",
            help="For --regions fingers: joint name: [x, y, z] in the unit of the mesh, as "
            "`clradar hand --joints` writes it. Not needed where palm and fingers are parts.",
        ),
    ] = None,
    unit: Annotated[Unit, typer.Option("--unit", help="Unit of the mesh file.")] = Unit.m,
    transform: TransformOption = None,
    align: Annotated[
        bool, typer.Option("--align", help="Find where the mesh is first, as `clradar align`.")
    ] = False,
    search_deg: SearchOption = 45.0,
    samples_per_mm2: SamplesOption = None,
    rays_per_face: RaysPerFaceOption = None,
    rays_per_sample: RaysPerSampleOption = None,
    reception_radius_mm: ReceptionRadiusOption = RECEPTION_RADIUS_MM,
    max_bounces: MaxBouncesOption = 1,
    normals: NormalsOption = Normals.smooth,
    crease_deg: CreaseOption = CREASE_DEG,
    amplitude: AmplitudeOption = Amplitude.unit,
    pattern_exponent: PatternOption = 0.0,
    start_ghz: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--start-ghz",
            metavar="GHZ",
            help=f"First frequency, where MEASURED is a volume. [default: {START_GHZ:g}]",
        ),
    ] = None,
    stop_ghz: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--stop-ghz", metavar="GHZ", help=f"Last frequency. [default: {STOP_GHZ:g}]"),
    ] = None,
    steps: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--steps", metavar="N", help=f"Number of frequencies. [default: {STEPS}]"),
    ] = None,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    method: MethodOption = Method.fast,
    window: WindowOption = Window.rect,
    dynamic_range_db: DynamicRangeOption = DEFAULT_DYNAMIC_RANGE_DB,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Simulates MESH at every alpha with several seeds and compares each image with MEASURED. DIR
    gets sweep.png, sweep.csv, sweep.json, the settings, and with --align the transform. The same
    command goes on where a killed one stopped; other settings in the same DIR are refused, unless
    --force begins anew. What is found and how sure it is: docs/sweep.md.
    """
    from calibration import sweep
    from calibration.roughness.sweep import check_place
    from clradar import Scene, Volume, open_device
    from clradar.cli import sweep_folder as folder
    from clradar.compare import METRICS, depth_map_of
    from clradar.model import checks
    from clradar.tracing.settings import resolve_settings
    from measurement_io import read_transform

    alphas = read_alphas(alpha)
    if metric not in METRICS:
        raise wrong_usage("--metric", f"expected one of {', '.join(METRICS)}, got '{metric}'")
    if align and transform is not None:
        raise wrong_usage("--transform, --align", "expected one of the two")
    if joints is not None and regions != FINGERS:
        raise wrong_usage("--joints", "expected --regions fingers with it")
    checks.whole("--seeds", seeds, 1)
    checks.positive("--dynamic-range-db", dynamic_range_db)
    simulation: dict[str, Any] = {
        "samples_per_mm2": samples_per_mm2,
        "rays_per_face": rays_per_face,
        "rays_per_sample": rays_per_sample,
        "reception_radius_m": reception_radius_mm / 1e3,
        "max_bounces": max_bounces,
        "normals": normals.value,
        "crease_deg": crease_deg,
        "amplitude": amplitude.value,
        "pattern_exponent": pattern_exponent,
    }
    resolved = asdict(resolve_settings(**simulation, seed=seed))
    if regions is not None and max_bounces > 1:
        raise wrong_usage(
            "--max-bounces",
            "expected 1 with --regions: a path of two bounces belongs to no single region",
        )
    scene = Scene.from_mesh(mesh, unit=unit.value)
    labels = read_regions(regions, joints, scene, unit)
    matrix = None if transform is None else read_transform(transform)
    chosen = None if variant is None else variant.value
    recorded = open_image(measured, frame=frame, variant=chosen)
    array, waveform = radar_of(recorded, start_ghz, stop_ghz, steps)
    if isinstance(recorded, Volume):
        if any((x_mm, y_mm, z_mm)):
            raise wrong_usage("--x-mm, --y-mm, --z-mm", "there is no capture to image")
        grid = recorded.grid
        if recorded.meta.get("window", window.value) != window.value:
            print_warning(
                f"{measured}: was formed with the window '{recorded.meta['window']}'; simulations "
                f"are with '{window.value}' (--window)"
            )
    else:
        grid = voxel_grid(x_mm, y_mm, z_mm)
    opened = open_device(device)
    record = {
        "measured_sha256": digest(recorded),
        "mesh_sha256": scene.digest(),
        "regions": None if labels is None else list(labels.names),
        "regions_sha256": None if labels is None else sha256(labels.face),
        "transform": None if matrix is None else matrix.tolist(),
        "align": {"search_deg": search_deg} if align else None,
        "alphas": alphas.tolist(),
        "seeds": seeds,
        "metric": metric,
        "simulation": resolved,
        "frequencies_ghz": [
            float(waveform.frequencies_hz[0] / 1e9), float(waveform.frequencies_hz[-1] / 1e9),
            waveform.n_freq,
        ],
        "grid": grid_text(grid),
        "method": method.value,
        "window": window.value,
        "dynamic_range_db": dynamic_range_db,
        "device": dict(opened.describe()),
        "packages": package_versions(),
    }  # fmt: skip
    inputs = [*recording_files(measured, recorded.meta), mesh]
    inputs += [path for path in (transform, joints) if path is not None]
    if regions not in (None, PARTS, FINGERS):
        inputs.append(Path(str(regions)))
    origin = provenance("sweep", record, inputs)
    volume = formed(measured, recorded, grid, method.value, window.value, opened)
    # What cannot be swept should leave no folder behind.
    depth_map_of(volume, dynamic_range_db, str(measured))
    placed = scene if matrix is None else scene.transformed(matrix)
    if not align:
        check_place(placed, volume.grid)
    with folder.held(output):
        folder.begin(output, {**record, "clradar": origin["clradar"]}, force=force)
        if folder.is_finished(output):
            folder.finish(output)
            print_line(f"{output}: finished before with these settings; nothing to do")
            return
        if align:
            place = output / folder.TRANSFORM
            placed = scene.transformed(
                aligned(place, volume, recorded, scene, search_deg, opened, origin)
            )
        store = folder.FolderStore(output / folder.WORK)
        if len(store):
            print_line(f"{output}: goes on with {len(store)} images that are there")
        with progress_bar("sweeping") as progress:
            result = sweep(
                volume, placed, alphas,
                seeds=seeds, seed=seed, metric=metric, dynamic_range_db=dynamic_range_db,
                regions=labels, array=array, waveform=waveform, method=method.value,
                window=window.value, device=opened, store=store, progress=progress, **simulation,
            )  # fmt: skip
        write_results(output, result, origin, str(measured))
        folder.finish(output)
    print_result(result)
    print_line(f"{output}: {folder.FIGURE}, {folder.TABLE}, {folder.RESULT}")


def read_alphas(text: str) -> np.ndarray:
    """Return the alphas of ``FIRST:LAST:STEP`` or of a list, shape (A,), float64."""
    import numpy as np

    def wrong(why: str) -> typer.BadParameter:
        return wrong_usage("--alpha", f"expected {why}, got '{text}'")

    try:
        numbers = [float(part) for part in text.split(":" if ":" in text else ",")]
    except ValueError:
        raise wrong(ALPHA_RULE) from None
    if not all(math.isfinite(number) and 0.0 <= number <= 1.0 for number in numbers):
        raise wrong("numbers in [0, 1]")
    if ":" in text:
        if len(numbers) != 3:
            raise wrong(ALPHA_RULE)
        first, last, step = numbers
        if step <= 0 or last <= first:
            raise wrong("FIRST below LAST and STEP above 0")
        count = (last - first) / step
        if count > MOST_ALPHAS - 1:
            raise wrong(f"at most {MOST_ALPHAS} alphas")
        if abs(count - round(count)) > 1e-6:
            fits = first + math.floor(count) * step
            raise wrong(f"a whole number of steps, such as {first:g}:{fits:g}:{step:g}")
        numbers = [round(first + i * step, DECIMALS) for i in range(round(count) + 1)]
    if len(numbers) < 2:
        raise wrong("at least two alphas: the best of one is no finding")
    if not (np.diff(numbers) > 0).all():
        raise wrong("alphas in ascending order, each once")
    return np.array(numbers)


def radar_of(
    recorded: Volume | Capture,
    start_ghz: float | None,
    stop_ghz: float | None,
    steps: int | None,
) -> tuple[AntennaArray, Waveform]:
    """Return antennas and frequencies of a capture; of the options and the imager for a volume."""
    from clradar import Capture, Waveform, arrays

    if isinstance(recorded, Capture):
        if any(value is not None for value in (start_ghz, stop_ghz, steps)):
            raise wrong_usage(
                "--start-ghz, --stop-ghz, --steps", "MEASURED is a capture and has its frequencies"
            )
        return recorded.array, recorded.waveform
    return arrays.qar50(), Waveform.sfcw(
        1e9 * (START_GHZ if start_ghz is None else start_ghz),
        1e9 * (STOP_GHZ if stop_ghz is None else stop_ghz),
        STEPS if steps is None else steps,
    )


def read_regions(text: str | None, joints: Path | None, scene: Scene, unit: Unit) -> Regions | None:
    """Return the regions that the options ask for, of the mesh as it is in its file."""
    from calibration import Regions
    from clradar.cli.regions_file import read_joints, read_regions_file
    from clradar.model.scene import UNITS_M

    if text is None:
        return None
    if text == PARTS:
        return Regions.of_parts(scene)
    if text == FINGERS:
        scale = UNITS_M[unit.value]
        return Regions.of_fingers(scene, None if joints is None else scale * read_joints(joints))
    return read_regions_file(Path(text), scene)


def aligned(
    path: Path,
    volume: Volume,
    recorded: Volume | Capture,
    scene: Scene,
    search_deg: float,
    device: Device,
    origin: dict[str, Any],
) -> np.ndarray:
    """Return where the mesh is, from the file that an earlier run wrote, or found and written."""
    from calibration import align_mesh
    from clradar import Capture
    from measurement_io import read_transform

    if path.is_file():
        return read_transform(path)
    radar: dict[str, Any] = {}
    if isinstance(recorded, Capture):
        radar["array"] = recorded.array
        radar["centre_frequency_hz"] = float(recorded.waveform.frequencies_hz.mean())
    with progress_bar("aligning") as progress:
        found = align_mesh(
            volume, scene, search_deg=search_deg, device=device, progress=progress, **radar
        )
    write_json(path, {**found.to_dict(), **origin}, force=False)
    print_text(found.report())
    return found.transform


def digest(recorded: Volume | Capture) -> str:
    """Return the SHA-256 of everything in a capture or volume that a result depends on."""
    from clradar import Capture

    if isinstance(recorded, Capture):
        array = recorded.array
        return sha256(recorded.data, array.tx_m, array.rx_m, recorded.waveform.frequencies_hz)
    grid = recorded.grid
    return sha256(recorded.data, grid.x_m, grid.y_m, grid.z_m)


def sha256(*arrays: np.ndarray) -> str:
    """Return the SHA-256 of the bytes of arrays."""
    state = hashlib.sha256()
    for array in arrays:
        state.update(str((array.shape, array.dtype)).encode())
        state.update(array.tobytes())
    return state.hexdigest()


def write_results(folder: Path, result: Sweep, origin: dict[str, Any], measured: str) -> None:
    """Write figure, tables and last the JSON file, which says that all is there."""
    from calibration.roughness.figure import sweep_figure
    from clradar.cli import sweep_folder as names
    from clradar.plot import save_figure

    save_figure(sweep_figure(result), folder / names.FIGURE, force=True)
    write_bytes(folder / names.TABLE, table(result).encode(), force=True)
    if result.regions is not None:
        write_bytes(folder / names.REGION_TABLE, region_table(result).encode(), force=True)
    record = {"measured": measured, **result.to_dict(), **origin}
    write_json(folder / names.RESULT, record, force=True)


def table(result: Sweep) -> str:
    """Return one line per alpha and seed: the metrics, and the score."""
    from clradar.compare import METRICS

    def fill(write: Callable[..., Any]) -> None:
        write(("alpha", "seed", *METRICS, "score"))
        for i, alpha in enumerate(result.alphas):
            for k, seed in enumerate(result.seeds):
                values = [getattr(result.metrics[k][i], name) for name in METRICS]
                write((float(alpha), seed, *values, float(result.estimate.score[k, i])))

    return _csv(fill)


def region_table(result: Sweep) -> str:
    """Return one line per region, alpha and seed, the other regions at their best alpha."""
    regions = result.regions
    assert regions is not None

    def fill(write: Callable[..., Any]) -> None:
        write(("region", "alpha", "seed", result.estimate.metric, "score"))
        for name, found in zip(regions.names, regions.estimates, strict=True):
            for i, alpha in enumerate(result.alphas):
                for k, seed in enumerate(result.seeds):
                    numbers = (float(found.values[k, i]), float(found.score[k, i]))
                    write((name, float(alpha), seed, *numbers))

    return _csv(fill)


def _csv(fill: Callable[[Callable[..., Any]], None]) -> str:
    text = io.StringIO()
    fill(csv.writer(text, lineterminator="\n").writerow)
    return text.getvalue()


def print_result(result: Sweep) -> None:
    """Print the metrics over alpha, as mean and deviation over the seeds, and what was found."""
    import numpy as np

    columns = {
        "overlap": ("overlap", 1.0, 3),
        "dB correlation": ("db_correlation", 1.0, 3),
        "SSIM": ("ssim", 1.0, 3),
        "mask IoU": ("mask_iou", 1.0, 3),
        "depth RMSE (mm)": ("depth_rmse_m", 1e3, 2),
        "Chamfer sim. to meas. (mm)": ("chamfer_simulated_to_measured_m", 1e3, 2),
        "Chamfer meas. to sim. (mm)": ("chamfer_measured_to_simulated_m", 1e3, 2),
    }

    def cell(values: np.ndarray, digits: int) -> str:
        if not np.isfinite(values).all():
            return "n/a"
        if len(values) == 1:
            return f"{values[0]:.{digits}f}"
        return f"{values.mean():.{digits}f} \N{PLUS-MINUS SIGN} {values.std(ddof=1):.{digits}f}"

    rows = []
    for i, alpha in enumerate(result.alphas):
        cells = [cell(s * result.of(f)[:, i], d) for f, s, d in columns.values()]
        score = cell(result.estimate.score[:, i], 4)
        mark = "best" if i == result.estimate.grid_best else ""
        alike = "alike" if result.estimate.alike[i] and not mark else mark
        rows.append([f"{alpha:g}", *cells, score, alike])
    names = ("alpha", *columns, "score", "")
    print_table(names, rows, right=names[:-1])
    print_text(result.report())
