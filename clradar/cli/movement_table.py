"""Tables of a hand that was fitted to frames: the file with all, and what is printed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_line, print_table
from clradar.cli.sweep_folder import write_csv

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit

ABOUT = ("frame", "time s", "how", "notes")
"""Columns that are no numbers of the hand."""


def write_movement_table(path: Path, fits: Sequence[FrameFit]) -> None:
    """Write one row per frame: time, tips in millimetres, angles in degrees, shape."""
    write_csv(path, _columns(), map(_row, fits))


def _columns() -> list[str]:
    """Names of the columns of the table."""
    from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    tips = [f"{digit} tip {axis} mm" for digit in DIGITS for axis in (*"xyz", "sd")]
    angles = [f"{name} {what}" for name in ANGLE_NAMES for what in ("deg", "sd deg")]
    shape = ["length mm", "breadth mm", *SHAPE_NAMES[2:]]
    return ["frame", "time s", "how", "misfit per cell", "notes", *tips, *angles, *shape]


def _row(fit: FrameFit) -> list[Any]:
    """One row per frame; cells of frames without a hand are empty."""
    from calibration.hand_fit.hand_state import angles_of

    about = [fit.frame, fit.time_s, fit.how]
    if fit.state is None:
        return [*about, "", "; ".join(fit.notes)]
    columns = np.column_stack([fit.tips_m, fit.tip_std_m])
    angles = np.degrees(np.column_stack([angles_of(fit.state.pose), fit.angle_std_rad]))
    shape = fit.state.shape
    return [
        *about,
        round(fit.misfit_per_cell, 4),
        "; ".join(fit.notes),
        *("" if np.isnan(value) else round(value, 3) for value in (1e3 * columns).ravel().tolist()),
        *(round(value, 3) for value in angles.ravel().tolist()),
        *(round(1e3 * value, 2) for value in (shape.length_m, shape.breadth_m)),
        *(round(value, 4) for value in (*shape.finger_lengths, shape.girth)),
    ]


def hand_columns(fits: Sequence[FrameFit | None]) -> dict[str, np.ndarray]:
    """The columns of numbers, each of shape (n,), float64; NaN where there is no hand."""
    names = _columns()
    kept = [i for i, name in enumerate(names) if name not in ABOUT]
    values = np.full((len(fits), len(kept)), np.nan)
    for row, fit in zip(values, fits, strict=True):
        if fit is not None and fit.state is not None:
            cells = _row(fit)
            row[:] = [np.nan if cells[i] == "" else cells[i] for i in kept]
    return {f"hand {names[i]}": values[:, j] for j, i in enumerate(kept)}


def print_sequence(folder: Path, fits: Sequence[FrameFit]) -> None:
    """Print a line for each frame that was searched for or has no hand, and a summary."""
    from calibration.hand_fit.frame_fit import FOLLOWED

    rows = [
        [str(fit.frame), f"{fit.time_s:.3f}", fit.how, "; ".join(fit.notes)]
        for fit in fits
        if fit.how != FOLLOWED or fit.notes
    ]
    print_table(("frame", "time (s)", "how", "why"), rows, right=("frame", "time (s)"))
    followed = sum(fit.how == FOLLOWED for fit in fits)
    lost = sum(fit.state is None for fit in fits)
    words = f"{len(fits)} frames, {followed} followed, {len(fits) - followed - lost} searched"
    print_line(f"{folder}: {words}" + (f", {lost} without a hand" if lost else ""))
