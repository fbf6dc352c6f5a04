"""A sweep over roughness in millimetres: its options, and what it prints and writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_table, print_text
from clradar.cli.options.groups import option
from clradar.cli.options.materials import PHYSICAL
from clradar.cli.options.simulation import Estimator
from clradar.cli.options.values import RANGE_RULE, ascending, wrong_usage
from clradar.cli.sweep_folder import FIGURE, RESULT, TABLE, write_csv
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import CompareError
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import RoughnessEstimate, RoughnessSweep
    from clradar import Capture, Scene, Volume

CORRELATIONS_MM = "1.5,3,6"


@dataclass(frozen=True, kw_only=True)
class RoughnessOptions:
    """Roughness and correlation lengths to simulate with, in place of alphas."""

    roughness_mm: str | None = option(
        None,
        "In place of --alpha: root mean square heights of the surface, for the physical estimator, "
        "at least three; heights times lengths times --seeds are 30 or more; "
        f"{RANGE_RULE}, or a list with commas. Try 0.1:0.6:0.1.",
        metavar="RANGE",
    )
    correlation_mm: str = option(
        CORRELATIONS_MM,
        "With --roughness-mm: correlation lengths, as above; a single one is taken for known.",
        metavar="RANGE",
    )
    calibrated: bool = option(
        False, "With --roughness-mm: MEASURED is in S-parameters, and its level counts, too."
    )

    @property
    def given(self) -> bool:
        """Whether the sweep is over roughness."""
        return self.roughness_mm is not None

    def grid_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Heights and correlation lengths, metres."""
        ranges = {
            "--roughness-mm": (self.roughness_mm, "heights", PLAUSIBLE_ROUGHNESS_M),
            "--correlation-mm": (self.correlation_mm, "lengths", PLAUSIBLE_CORRELATION_M),
        }
        heights, lengths = (
            ascending(name, str(text), noun, (1e3 * low, 1e3 * high)) / 1e3
            for name, (text, noun, (low, high)) in ranges.items()
        )
        return heights, lengths

    def check_alone(self) -> None:
        """Raise where an option needs --roughness-mm, which is not given."""
        if self.correlation_mm != CORRELATIONS_MM or self.calibrated:
            raise wrong_usage("--correlation-mm, --calibrated", "expected --roughness-mm with it")


@dataclass(frozen=True, slots=True)
class SweepKind:
    """What is swept over.

    Attributes
    ----------
    record : dict
        Settings that a folder has to have been begun with.
    run : callable
        Called with the radar, the measurement, its image, the scene, and keywords; returns the
        result.
    write, show : callable
        Write the result to a folder, and print it.
    estimator : "physical" or None
    """

    record: dict[str, Any]
    run: Callable[..., Any]
    write: Callable[..., None]
    show: Callable[..., None]
    estimator: Estimator | None = None

    def check_measured(self, path: Path, content: Volume | Capture) -> None:
        """Raise where the measurement is an image, and parts of the aperture are asked for."""
        from clradar import Volume

        if self.estimator == PHYSICAL and isinstance(content, Volume):
            raise CompareError(
                f"{path}: expected a capture with --roughness-mm, got a volume: roughness is told "
                "from images by parts of the aperture"
            )


def over_roughness(options: RoughnessOptions) -> SweepKind:
    """A sweep over roughness and correlation length."""
    heights_m, lengths_m = options.grid_m()

    def run(
        radar: dict[str, Any], content: Capture, volume: Volume, scene: Scene, **more: Any
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
