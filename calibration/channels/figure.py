"""Figure of a channel calibration: gain, phase and delay of each channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clradar.model import ChannelCalibration, checks
from clradar.plot.layout import LABEL_PT, label_axes

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
        Axes row by row: gain in dB, phase in degrees, delay in ps; Tx, then Rx. Noisy channels have
        another colour, dead ones are vertical lines.
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
        rows = (
            ("gain (dB)", 20 * np.log10(np.abs(gain[live]))),
            ("phase (degrees)", np.degrees(np.angle(gain[live]))),
            ("delay (ps)", 1e12 * getattr(channels.response, f"{side}_delay_s")[live]),
        )
        counts = (f"{gain.size} {side.title()}: {dead.size} dead, {noisy.size} noisy", "", "")
        names = ("", "", f"{side.title()} channel")
        for axes, (name, values), count, x_name in zip(
            grid[:, column], rows, counts, names, strict=True
        ):
            for at in dead:
                axes.axvline(at, color=DEAD_COLOUR, linewidth=0.8)
            for chosen, colour in ((~loud, LIVE_COLOUR), (loud, NOISY_COLOUR)):
                axes.plot(live[chosen], values[chosen], ".", color=colour, markersize=4)
            label_axes(axes, x_name, name if column == 0 else "", count)
        grid[1, column].set_yticks(range(-180, 181, 90))
    if title is not None:
        # A title can be a file name, and a dollar sign in it is not mathematics.
        figure.suptitle(title, fontsize=LABEL_PT + 1, fontweight="bold", parse_math=False)
    return figure
