"""Sweeps over alpha and over roughness: their folder, what is written and printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.comparison import write_csv
from clradar.cli.console import print_line, print_table, print_text, print_warning, progress_bar
from clradar.cli.inputs import Measurement
from clradar.cli.options.scene import PHYSICAL, Estimator
from clradar.cli.options.sweep import AlphaOptions, RoughnessOptions
from clradar.compare import METRIC_TABLE, METRICS
from clradar.errors import CompareError
from clradar.files.hashing import sha256_of_arrays
from clradar.files.json_file import write_json
from clradar.jobs import FolderStore, Job
from clradar.jobs.job import KEY

if TYPE_CHECKING:
    from calibration import RoughnessSweep, Sweep

RESULT = "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
OWN_NAMES = (KEY, RESULT, TABLE, REGION_TABLE, FIGURE, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""


@dataclass(frozen=True, slots=True)
class SweepKind:
    """What is swept over: the function, and what is written in tables and printed of its result."""

    record: dict[str, Any]
    run: Callable[..., Any]  # of the measurement and the placed mesh
    write: Callable[[Path, Any], None]  # figure and tables
    show: Callable[[Any], None]
    estimator: Estimator | None = None


def over_alpha(options: AlphaOptions, imaging: Mapping[str, Any], range_db: float) -> SweepKind:
    """A sweep over alpha."""
    values = options.alphas()

    def run(measured: Measurement, scene: cl.Scene, **more: Any) -> Sweep:
        import calibration

        return calibration.sweep(
            measured.volume, scene, values, dynamic_range_db=range_db, **measured.radar, **imaging,
            **more,
        )  # fmt: skip

    record = {"alphas": values.tolist()}
    return SweepKind(record, run, _write_alpha, _print_alpha)


def over_roughness(options: RoughnessOptions) -> SweepKind:
    """A sweep over roughness and correlation length."""
    heights_m, lengths_m = options.grid_m()

    def run(measured: Measurement, scene: cl.Scene, **more: Any) -> RoughnessSweep:
        import calibration

        if isinstance(measured.content, cl.Volume):
            raise CompareError(
                f"{measured.path}: expected a capture with --roughness-mm, got a volume: roughness "
                "is estimated from images by parts of the aperture"
            )
        return calibration.sweep_roughness(
            measured.content, scene, heights_m, lengths_m, calibrated=options.calibrated, **more
        )

    ranges = {"roughness_m": heights_m.tolist(), "correlation_m": lengths_m.tolist()}
    record = {**ranges, "calibrated": options.calibrated}
    return SweepKind(record, run, _write_roughness, _print_roughness, PHYSICAL)


def sweep_into(
    folder: Path,
    kind: SweepKind,
    measured: Measurement,
    scene: cl.Scene,
    origin: Mapping[str, Any],
    *,
    force: bool,
    **settings: Any,
) -> None:
    """Sweep in a folder, or resume a sweep that was killed there."""
    job = Job(
        folder=folder, work="sweep", own=OWN_NAMES, force=force,
        key={**origin["options"], "clradar": origin["clradar"]},
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


def check_window(measured: Measurement, window: str) -> None:
    """Warn where simulations are not imaged as the measured volume was."""
    own = measured.content.meta.get("window", window)
    if own != window and isinstance(measured.content, cl.Volume):
        print_warning(
            f"{measured.path}: was formed with the window '{own}'; simulations are with "
            f"'{window}' (--window)"
        )


def digest(image: cl.Volume | cl.Capture) -> str:
    """The SHA-256 of everything in a capture or volume that a result depends on."""
    if isinstance(image, cl.Volume):
        return sha256_of_arrays(image.data, image.grid.x_m, image.grid.y_m, image.grid.z_m)
    antennas_m = image.array.tx_m, image.array.rx_m
    return sha256_of_arrays(image.data, *antennas_m, image.waveform.frequencies_hz)


def _write_alpha(folder: Path, result: Sweep) -> None:
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
        limits = ("median", "low", "high", "low95", "high95")
        regions = [[r.name, *(getattr(r.interval, n) for n in limits)] for r in result.regions]
        write_csv(folder / REGION_TABLE, ("region", *limits), regions)


def _print_alpha(result: Sweep) -> None:
    """Print the metrics over alpha, as mean and deviation over the seeds, and the best alpha."""

    def cell(values: np.ndarray, digits: int) -> str:
        if not np.isfinite(values).all():
            return "n/a"
        if len(values) == 1:
            return f"{values[0]:.{digits}f}"
        return f"{values.mean():.{digits}f} \N{PLUS-MINUS SIGN} {values.std(ddof=1):.{digits}f}"

    rows = []
    for i, alpha in enumerate(result.alphas):
        cells = [cell(m.scale * result.of(m.field)[:, i], m.digits) for m in METRIC_TABLE]
        rows.append([f"{alpha:g}", *cells, "nearest" if i == result.nearest else ""])
    names = ("alpha", *(one.name for one in METRIC_TABLE), "")
    print_table(names, rows, right=names[:-1])
    print_text(result.report())


def _write_roughness(folder: Path, result: RoughnessSweep) -> None:
    from calibration.roughness.figures import roughness_figure
    from clradar.plot import save_figure

    save_figure(roughness_figure(result), folder / FIGURE, force=True)
    quantities = ("roughness_m", "correlation_m", "slope")
    limits = ("median", "low", "high", "low95", "high95")
    pairs = [(quantity, limit) for quantity in quantities for limit in limits]
    rows = [
        [one.name, *(getattr(getattr(one, q), limit) for q, limit in pairs), one.text()]
        for one in result.estimates
    ]
    write_csv(folder / TABLE, ("region", *map("_".join, pairs), "told"), rows)


def _print_roughness(result: RoughnessSweep) -> None:
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
