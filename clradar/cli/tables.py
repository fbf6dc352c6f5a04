"""What commands print of their results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.console import counted, print_line, print_table, print_text, print_warning
from clradar.compare import METRIC_TABLE
from clradar.errors import ClradarError

if TYPE_CHECKING:
    from calibration import Diagnosis, HandFit, Hypothesis
    from calibration.roughness.design import Estimates
    from clradar.arrays import ArrayFigures
    from clradar.dataset.check import Replay

DIGIT_COLUMNS = (
    "digit", "tip x, y, z (mm)", "sd (mm)", "tip determined", "angles determined", "as in the start"
)  # fmt: skip
BASIN_COLUMNS = ("pose", "start", "hand", "deviance", "tips apart (mm)")


def print_hand_fit(fit: HandFit) -> None:
    """Print tips, determined angles and basins as tables, and what remains of the report."""
    print_table(DIGIT_COLUMNS, digit_rows(fit), right=DIGIT_COLUMNS[1:3])
    if len(fit.basins) > 1:
        # One row for each pose in which the fit came to rest, with the tips' largest distance.
        basins = [
            [
                str(number), basin.start, basin.handedness, f"{basin.deviance:.1f}",
                f"{1e3 * fit.tips_apart_m(basin).max():.0f}",
            ]
            for number, basin in enumerate(fit.basins, start=1)
        ]  # fmt: skip
        print_table(BASIN_COLUMNS, basins, right=BASIN_COLUMNS[3:])
    print_line(fit.summary())
    if fit.remarks():
        print_line(f"Doubtful: see the {counted(len(fit.remarks()), 'warning')} above.")


def digit_rows(fit: HandFit) -> list[list[str]]:
    """One row for each digit, and one for the arch of the palm."""
    from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    rows = []
    for digit, angles in ANGLES_OF_DIGIT.items():
        names, where = ANGLE_NAMES[angles], ["", "", ""]
        unsure = [n.removeprefix(f"{digit}-finger-").removeprefix(f"{digit}-")
                  for n in names if n in fit.untold]  # fmt: skip
        if digit in DIGITS:
            number = DIGITS.index(digit)
            at_m, std_m = fit.tips_m[number], fit.tip_std_m[number]
            if np.isfinite(at_m).all():
                place = ", ".join(f"{1e3 * v:.1f}" for v in at_m)
                where = [place, f"{1e3 * std_m:.1f}", "yes" if fit.told_tips[number] else "no"]
        determined = f"{np.count_nonzero(fit.told_angles[angles])} of {len(names)}"
        rows.append([digit, *where, determined, ", ".join(unsure)])
    return rows


def print_sweep(result: Estimates) -> None:
    """Print the metrics of each alpha, if that is swept, as means over the seeds; the estimates."""
    from calibration import Sweep

    if isinstance(result, Sweep):
        means = {one.field: result.of(one.field).mean(axis=0) for one in METRIC_TABLE}
        rows = []
        for i, alpha in enumerate(result.alphas):
            at: Any = SimpleNamespace(**{name: values[i] for name, values in means.items()})
            nearest = "nearest" if i == result.nearest else ""
            rows.append([f"{alpha:g}", *(one.text(at) for one in METRIC_TABLE), nearest])
        print_table(("alpha", *(one.name for one in METRIC_TABLE), ""), rows)
    print_text(result.report())


SCORE_COLUMNS = ("axes", "phase", "frequencies", "sharpness (dB)", "brightest at x, y, z (mm)", "")


def print_scores(result: Diagnosis) -> None:
    """Print one row per hypothesis, the sharpest first."""
    rows = []
    for score in sorted(result.scores, key=lambda s: -s.relative_db):
        h, place = score.hypothesis, ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)
        row = ["[rx, tx]" if h.swapped else "[tx, rx]", "exp(+j)" if h.conjugated else "exp(-j)"]
        row += ["descending" if h.reversed else "ascending", decibels(score.relative_db), place]
        rows.append([*row, mark_of(result, h)])
    print_table(SCORE_COLUMNS, rows, right=SCORE_COLUMNS[3:5])


def mark_of(result: Diagnosis, hypothesis: Hypothesis) -> str:
    """Whether a hypothesis is the best, or one of those that remain."""
    left = [replace(candidate, mirrored=False) for candidate in result.candidates]
    if hypothesis not in left:
        return ""
    return "best" if result.best and hypothesis == left[0] else "ambiguous"


def decibels(relative_db: float) -> str:
    """A level for a table, without -0.0."""
    return f"{round(relative_db, 1) + 0.0:.1f}" if relative_db > -100 else "< -100"


LOBE_COLUMNS = ("lobe", "azimuth (°)", "elevation (°)", "level (dB)", "")


def print_array(name: str, clusters: Sequence[cl.AntennaArray], found: ArrayFigures) -> None:
    """Print widths, ranges and lobes."""
    from clradar.arrays.figures_of_merit import LEVEL_DB

    at = ", ".join(f"{1e3 * value:g}" for value in found.focus_m)
    widths = ", ".join(f"{a} {_mm(w)}" for a, w in zip("xyz", found.widths_m, strict=True))
    several = f"{len(clusters)} clusters of " if len(clusters) > 1 else ""
    antennas = f"{several}{clusters[0].n_tx} Tx, {clusters[0].n_rx} Rx"
    print_line(f"{name}: {antennas}, focused on {at} mm")
    print_line(f"widths at -3 dB: {widths}; resolution in range c/2B {_mm(found.range_cell_m)}")
    print_line(f"unambiguous range c/2df: {_mm(found.unambiguous_range_m)}")
    within = f" within {found.within_deg:g}°" if found.within_deg < 90 else ""
    print_line(("lobes" if found.lobes else f"no other lobe above {LEVEL_DB:g} dB") + within)
    rows = []
    for number, lobe in enumerate(found.lobes, start=1):
        angles = [f"{round(a, 1) + 0.0:.1f}" for a in (lobe.azimuth_deg, lobe.elevation_deg)]
        rows.append(
            [str(number), *angles, f"{lobe.level_db:.1f}", "grating lobe" if lobe.grating else ""]
        )
    if rows:
        print_table(LOBE_COLUMNS, rows, right=LOBE_COLUMNS[:4])
    if any(lobe.grating for lobe in found.lobes):
        print_warning(f"{name}: echoes from the directions of grating lobes look like the focus")


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm" if length_m < float("inf") else "none"


def print_replay(folder: Path, index: int, found: Replay) -> None:
    """Print how a sample that was made again differs from the stored one, and raise if it does."""
    if found.stored_in is None:
        print_warning(f"sample {index} is not in {folder}: there was nothing to compare with")
    elif not found.differences:
        print_line(f"sample {index}: the same bits as in {folder / found.stored_in}")
    else:
        for line in found.made_otherwise:
            print_warning(f"made otherwise then: {line}")
        print_text("\n".join(found.differences))
        count = counted(len(found.differences), "difference")
        raise ClradarError(f"sample {index}: {count} to that in {folder / found.stored_in}")
