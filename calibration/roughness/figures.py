"""Figures of sweeps: images and metrics over alpha, and what is likely of alpha, h and l."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.roughness.emulator import Fit
from calibration.roughness.estimates import RoughnessEstimate
from calibration.roughness.meters import ALIKE, CONTRAST
from calibration.roughness.roughness_sweep import RoughnessSweep
from calibration.roughness.sweep import Sweep
from clradar.compare.metrics import METRIC_TABLE
from clradar.plot import drawing

MOST_IMAGES, IMAGES_IN_ROW = 6, 4  # simulated ones beside the measured one; side by side
ALPHA = "\N{GREEK SMALL LETTER ALPHA}"

COLOURS = (*drawing.CURVE_COLOURS, "#404040")
DECIBEL_PER_NATURAL = 10.0 / np.log(10.0)
DRAWN = 1e-3  # share of its maximum down to which a probability is drawn


def figure_of(result: Sweep | RoughnessSweep) -> Figure:
    """Draw the result of a sweep."""
    return sweep_figure(result) if isinstance(result, Sweep) else roughness_figure(result)


def sweep_figure(sweep: Sweep) -> Figure:
    """Draw a sweep over alpha: docs/sweep.md; bands are from the lowest seed to the highest."""
    chosen = shown_alphas(sweep)
    images = [sweep.measured, *(image for i in chosen if (image := sweep.images[i]) is not None)]
    titles = ["Measurement", *(f"{ALPHA} = {sweep.alphas[i]:g}" for i in chosen)]
    n_rows = -(-len(images) // IMAGES_IN_ROW)
    extent = drawing.Extent.around(images)
    high = n_rows * (drawing.panel_size(1.4, extent.aspect)[1] + 0.6)
    figure = drawing.new_figure(drawing.ROW_WIDTH, high + 5.2)
    halves: Any = figure.subfigures(2, 1, height_ratios=(high, 5.2))
    grid = (n_rows, min(len(images), IMAGES_IN_ROW))
    panels = halves[0].subplots(*grid, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, image, title in zip(panels, images, titles, strict=False):
        left = axes in panels[:: grid[1]]
        drawn = drawing.amplitude(axes, image, extent, title=title, y_labels=left)
    for axes in panels[len(images) :]:
        axes.remove()
    drawing.add_bar(panels[: len(images)], drawn)
    (similarities, lengths), (likely, statistics) = halves[1].subplots(2, 2)
    for axes, scale, title in ((similarities, 1.0, "metrics"), (lengths, 1e3, "metrics (mm)")):
        shown = [one for one in METRIC_TABLE if one.scale == scale]
        for one, colour in zip(shown, COLOURS, strict=False):
            values = scale * sweep.of(one.field)
            there = np.isfinite(values).all(axis=0)
            x, y, label = sweep.alphas[there], values[:, there], one.name.removesuffix(" (mm)")
            axes.plot(x, y.mean(axis=0), ".-", color=colour, label=label, lw=1.2, ms=4)
            axes.fill_between(x, y.min(axis=0), y.max(axis=0), color=colour, alpha=0.25, lw=0)
        drawing.label_axes(axes, ALPHA, "", title)
        _legend(axes)
    for found, colour in zip(sweep.estimates, COLOURS, strict=False):
        peak, label = found.probability / found.probability.max(), f"{found.name}: {found.text()}"
        likely.plot(found.alphas, np.where(peak > DRAWN, peak, np.nan), color=colour, label=label)
        likely.axvspan(found.interval.low, found.interval.high, color=colour, alpha=0.15, lw=0)
    likely.set_xlim(sweep.alphas[0], sweep.alphas[-1])
    drawing.label_axes(likely, ALPHA, "", f"probability of {ALPHA}, its maximum 1")
    _legend(likely)
    _draw_fit(statistics, sweep.estimate.fit, DECIBEL_PER_NATURAL, COLOURS[0])
    drawing.label_axes(statistics, "", "", "statistics of the brightness (dB)")
    return figure


def shown_alphas(sweep: Sweep) -> list[int]:
    """Indices of the alphas whose images are drawn: evenly spread, with the nearest."""
    there = [i for i, image in enumerate(sweep.images) if image is not None]
    if len(there) <= MOST_IMAGES:
        return there
    even = np.linspace(0, len(there) - 1, MOST_IMAGES - 1).round().astype(int)
    return sorted({*(there[i] for i in even), *({sweep.nearest} & {*there})})


def roughness_figure(sweep: RoughnessSweep) -> Figure:
    """Draw a sweep over roughness: of each region h, h and l together, and below statistics."""
    figure = drawing.new_figure(drawing.ROW_WIDTH, 4.8 * len(sweep.estimates))
    rows: Any = figure.subfigures(len(sweep.estimates), 1, squeeze=False)[:, 0]
    for number, (row, one) in enumerate(zip(rows, sweep.estimates, strict=True)):
        high, pair, fit = row.subplot_mosaic("hp;ff").values()
        colour = COLOURS[number % len(COLOURS)]
        height_mm, found = 1e3 * one.heights_m, one.roughness_m
        # Per millimetre: the heights are spaced by equal ratios.
        high.plot(height_mm, one.probability.sum(axis=1) / np.gradient(height_mm), color=colour)
        high.axvspan(1e3 * found.low, 1e3 * found.high, color=colour, alpha=0.2, linewidth=0)
        high.axvline(1e3 * found.median, color=colour, linewidth=0.8)
        high.set_ylim(0.0, None)
        title = f"{one.name}: {one.text().split(', slope')[0]}"
        drawing.label_axes(high, "roughness h (mm)", "probability density (1/mm)", title)
        _draw_pair(pair, one)
        # Contrast and correlation are small numbers: ten times them fits the scale.
        small = np.isin(one.fit.statistics, (CONTRAST, ALIKE))
        scale = np.where(small, 10.0, DECIBEL_PER_NATURAL)
        _draw_fit(fit, one.fit, scale, colour)
        title = "power over tilt, texture"
        drawing.label_axes(fit, "", "dB; contrast, apertures times 10", title)
    return figure


def _draw_pair(axes: Axes, one: RoughnessEstimate) -> None:
    height_mm, length_mm = 1e3 * one.heights_m, 1e3 * one.lengths_m
    axes.set_xlim(height_mm[0], height_mm[-1])
    if len(length_mm) == 1:
        axes.plot(height_mm, one.probability[:, 0], color=COLOURS[0])
        drawing.label_axes(axes, "roughness h (mm)", "", f"l = {length_mm[0]:.3g} mm, as given")
        return
    likely = np.log10(np.maximum(one.probability / one.probability.max(), DRAWN))
    axes.contourf(height_mm, length_mm, likely.T, 12, cmap="cividis")
    slope = np.sqrt(2) * height_mm / length_mm[:, None]
    lines = axes.contour(
        height_mm, length_mm, slope, (0.05, 0.1, 0.2, 0.4), colors="white", linestyles="--",
        linewidths=0.6,
    )  # fmt: skip
    axes.clabel(lines, fontsize=drawing.TICK_PT)
    title = "likely pairs; dashed: equal slope"
    drawing.label_axes(axes, "roughness h (mm)", "correlation length l (mm)", title)


def _draw_fit(axes: Axes, fit: Fit, scale: np.ndarray | float, colour: str) -> None:
    """Draw the measured statistics over those of simulations at the best values."""
    index = np.arange(len(fit.statistics), dtype=float)
    axes.errorbar(
        index, 0 * index, scale * fit.spread, fmt="_", color="0.5", linewidth=4, alpha=0.6,
        label="simulations at the best",
    )  # fmt: skip
    axes.plot(index, scale * (fit.measured - fit.fitted), "o", ms=4, color=colour, label="measured")
    axes.set_xticks(index, fit.statistics, rotation=35, ha="right")
    _legend(axes)


def _legend(axes: Axes) -> None:
    for text in axes.legend(fontsize=drawing.TICK_PT - 0.5, framealpha=0.8).get_texts():
        text.set_parse_math(False)
