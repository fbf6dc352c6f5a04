"""Figure of a channel calibration: gain, phase and delay of each channel."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from clradar.model import ChannelCalibration, checks
from clradar.plot.drawing import TICK_PT, label_axes, new_figure

COLOURS = {"live": "#1f5c99", "noisy": "#d98a00", "dead": "#b3261e"}


def channels_figure(channels: ChannelCalibration, title: str | None = None) -> Figure:
    """Draw gain (dB), phase (degrees) and delay (ps) of every channel, Tx to the left, Rx right.

    Bars are one standard deviation of phase and delay.
    """
    checks.instance("channels_figure: channels", channels, ChannelCalibration)
    figure = new_figure(8.0, 6.0, title, dpi=200)
    grid = figure.subplots(3, 2, sharex="col", sharey="row")
    response = channels.response
    for column, side in enumerate(("tx", "rx")):
        gain, delay_s = (getattr(response, f"{side}_{name}") for name in ("gain", "delay_s"))
        of = {name: getattr(channels, f"{name}_{side}") for name in ("dead", "noisy")}
        of["live"] = np.setdiff1d(np.flatnonzero(gain != 0), of["noisy"])
        level_db = 20 * np.log10(np.abs(np.where(gain != 0, gain, 1.0)))
        phase_std = np.degrees(getattr(channels, f"{side}_phase_std_rad"))
        delay_std_ps = 1e12 * getattr(channels, f"{side}_delay_std_s")
        rows = (
            ("gain (dB)", level_db, 0 * phase_std),
            ("phase (degrees)", np.degrees(np.angle(gain)), phase_std),
            ("delay (ps)", 1e12 * delay_s, delay_std_ps),
        )
        for row, (axes, (name, values, std)) in enumerate(zip(grid[:, column], rows, strict=True)):
            for number, at in enumerate(of["dead"]):
                label = None if number else "dead"
                axes.axvline(at, color=COLOURS["dead"], linewidth=0.8, label=label)
            for state in ("live", "noisy"):
                if (own := of[state]).size:
                    axes.errorbar(
                        own, values[own], std[own], fmt=".", color=COLOURS[state], markersize=4,
                        elinewidth=0.6, label=state,
                    )  # fmt: skip
            counts = f"{gain.size} {side.title()}: {of['dead'].size} dead, {of['noisy'].size} noisy"
            below = f"{side.title()} channel" if row == 2 else ""
            label_axes(axes, below, "" if column else name, "" if row else counts)
        if of["dead"].size or of["noisy"].size:
            grid[0, column].legend(fontsize=TICK_PT)
    return figure
