"""Figures of a hand that was fitted to the frames of a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.hand_fit.figure import BONES, OTHERS, bones_between
from calibration.hand_fit.frame_fit import SEARCHED, FrameFit
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, FITTED_ANGLES, angles_of
from calibration.hand_fit.result import DIGITS, end_joints
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.plot.drawing import CURVE_COLOURS, LABEL_PT, TICK_PT, TITLE_PT

MOST_PANELS, COLUMNS = 48, 8


Picture = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Amplitude relative to the maximum, (n_y, n_x), and its axes in metres."""


def movement_figure(fits: Sequence[FrameFit], title: str) -> Figure:
    """Draw joint angles and tips of fits over time.

    One row per digit: its angles, and the position of its tip relative to the wrist (of its last
    joint where a rig has no tip); bands are one standard deviation. Dotted lines: frames that were
    searched for.
    """
    figure = Figure(figsize=(10.0, 1.7 * len(DIGITS) + 0.6), facecolor="white")
    panels = figure.subplots(len(DIGITS), 2, sharex=True, squeeze=False)
    seen = [fit for fit in fits if fit.state is not None]
    time_s = np.array([fit.time_s for fit in seen])
    angles = np.degrees([angles_of(fit.state.pose) for fit in seen if fit.state is not None])
    angle_std = np.degrees([fit.angle_std_rad for fit in seen])
    ends = [end_joints(fit.joints_m) for fit in seen]
    tips_mm = 1e3 * np.array(
        [fit.joints_m[own] - fit.joints_m[0] for fit, own in zip(seen, ends, strict=True)]
    )
    tip_std_mm = 1e3 * np.array([fit.joint_std_m[own] for fit, own in zip(seen, ends, strict=True)])
    for row, digit in enumerate(DIGITS):
        left, right = panels[row]
        own = range(len(FITTED_ANGLES))[ANGLES_OF_DIGIT[digit]]
        for colour, k in zip(CURVE_COLOURS, own, strict=False):
            joint, angle = FITTED_ANGLES[k]
            name = joint.removeprefix(f"{digit}-").removeprefix("finger-").removeprefix("phalanx-")
            _draw(left, time_s, angles[:, k], angle_std[:, k], colour, f"{name} {angle}")
        for axis, name in enumerate("xyz"):
            std = tip_std_mm[:, row]
            _draw(right, time_s, tips_mm[:, row, axis], std, CURVE_COLOURS[axis], name)
        left.set_ylabel(f"{digit}\ndegrees", fontsize=LABEL_PT)
        right.set_ylabel("mm from the wrist", fontsize=LABEL_PT)
        for axes in (left, right):
            axes.legend(
                loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TICK_PT, frameon=False
            )
            axes.tick_params(labelsize=TICK_PT)
            for fit in fits:
                if fit.how == SEARCHED:
                    axes.axvline(fit.time_s, color="0.6", linestyle=":", linewidth=0.8)
    for axes in panels[-1]:
        axes.set_xlabel("time in s", fontsize=LABEL_PT)
    figure.suptitle(title, fontsize=TITLE_PT)
    figure.subplots_adjust(left=0.07, right=0.92, bottom=0.06, top=0.95, wspace=0.62, hspace=0.12)
    return figure


def _draw(
    axes: Axes, x: np.ndarray, y: np.ndarray, std: np.ndarray, colour: str, label: str
) -> None:
    axes.plot(x, y, color=colour, linewidth=1.0, marker=".", markersize=3.0, label=label)
    axes.fill_between(x, y - std, y + std, color=colour, alpha=0.2, linewidth=0.0)


def shown_frames(n: int) -> list[int]:
    """Which of n frames a contact sheet shows, spread evenly."""
    return [round(at) for at in np.linspace(0, n - 1, min(MOST_PANELS, n)).tolist()]


def movement_sheet(fits: Sequence[FrameFit], pictures: Sequence[Picture | None]) -> Figure:
    """Draw frames side by side, each with the bones of its fit.

    Pictures are (amplitude, x_m, y_m), None where a frame could not be imaged; they are drawn as
    the radar sees the hand, x to the left. A red title: searched for, or no hand.
    """
    columns = min(COLUMNS, len(fits))
    rows = -(-len(fits) // columns)
    figure = Figure(figsize=(1.25 * columns, 1.45 * rows), facecolor="white")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, fit, picture in zip(grid, fits, pictures, strict=False):
        if picture is not None:
            amplitude, x_m, y_m = picture
            shown_db = 20.0 * np.log10(np.maximum(amplitude, 1e-6))
            edges = (x_m[0], x_m[-1], y_m[0], y_m[-1])
            axes.imshow(
                shown_db, extent=edges, origin="lower", cmap="magma", vmin=-DYNAMIC_RANGE_DB, vmax=0
            )
            axes.set_xlim(edges[1], edges[0])
            axes.set_ylim(edges[2], edges[3])
        if fit.state is not None:
            for begin, end in bones_between(fit.joints_m):
                axes.plot(*fit.joints_m[[begin, end], :2].T, color=BONES, linewidth=0.9)
        colour = "black" if fit.how not in (SEARCHED,) and fit.state is not None else OTHERS
        axes.set_title(f"{fit.frame}, {fit.how}", fontsize=TICK_PT, pad=2, color=colour)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.95, wspace=0.04, hspace=0.16)
    return figure
