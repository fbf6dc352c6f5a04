"""Figure of a sweep over roughness: what is likely, and measured and fitted statistics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.roughness.figure import COLOURS
from calibration.roughness.roughness_estimate import RoughnessEstimate
from calibration.roughness.roughness_sweep import RoughnessSweep
from clradar.model import checks
from clradar.plot.layout import LABEL_PT, TICK_PT, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT, RATIOS = 10.9, 3.35, (2.6, 2.4, 3.6)
"""Of the figure and of a row of panels, inches."""

DECIBEL_PER_NATURAL = 10.0 / np.log(10.0)

SHORT_NAMES = (
    ("rest at ", ""),
    (" degrees", "\N{DEGREE SIGN}"),
    (" to ", "\N{EN DASH}"),
    ("coherent power", "coherent"),
    ("correlation of ", ""),
)

DRAWN = 1e-3
"""Share of its maximum down to which a probability is drawn."""


def roughness_figure(sweep: RoughnessSweep) -> Figure:
    """Draw a sweep over roughness.

    Parameters
    ----------
    sweep : RoughnessSweep

    Returns
    -------
    matplotlib.figure.Figure
        One row per region: the probability density of h, with the interval of 68 %; that of h and
        l together, with lines of equal slope; the measured statistics, in decibels, over the mean
        and one standard deviation of simulations at the best h and l.
    """
    checks.instance("roughness_figure: sweep", sweep, RoughnessSweep)
    rows = len(sweep.estimates)
    figure = new_figure(WIDTH, HEIGHT * rows)
    panels = figure.subplots(rows, 3, width_ratios=RATIOS, squeeze=False)
    for number, (one, drawn) in enumerate(zip(sweep.estimates, panels, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        _draw_height(drawn[0], one, colour)
        _draw_pair(drawn[1], one)
        _draw_statistics(drawn[2], one, colour)
    return figure


def _draw_height(axes: Axes, one: RoughnessEstimate, colour: str) -> None:
    height_mm = 1e3 * one.heights_m
    # Per millimetre: the heights are spaced by equal ratios.
    density = one.probability.sum(axis=1) / np.gradient(height_mm)
    axes.plot(height_mm, density, color=colour, linewidth=1.2)
    found = one.roughness_m
    axes.axvspan(1e3 * found.low, 1e3 * found.high, color=colour, alpha=0.2, linewidth=0)
    axes.axvline(1e3 * found.median, color=colour, linewidth=0.8)
    axes.set_ylim(0.0, None)
    _finish(axes, f"{one.name}: {one.text().split(', slope')[0]}", "roughness h (mm)")
    axes.set_ylabel("probability density (1/mm)", fontsize=LABEL_PT)


def _draw_pair(axes: Axes, one: RoughnessEstimate) -> None:
    height_mm, length_mm = 1e3 * one.heights_m, 1e3 * one.lengths_m
    axes.set_xlim(height_mm[0], height_mm[-1])
    if len(length_mm) == 1:
        axes.plot(height_mm, one.probability[:, 0], color=COLOURS[0])
        _finish(axes, f"l = {length_mm[0]:.3g} mm, as given", "roughness h (mm)")
        return
    likely = np.log10(np.maximum(one.probability / one.probability.max(), DRAWN))
    axes.contourf(height_mm, length_mm, likely.T, 12, cmap="cividis")
    for slope in (0.05, 0.1, 0.2, 0.4):
        axes.plot(height_mm, np.sqrt(2) * height_mm / slope, "--", color="white", linewidth=0.6)
        end_mm = min(height_mm[-1], slope * length_mm[-1] / np.sqrt(2))
        at = (0.97 * end_mm, 0.97 * np.sqrt(2) * end_mm / slope)
        axes.annotate(
            f"{slope:g}", at, color="white", fontsize=TICK_PT, ha="right", va="top",
        )  # fmt: skip
    axes.set_ylim(length_mm[0], length_mm[-1])
    axes.set_ylabel("correlation length l (mm)", fontsize=LABEL_PT)
    _finish(axes, "likely pairs; dashed: equal slope", "roughness h (mm)")


def _draw_statistics(axes: Axes, one: RoughnessEstimate, colour: str) -> None:
    of_power = np.array([s.of_power for s in one.statistics])
    # Contrast and correlation are small numbers: ten times them fits the scale.
    scale = np.where(of_power, DECIBEL_PER_NATURAL, 10.0)
    level = np.where(of_power, one.fitted[0], 0.0)
    index = np.arange(len(scale), dtype=float) + 0.5 * ~of_power
    axes.errorbar(
        index, scale * (one.fitted - level), scale * one.spread, fmt="_", color="0.5",
        linewidth=4, alpha=0.6, label="simulations at the best h, l",
    )  # fmt: skip
    axes.plot(index, scale * (one.measured - level), "o", color=colour, label="measurement")
    names = [_short(statistic.name) for statistic in one.statistics]
    axes.set_xticks(index, names, rotation=35, ha="right")
    axes.set_ylabel("dB; contrast, apertures times 10", fontsize=LABEL_PT)
    axes.legend(fontsize=TICK_PT - 0.5, framealpha=0.8)
    _finish(axes, "coherent power, the rest over tilt, texture", "")


def _short(name: str) -> str:
    for long, short in SHORT_NAMES:
        name = name.replace(long, short)
    return name


def _finish(axes: Axes, title: str, x_label: str) -> None:
    axes.set_title(title, fontsize=LABEL_PT, parse_math=False)
    axes.set_xlabel(x_label, fontsize=LABEL_PT, labelpad=2)
    axes.tick_params(labelsize=TICK_PT)
    axes.grid(visible=True, linewidth=0.3)
