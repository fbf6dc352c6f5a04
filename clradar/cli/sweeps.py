"""Sweeps over alpha and over roughness: what is swept over, and what is written and printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.call import plain
from clradar.cli.comparison import write_csv
from clradar.cli.console import print_line, print_table, print_text, progress_bar
from clradar.cli.inputs import Measurement
from clradar.compare import METRIC_TABLE, METRICS
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import CompareError
from clradar.files.json_file import write_json
from clradar.jobs import FolderStore, Job
from clradar.jobs.job import KEY
from clradar.model import checks

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
