"""Figures of captures as they are, without an image: echoes over range, and levels of channels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import CompareError
from clradar.model import Capture, checks
from clradar.model.length_unit import unit_for
from clradar.model.progress import Progress
from clradar.model.range_profile import PROFILE_PAIRS, RangeProfile, antenna_subset, range_profile
from clradar.plot.layout import label_axes, new_figure
from clradar.plot.panels import BELOW_MAXIMUM, CURVE_COLOURS, add_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_INCHES, DPI = (8.0, 3.2), 200
SHOWN_DB = 60.0
"""Of echoes below the strongest, which is the coupling between antennas where that is recorded."""
PAIRS_DB = 30.0
"""Of levels of channels below the strongest one."""


def capture_figure(capture: Capture, title: str | None = None) -> Figure:
    """Draw what is in a capture without forming an image.

    Axes in this order: mean power over range, half of the path length, dB below its maximum (not of
    a single frequency); RMS level of every pair of antennas; its colour bar.
    """
    from matplotlib.ticker import MaxNLocator

    checks.instance("capture_figure: capture", capture, Capture)
    if not capture.data.any():
        raise CompareError("capture_figure: expected samples to draw, got zeros")
    ranged = capture.waveform.n_freq > 1
    figure, panels = _panels(title, 2 if ranged else 1)
    if ranged:
        profile = range_profile(capture)
        unit = unit_for(profile.path_m[-1] / 2)
        ranges = unit.per_m * profile.path_m / 2
        level_db = _level_db(profile.power)
        panels[0].plot(ranges, level_db, color=CURVE_COLOURS[0], linewidth=0.9)
        panels[0].set(xlim=(0, _reach(ranges, level_db)), ylim=(-SHOWN_DB, 2))
        x_name = f"half path length ({unit.name})"
        label_axes(panels[0], x_name, BELOW_MAXIMUM, "Echoes, mean power of all pairs")
    power = np.asarray(np.mean(np.abs(capture.data) ** 2, axis=2, dtype=np.float64))
    drawn = panels[-1].imshow(
        _level_db(power), origin="lower", aspect="auto", vmin=-PAIRS_DB, vmax=0, cmap="viridis"
    )
    for axis in (panels[-1].xaxis, panels[-1].yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    label_axes(panels[-1], "Rx", "Tx", "Level of every pair", grid=False)
    add_bar(panels[-1:], drawn, BELOW_MAXIMUM, "min")
    return figure


def _reach(ranges: np.ndarray, level_db: np.ndarray) -> float:
    """Return where the axis of ranges ends: twice as far as the last that is shown."""
    return float(min(ranges[-1], 2 * ranges[np.flatnonzero(level_db > -SHOWN_DB)[-1]]))


def recording_figure(
    captures: Iterable[Capture],
    frames: Sequence[int],
    title: str | None = None,
    *,
    progress: Progress | None = None,
) -> Figure:
    """Draw the echoes of a recording over range and time, without forming images.

    `captures` are the frames, one in memory at a time, `frames` their numbers. Axes in this order:
    power over range for every frame, from some of the pairs, dB below the maximum of all frames
    (not of a single frequency); RMS level of every frame; the colour bar of the first.
    """
    profiles: list[RangeProfile] = []
    levels = []
    for done, capture in enumerate(checks.several("recording_figure: captures", captures), 1):
        levels.append(float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64)))
        if capture.waveform.n_freq > 1:
            profiles.append(range_profile(antenna_subset(capture, PROFILE_PAIRS)))
        if progress is not None:
            progress(done, len(frames))
    if not any(levels):
        raise CompareError("recording_figure: expected samples to draw, got zeros")
    figure, panels = _panels(title, 2 if profiles else 1)
    if profiles:
        power = np.array([profile.power for profile in profiles])
        unit = unit_for(profiles[0].path_m[-1] / 2)
        places = unit.per_m * profiles[0].path_m / 2
        drawn = panels[0].pcolormesh(
            frames, places, _level_db(power).T, vmin=-SHOWN_DB, vmax=0, cmap="viridis",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        y_name = f"half path length ({unit.name})"
        panels[0].set_ylim(0, _reach(places, _level_db(power).max(axis=0)))
        label_axes(panels[0], "frame", y_name, "Echoes of every frame", grid=False)
        add_bar(panels[:1], drawn, BELOW_MAXIMUM, "min")
    panels[-1].plot(
        frames, _level_db(np.array(levels)), ".-",
        color=CURVE_COLOURS[0], linewidth=0.9, markersize=4,
    )  # fmt: skip
    label_axes(panels[-1], "frame", "RMS below maximum (dB)", "Level of every frame")
    for panel in panels:
        panel.xaxis.get_major_locator().set_params(integer=True)
    return figure


def _panels(title: str | None, count: int) -> tuple[Figure, list[Any]]:
    figure = new_figure(*SIZE_INCHES, title, DPI)
    return figure, figure.subplots(1, count, squeeze=False)[0].tolist()


def _level_db(power: np.ndarray) -> np.ndarray:
    """Decibel below the maximum; what is zero is far below what is shown."""
    return np.asarray(10 * np.log10(np.maximum(power / power.max(), 1e-20)))
