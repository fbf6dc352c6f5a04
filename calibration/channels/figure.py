"""Figure of a channel calibration: gain, phase and delay of each channel."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from clradar.model import ChannelCalibration, checks
from clradar.plot.drawing import TICK_PT, label_axes, new_figure

LIVE_COLOUR, NOISY_COLOUR, DEAD_COLOUR = "#1f5c99", "#d98a00", "#b3261e"


def channels_figure(channels: ChannelCalibration, title: str | None = None) -> Figure:
    """Draw gain (dB), phase (degrees) and delay (ps) of every channel, Tx to the left, Rx right.

    Bars are one standard deviation of phase and delay.
    """
    checks.instance("channels_figure: channels", channels, ChannelCalibration)
    figure = new_figure(8.0, 6.0, title, dpi=200)
    grid = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, side in enumerate(("tx", "rx")):
        response = channels.response
        gain, delay_s = (getattr(response, f"{side}_{name}") for name in ("gain", "delay_s"))
        dead, noisy = (getattr(channels, f"{state}_{side}") for state in ("dead", "noisy"))
        live = np.setdiff1d(np.flatnonzero(gain != 0), noisy)
        level_db = 20 * np.log10(np.abs(np.where(gain != 0, gain, 1.0)))
        phase_std, delay_std_s = (
            getattr(channels, f"{side}_{name}") for name in ("phase_std_rad", "delay_std_s")
        )
        rows = (
            ("gain (dB)", level_db, 0 * phase_std),
            ("phase (degrees)", np.degrees(np.angle(gain)), np.degrees(phase_std)),
            ("delay (ps)", 1e12 * delay_s, 1e12 * delay_std_s),
        )
        counts = f"{gain.size} {side.title()}: {dead.size} dead, {noisy.size} noisy"
        for axes, (name, values, std) in zip(grid[:, column], rows, strict=True):
            for at in dead:
                axes.axvline(at, color=DEAD_COLOUR, linewidth=0.8, label="dead")
            shown = ((live, LIVE_COLOUR, "live"), (noisy, NOISY_COLOUR, "noisy"))
            for chosen, colour, state in shown:
                axes.errorbar(
                    chosen, values[chosen], std[chosen], fmt=".", color=colour, markersize=4,
                    elinewidth=0.6, label=state if chosen.size else None,
                )  # fmt: skip
            label_axes(axes, "", name if column == 0 else "")
        label_axes(axes, f"{side.title()} channel", axes.get_ylabel())
        label_axes(grid[0, column], "", grid[0, column].get_ylabel(), counts)
        if dead.size or noisy.size:
            legend = dict(zip(*grid[0, column].get_legend_handles_labels()[::-1], strict=True))
            grid[0, column].legend(legend.values(), legend.keys(), fontsize=TICK_PT)
    return figure
