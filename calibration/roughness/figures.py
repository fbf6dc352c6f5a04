"""Figures of sweeps: images and metrics over alpha, and what is likely of alpha, h and l."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.roughness.emulator import Fit
from calibration.roughness.millimetres import RoughnessEstimate
from calibration.roughness.roughness_sweep import RoughnessSweep
from calibration.roughness.sweep import Sweep
from calibration.roughness.texture import of_power
from clradar.model import DepthMap, checks
from clradar.plot import AMPLITUDE_BACKGROUND

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_IMAGES = 6
"""Simulated images beside the measured one."""

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"

SIMILARITIES = {
    "overlap": "overlap", "db_correlation": "dB correlation", "ssim": "SSIM", "mask_iou": "mask IoU"
}  # fmt: skip
LENGTHS = {
    "depth_rmse_m": "depth RMSE",
    "chamfer_simulated_to_measured_m": "Chamfer sim. to meas.",
    "chamfer_measured_to_simulated_m": "Chamfer meas. to sim.",
}

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#404040")
"""Palette of Okabe and Ito (2008), which colour-blind readers distinguish."""

LABEL_PT, TICK_PT, DPI = 8.0, 7.0, 200

DECIBEL_PER_NATURAL = 10.0 / np.log(10.0)

SHORT_NAMES = (
    ("rest at ", ""),
    (" degrees", "\N{DEGREE SIGN}"),
    (" to ", "\N{EN DASH}"),
    ("coherent power", "coherent"),
    ("correlation of ", ""),
    ("power at ", ""),
    ("points within ", "< "),
)

DRAWN = 1e-3
"""Share of its maximum down to which a probability is drawn."""


def sweep_figure(sweep: Sweep, measured_label: str = "Measurement") -> Figure:
    """Draw a sweep over alpha.

    The amplitude of the measurement and of at most six alphas of the first seed, the nearest to the
    estimate among them, in dB below each maximum; below these the similarities and the lengths over
    alpha, as means over the seeds with bands from the lowest to the highest, the probability of
    alpha, of the whole and of the regions, and measured and fitted statistics.
    """
    from matplotlib.figure import Figure

    checks.instance("sweep_figure: sweep", sweep, Sweep)
    figure = Figure(figsize=(11.0, 4.9), dpi=DPI, facecolor="white", layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=(0.8, 1.15))
    above, below = rows
    chosen = shown_alphas(sweep)
    images = [sweep.measured, *(image for i in chosen if (image := sweep.images[i]) is not None)]
    titles = [measured_label, *(f"{ALPHA} = {sweep.alphas[i]:g}" for i in chosen)]
    _draw_images(above, images, titles)
    similarities, lengths, likely, statistics = below.subplots(1, 4)
    for axes, names, scale, title in (
        (similarities, SIMILARITIES, 1.0, "metrics"), (lengths, LENGTHS, 1e3, "metrics (mm)")
    ):  # fmt: skip
        for (name, label), colour in zip(names.items(), COLOURS, strict=False):
            values = scale * sweep.of(name)
            there = np.isfinite(values).all(axis=0)
            x, y = sweep.alphas[there], values[:, there]
            axes.plot(x, y.mean(axis=0), ".-", color=colour, label=label, lw=1.2, ms=4)
            axes.fill_between(x, y.min(axis=0), y.max(axis=0), color=colour, alpha=0.25, lw=0)
        _finish(axes, title, ALPHA, legend=True)
    for one, colour in zip(sweep.estimates, COLOURS, strict=False):
        shown = one.probability > DRAWN * one.probability.max()
        peak = one.probability / one.probability.max()
        likely.plot(one.alphas[shown], peak[shown], color=colour, label=f"{one.name}: {one.text()}")
        likely.axvspan(one.interval.low, one.interval.high, color=colour, alpha=0.15, lw=0)
    likely.set_xlim(sweep.alphas[0], sweep.alphas[-1])
    _finish(likely, f"probability of {ALPHA}, its maximum 1", ALPHA, legend=True)
    _draw_fit(statistics, sweep.estimate.fit, DECIBEL_PER_NATURAL, COLOURS[0])
    _finish(statistics, "statistics of the brightness (dB)", "", legend=True)
    return figure


def shown_alphas(sweep: Sweep) -> list[int]:
    """Indices of the alphas whose images are drawn: evenly spread, with the nearest."""
    there = [i for i, image in enumerate(sweep.images) if image is not None]
    if len(there) <= MOST_IMAGES:
        return there
    chosen = [there[i] for i in np.linspace(0, len(there) - 1, MOST_IMAGES).round().astype(int)]
    best = sweep.nearest
    if best not in chosen and best in there:
        # Instead of the nearest one that is not an end.
        inner = min(range(1, len(chosen) - 1), key=lambda i: abs(chosen[i] - best))
        chosen[inner] = best
    return sorted(chosen)


def _draw_images(figure: Any, images: Sequence[DepthMap], titles: Sequence[str]) -> None:
    """Draw amplitudes side by side, x to the left as the radar sees them."""
    columns = figure.subplots(1, len(images), sharex=True, sharey=True, squeeze=False)[0]
    for axes, image, title in zip(columns, images, titles, strict=True):
        with np.errstate(divide="ignore"):
            level_db = 20 * np.log10(image.amplitude / image.amplitude.max())
        x_mm, y_mm = 1e3 * image.x_m, 1e3 * image.y_m
        axes.set_facecolor(AMPLITUDE_BACKGROUND)
        axes.imshow(
            np.where(level_db >= -image.dynamic_range_db, level_db, np.nan), cmap="inferno",
            extent=(x_mm[0], x_mm[-1], y_mm[0], y_mm[-1]), origin="lower",
            vmin=-image.dynamic_range_db, vmax=0.0, interpolation="nearest",
        )  # fmt: skip
        axes.set_xlim(x_mm[-1], x_mm[0])
        axes.set_title(title, fontsize=LABEL_PT, parse_math=False)
        axes.set_xlabel("x (mm)", fontsize=LABEL_PT)
        axes.tick_params(labelsize=TICK_PT)
    columns[0].set_ylabel("y (mm)", fontsize=LABEL_PT)
    bar = figure.colorbar(columns[0].images[0], ax=columns, pad=0.01)
    bar.set_label("below maximum (dB)", fontsize=LABEL_PT)
    bar.ax.tick_params(labelsize=TICK_PT)


def roughness_figure(sweep: RoughnessSweep) -> Figure:
    """Draw a sweep over roughness, a row for each region.

    The probability density of h, with the interval of 68 %; that of h and l together, with lines of
    equal slope; the measured statistics, in decibels, over the mean and one standard deviation of
    simulations at the best h and l.
    """
    from matplotlib.figure import Figure

    checks.instance("roughness_figure: sweep", sweep, RoughnessSweep)
    rows = len(sweep.estimates)
    figure = Figure(figsize=(10.6, 3.3 * rows), dpi=DPI, facecolor="white", layout="constrained")
    cells = figure.subplots(rows, 3, squeeze=False, width_ratios=(2.6, 2.4, 3.6))
    for number, (row, one) in enumerate(zip(cells, sweep.estimates, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        _draw_height(row[0], one, colour)
        _draw_pair(row[1], one)
        # Contrast and correlation are small numbers: ten times them fits the scale.
        scale = np.where(of_power(one.fit.statistics), DECIBEL_PER_NATURAL, 10.0)
        _draw_fit(row[2], one.fit, scale, colour)
        row[2].set_ylabel("dB; contrast, apertures times 10", fontsize=LABEL_PT)
        _finish(row[2], "coherent power, the rest over tilt, texture", "", legend=True)
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


def _draw_fit(axes: Axes, fit: Fit, scale: np.ndarray | float, colour: str) -> None:
    """Draw the measured statistics over those of simulations at the best values."""
    index = np.arange(len(fit.statistics), dtype=float)
    axes.errorbar(
        index, 0 * index, scale * fit.spread, fmt="_", color="0.5", linewidth=4, alpha=0.6,
        label="simulations at the best",
    )  # fmt: skip
    axes.plot(index, scale * (fit.measured - fit.fitted), "o", ms=4, color=colour, label="measured")
    shown = list(fit.statistics)
    for long, short in SHORT_NAMES:
        shown = [name.replace(long, short) for name in shown]
    axes.set_xticks(index, shown, rotation=35, ha="right")


def _finish(axes: Axes, title: str, x_label: str, *, legend: bool = False) -> None:
    axes.set_title(title, fontsize=LABEL_PT, parse_math=False)
    axes.set_xlabel(x_label, fontsize=LABEL_PT, labelpad=2)
    axes.tick_params(labelsize=TICK_PT)
    axes.grid(visible=True, linewidth=0.3)
    if legend:
        for text in axes.legend(fontsize=TICK_PT - 0.5, framealpha=0.8).get_texts():
            text.set_parse_math(False)
