"""Figure of a channel calibration: gain, phase and delay of each channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clradar.model import ChannelCalibration, checks
from clradar.plot.layout import LABEL_PT, TICK_PT, label_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIVE_COLOUR, NOISY_COLOUR, DEAD_COLOUR = "#1f5c99", "#d98a00", "#b3261e"


def channels_figure(channels: ChannelCalibration, title: str | None = None) -> Figure:
    """Draw gain, phase and delay of every channel, Tx to the left and Rx to the right.

    Parameters
    ----------
    channels : ChannelCalibration
    title : str, optional
        Plain text.

    Returns
    -------
    matplotlib.figure.Figure
        Axes row by row: gain in dB, phase in degrees, delay in ps; Tx, then Rx. Bars are one
        standard deviation of phase and delay.
    """
    from matplotlib.figure import Figure

    checks.instance("channels_figure: channels", channels, ChannelCalibration)
    figure = Figure(figsize=(8.0, 6.0), dpi=200, facecolor="white", layout="constrained")
    grid = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, side in enumerate(("tx", "rx")):
        gain = getattr(channels.response, f"{side}_gain")
        dead, noisy = (getattr(channels, f"{state}_{side}") for state in ("dead", "noisy"))
        live = np.flatnonzero(gain != 0)
        loud = np.isin(live, noisy)
        phase_std, delay_std = (
            getattr(channels, f"{side}_{name}")[live] for name in ("phase_std_rad", "delay_std_s")
        )
        rows = (
            ("gain (dB)", 20 * np.log10(np.abs(gain[live])), 0 * phase_std),
            ("phase (degrees)", np.degrees(np.angle(gain[live])), np.degrees(phase_std)),
            ("delay (ps)", 1e12 * getattr(channels.response, f"{side}_delay_s")[live],
             1e12 * delay_std),
        )  # fmt: skip
        counts = (f"{gain.size} {side.title()}: {dead.size} dead, {noisy.size} noisy", "", "")
        names = ("", "", f"{side.title()} channel")
        for axes, (name, values, std), count, x_name in zip(
            grid[:, column], rows, counts, names, strict=True
        ):
            for at in dead:
                axes.axvline(at, color=DEAD_COLOUR, linewidth=0.8, label="dead")
            for chosen, colour, state in (
                (~loud, LIVE_COLOUR, "live"),
                (loud, NOISY_COLOUR, "noisy"),
            ):
                if chosen.any():
                    axes.errorbar(live[chosen], values[chosen], std[chosen], fmt=".", color=colour,
                                  markersize=4, elinewidth=0.6, label=state)  # fmt: skip
            label_axes(axes, x_name, name if column == 0 else "", count)
        if dead.size or noisy.size:
            shown = dict(zip(*grid[0, column].get_legend_handles_labels()[::-1], strict=True))
            grid[0, column].legend(shown.values(), shown.keys(), fontsize=TICK_PT)
    if title is not None:
        # A title can be a file name, and a dollar sign in it is not mathematics.
        figure.suptitle(title, fontsize=LABEL_PT + 1, fontweight="bold", parse_math=False)
    return figure
