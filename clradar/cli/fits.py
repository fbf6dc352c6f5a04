"""The folders of `register` and `fit-hand`, and what these and `diagnose` print."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.comparison import Comparison, simulated_surface
from clradar.cli.console import counted, print_line, print_table, progress_bar
from clradar.cli.inputs import Measurement
from clradar.cli.options.common import SearchOptions, UnitOptions
from clradar.cli.options.groups import option, recorded, wrong_usage
from clradar.cli.options.scene import ESTIMATORS, PHYSICAL, Estimator, SamplingOptions
from clradar.cli.outputs import save, save_mesh
from clradar.cli.parse import FIT, alpha_or_fit
from clradar.errors import ClradarWarning
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import Diagnosis, HandFit, Hypothesis, Registration, Round

PLACED, CAPTURE, VOLUME = "placed.ply", "capture.h5", "volume.h5"
FIGURE, METRICS = "comparison.png", "metrics.json"
TRANSFORM = "transform.json"
POSE, HAND_FIT, OVERLAY = "pose.toml", "fit.json", "overlay.png"

FILES = (PLACED, TRANSFORM, CAPTURE, VOLUME, FIGURE, METRICS)
HAND_FILES = (POSE, PLACED, HAND_FIT, OVERLAY, FIGURE, METRICS, CAPTURE, VOLUME)


@dataclass(frozen=True, kw_only=True)
class RegistrationOptions(UnitOptions, SamplingOptions, SearchOptions):
    """Search and simulations of a registration."""

    estimator: Estimator | None = option(
        f"{ESTIMATORS} [default: stochastic, or physical with --material]"
    )
    alpha: str = option(
        "0 specular to 1 diffuse, or fit: as the brightness falls with the angle.",
        FIT,
        metavar="ALPHA|fit",
    )
    seed: int = option("Of the first round; counts up from there.", 0, metavar="N")
    max_rounds: int = option(
        "Simulations at most: 7 or more with --alpha fit, 2 or more without.", 10, metavar="N"
    )

    def alpha_value(self) -> float | None:
        """The number, or None for `fit` and where materials take its place."""
        if self.estimator == PHYSICAL and self.alpha != FIT:
            raise wrong_usage("--alpha", f"--estimator {PHYSICAL} knows --material, no alpha")
        return alpha_or_fit(self.alpha)


def registered(
    measured: Measurement, scene: cl.Scene, options: RegistrationOptions, device: cl.Device
) -> Registration:
    """Register the mesh, and show each round as it is done."""
    from calibration import register

    settings = recorded(options)
    del settings["unit"], settings["alpha"]
    fit_alpha = options.alpha == FIT and options.estimator != PHYSICAL
    done: list[Round] = []

    def show(step: Round) -> None:
        done.append(step)
        alpha = "" if step.alpha is None else f"alpha {step.alpha:.2f}, "
        print_line(f"round {len(done)}: {alpha}moved by {1e3 * step.moved_m:.2f} mm")

    with progress_bar("registering") as progress:
        return register(
            measured.volume, scene, fit_alpha=fit_alpha, device=device, progress=progress,
            callback=show if progress is None else None, **settings, **measured.radar,
        )  # fmt: skip


def write_registration(
    folder: Path, measured: Measurement, result: Registration, origin: dict[str, Any]
) -> None:
    """Write all files of a registration into `folder`."""
    rounds = [
        {"transform": r.transform.tolist(), "alpha": r.alpha, "moved_m": r.moved_m}
        for r in result.rounds
    ]
    record = {**result.alignment.to_dict(), "rounds": rounds, **origin}
    write_json(folder / TRANSFORM, record, force=False)
    alpha = result.rounds[-1].alpha
    label = "Simulated"
    if alpha is not None:
        label += f", \N{GREEK SMALL LETTER ALPHA} = {alpha:.2f}"
    elif result.capture.meta["settings"]["estimator"] == PHYSICAL:
        label += f", {simulated_surface(result.capture.meta)}"
    compared = Comparison.of([measured.volume, result.volume], [label])
    metrics = {"alpha": alpha, "simulated": compared.records([Path(VOLUME)])}
    simulated = (result.scene, result.capture, result.volume)
    _write_simulation(folder, measured, simulated, compared, metrics, origin)


def _write_simulation(
    folder: Path,
    measured: Measurement,
    simulated: tuple[cl.Scene, cl.Capture, cl.Volume],
    compared: Comparison,
    metrics: Mapping[str, Any],
    origin: Mapping[str, Any],
) -> None:
    """Write the placed mesh, its simulation, and both compared with the measurement."""
    scene, capture, volume = simulated
    save_mesh(folder / PLACED, scene, force=False)
    save(folder / CAPTURE, capture, origin, force=False)
    save(folder / VOLUME, volume, origin, force=False)
    compared.save_figure(folder / FIGURE, force=False, differences=True)
    record = {"measured": str(measured.path), **metrics, **origin}
    write_json(folder / METRICS, record, force=False)
    compared.print()


def write_hand_fit(
    folder: Path,
    measured: Measurement,
    fit: HandFit,
    seed: int,
    device: cl.Device,
    origin: dict[str, Any],
) -> None:
    """Write all files of a fit into `folder`; the hand before and after is simulated for them."""
    from calibration.hand_fit.figure import hand_fit_figure
    from calibration.registration.radar import Radar
    from clradar.hand import write_pose
    from clradar.plot import save_figure

    used = Radar.of("fit_hand", measured.radar.get("array"), measured.radar.get("waveform"))

    def imaged(scene: cl.Scene) -> tuple[cl.Capture, cl.Volume]:
        with progress_bar("simulating") as progress:
            capture = cl.simulate(
                scene, used.array, used.waveform, seed=seed, device=device, progress=progress
            )
        grid = measured.volume.grid
        return capture, cl.backproject(capture, grid, check_grid=False, device=device)

    before, (capture, after) = imaged(fit.started)[1], imaged(fit.scene)
    name, source = f"{fit.pose.name}, fitted to {measured.path.name}", str(measured.path)
    write_pose(folder / POSE, replace(fit.pose, name=name, description="", source=source))
    write_json(folder / HAND_FIT, {**fit.to_dict(), **origin}, force=False)
    with progress_bar("drawing"):
        save_figure(hand_fit_figure(measured.volume, fit), folder / OVERLAY)
    labels = [f"Before: '{fit.start}', moved", "After"]
    if (surface := simulated_surface(after.meta)) is not None:
        labels[1] += f", {surface}"
    with warnings.catch_warnings():
        # That the start is another pose is no news; the table has what differs.
        warnings.simplefilter("ignore", ClradarWarning)
        compared = Comparison.of([measured.volume, before, after], labels)
    metrics = dict(zip(("before", "after"), (m.to_dict() for m in compared.metrics), strict=True))
    _write_simulation(folder, measured, (fit.scene, capture, after), compared, metrics, origin)


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
        prefixes = (f"{digit}-finger-", f"{digit}-")
        untold = [n.removeprefix(prefixes[0]).removeprefix(prefixes[1]) for n in names
                  if n in fit.untold]  # fmt: skip
        if digit in DIGITS:
            number = DIGITS.index(digit)
            at_m, std_m = fit.tips_m[number], fit.tip_std_m[number]
            if np.isfinite(at_m).all():
                place = ", ".join(f"{1e3 * v:.1f}" for v in at_m)
                where = [place, f"{1e3 * std_m:.1f}", "yes" if fit.told_tips[number] else "no"]
        told = f"{np.count_nonzero(fit.told_angles[angles])} of {len(names)}"
        rows.append([digit, *where, told, ", ".join(untold)])
    return rows


SCORE_COLUMNS = ("axes", "phase", "frequencies", "sharpness (dB)", "brightest at x, y, z (mm)", "")


def print_scores(result: Diagnosis) -> None:
    """Print one row per hypothesis, the sharpest first."""
    rows = []
    for score in sorted(result.scores, key=lambda s: -np.nan_to_num(s.relative_db, nan=-np.inf)):
        h, place = score.hypothesis, "n/a"
        if score.image is not None:
            place = ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)
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
    """A level for a table."""
    if math.isnan(relative_db):
        return "n/a"
    return f"{relative_db:.1f}" if relative_db > -100 else "< -100"
