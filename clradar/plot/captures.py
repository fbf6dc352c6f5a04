"""Figures of captures as they are, without an image: echoes over range, and levels of channels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import CompareError
from clradar.model import Capture, checks
from clradar.model.length_unit import unit_for
from clradar.model.progress import Progress
from clradar.model.range_profile import (
    PROFILE_PAIRS,
    RangeProfile,
    antenna_subset,
    range_profile,
)
from clradar.plot.layout import LABEL_PT, TICK_PT, TITLE_PT, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_INCHES, DPI = (8.0, 3.2), 200
SHOWN_DB = 60.0
"""Of echoes below the strongest, which is the coupling between antennas where that is recorded."""
PAIRS_DB = 30.0
"""Of levels of channels below the strongest one."""


def capture_figure(capture: Capture, title: str | None = None) -> Figure:
    """Draw what is in a capture without forming an image.

    Parameters
    ----------
    capture : Capture
    title : str, optional
        Plain text above all panels.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: power over range, the mean of all pairs, dB below its maximum (not of a
        single frequency); RMS level of every pair of antennas, dB below the strongest; its colour
        bar. Range is half of the path length.

    Raises
    ------
    CompareError
        All samples are zero.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.plot import capture_figure
    >>> array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab")
    >>> waveform = clradar.Waveform([76e9, 77e9, 78e9])
    >>> capture = clradar.Capture(np.ones((2, 1, 3), np.complex64), array, waveform)
    >>> len(capture_figure(capture).axes)
    3
    """
    from matplotlib.ticker import MaxNLocator

    checks.instance("capture_figure: capture", capture, Capture)
    _check_not_zero(capture, "capture_figure")
    figure = _figure(title)
    ranged = capture.waveform.n_freq > 1
    panels = figure.subplots(1, 2 if ranged else 1, squeeze=False)[0]
    if ranged:
        profile = range_profile(capture)
        unit = unit_for(profile.path_m[-1] / 2)
        ranges = unit.per_m * profile.path_m / 2
        panels[0].plot(ranges, _level_db(profile.power), linewidth=0.9)
        panels[0].set_xlim(0, ranges[-1])
        panels[0].set_ylim(-SHOWN_DB, 2)
        panels[0].grid(linewidth=0.3)
        _label(
            panels[0],
            "Echoes, mean of all pairs",
            f"half path length ({unit.name})",
            "power below maximum (dB)",
        )
    power = np.asarray(np.mean(np.abs(capture.data) ** 2, axis=2, dtype=np.float64))
    drawn = panels[-1].imshow(
        _level_db(power), origin="lower", aspect="auto", vmin=-PAIRS_DB, vmax=0, cmap="viridis"
    )
    for axis in (panels[-1].xaxis, panels[-1].yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    _label(panels[-1], "Level of every pair", "Rx", "Tx")
    _bar(figure, drawn, panels[-1])
    return figure


def recording_figure(
    captures: Iterable[Capture],
    frames: Sequence[int],
    title: str | None = None,
    *,
    progress: Progress | None = None,
) -> Figure:
    """Draw the echoes of a recording over range and time, without forming images.

    Parameters
    ----------
    captures : iterable of Capture
        The frames, one in memory at a time; all with one waveform.
    frames : sequence of int
        Their numbers.
    title : str, optional
        Plain text above all panels.
    progress : callable, optional
        Called with (frames done, frames).

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: power over range for every frame, from some of the pairs, dB below the
        maximum of all frames (not of a single frequency); RMS level of every frame, dB below the
        strongest; the colour bar of the first.

    Raises
    ------
    CompareError
        All samples are zero.
    """
    profiles: list[RangeProfile] = []
    levels = []
    for done, capture in enumerate(captures, start=1):
        levels.append(float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64)))
        if capture.waveform.n_freq > 1:
            profiles.append(range_profile(antenna_subset(capture, PROFILE_PAIRS)))
        if progress is not None:
            progress(done, len(frames))
    if not any(levels):
        raise CompareError("recording_figure: expected samples to draw, got zeros")
    figure = _figure(title)
    panels = figure.subplots(1, 2 if profiles else 1, squeeze=False)[0]
    if profiles:
        power = np.array([profile.power for profile in profiles])
        unit = unit_for(profiles[0].path_m[-1] / 2)
        places = unit.per_m * profiles[0].path_m / 2
        drawn = panels[0].pcolormesh(
            frames, places, _level_db(power).T, vmin=-SHOWN_DB, vmax=0, cmap="viridis",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        _label(panels[0], "Echoes of every frame", "frame", f"half path length ({unit.name})")
        _bar(figure, drawn, panels[0])
    panels[-1].plot(frames, _level_db(np.array(levels)), ".-", linewidth=0.9, markersize=4)
    panels[-1].grid(linewidth=0.3)
    _label(panels[-1], "Level of every frame", "frame", "RMS below maximum (dB)")
    for panel in panels:
        panel.xaxis.get_major_locator().set_params(integer=True)
    return figure


def _figure(title: str | None) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCHES, dpi=DPI, facecolor="white", layout="constrained")
    if title is not None:
        figure.suptitle(printable(title), fontsize=TITLE_PT, fontweight="bold", parse_math=False)
    return figure


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=LABEL_PT)
    axes.set_xlabel(x, fontsize=LABEL_PT)
    axes.set_ylabel(y, fontsize=LABEL_PT)
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6)


def _bar(figure: Figure, drawn: Any, panel: Axes) -> None:
    bar = figure.colorbar(drawn, ax=panel, extend="min")
    bar.set_label("below maximum (dB)", fontsize=LABEL_PT)
    bar.ax.tick_params(labelsize=TICK_PT, length=2.5, width=0.6)


def _level_db(power: np.ndarray) -> np.ndarray:
    """Decibel below the maximum; what is zero is far below what is shown."""
    return np.asarray(10 * np.log10(np.maximum(power / power.max(), 1e-20)))


def _check_not_zero(capture: Capture, where: str) -> None:
    if not capture.data.any():
        raise CompareError(f"{where}: expected samples to draw, got zeros")
