"""Figure of a sweep: images in a row, and metrics and scores over alpha."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.roughness.estimate import AlphaEstimate
from calibration.roughness.sweep import Sweep
from clradar.model import DepthMap, checks
from clradar.plot import comparison_figure
from clradar.plot.layout import LABEL_PT, TICK_PT, add_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_IMAGES = 6
"""Simulated images beside the measured one."""

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"

SIMILARITIES = (
    ("overlap", "overlap"),
    ("db_correlation", "dB correlation"),
    ("ssim", "SSIM"),
    ("mask_iou", "mask IoU"),
)
LENGTHS = (
    ("depth_rmse_m", "depth RMSE"),
    ("chamfer_simulated_to_measured_m", "Chamfer sim. to meas."),
    ("chamfer_measured_to_simulated_m", "Chamfer meas. to sim."),
)

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#404040")
"""Palette of Okabe and Ito (2008), which colour-blind readers distinguish."""

# Inches.
ROW_HEIGHT, ROW_BELOW, ROW_ABOVE = 2.1, 0.55, 0.35
LEFT, GAP, RIGHT = 0.62, 0.65, 0.15


def sweep_figure(sweep: Sweep, measured_label: str = "Measurement") -> Figure:
    """Draw a sweep over alpha.

    Parameters
    ----------
    sweep : Sweep
    measured_label : str
        Title of the first image.

    Returns
    -------
    matplotlib.figure.Figure
        First the axes of `clradar.plot.comparison_figure`: the measurement, at most six alphas of
        the first seed (the best of the grid among them), and the best combination of the regions,
        if there are any. Then the similarities, the lengths and the score over alpha: means over
        the seeds, and bands from the lowest to the highest seed. With regions two more: their
        scores, and of two regions the score of all combinations.
    """
    checks.instance("sweep_figure: sweep", sweep, Sweep)
    chosen = shown_alphas(sweep)
    columns: list[tuple[str, DepthMap]] = [
        (f"{ALPHA} = {sweep.alphas[i]:g}", image)
        for i in chosen
        if (image := sweep.images[i]) is not None
    ]
    metrics = [sweep.metrics[0][i] for i in chosen if sweep.images[i] is not None]
    regions = sweep.regions
    if regions is not None:
        columns.append(("Regions", regions.image))
    figure = comparison_figure(
        sweep.measured,
        columns,
        metrics=metrics if len(metrics) == len(columns) else None,
        measured_label=measured_label,
        dynamic_range_db=sweep.measured.dynamic_range_db,
    )
    rows = 1 if regions is None else 2
    _make_room_below(figure, rows * (ROW_BELOW + ROW_HEIGHT + ROW_ABOVE))
    similarities, lengths, score = _row(figure, rows - 1, 3)
    _draw_metrics(similarities, sweep, SIMILARITIES, 1.0, "")
    _draw_metrics(lengths, sweep, LENGTHS, 1e3, "mm")
    _draw_scores(score, sweep, {"all": sweep.estimate})
    if regions is not None:
        by_region, grid = _row(figure, 0, 2)
        _draw_scores(by_region, sweep, dict(zip(regions.names, regions.estimates, strict=True)))
        if regions.grid is None:
            grid.set_axis_off()
        else:
            _draw_combinations(grid, sweep, regions.grid)
    return figure


def shown_alphas(sweep: Sweep) -> list[int]:
    """Indices of the alphas whose images are drawn: evenly spread, with the best."""
    there = [i for i, image in enumerate(sweep.images) if image is not None]
    if len(there) <= MOST_IMAGES:
        return there
    spread = np.linspace(0, len(there) - 1, MOST_IMAGES).round().astype(int)
    chosen = [there[i] for i in spread]
    best = sweep.estimate.grid_best
    if best not in chosen and best in there:
        # Instead of the nearest one that is not an end.
        inner = min(range(1, len(chosen) - 1), key=lambda i: abs(chosen[i] - best))
        chosen[inner] = best
    return sorted(chosen)


def _make_room_below(figure: Figure, height: float) -> None:
    """Extend a figure downwards, in inches."""
    width, before = figure.get_size_inches()
    after = before + height
    figure.set_size_inches(width, after)

    def moved(share: float) -> float:
        return (share * before + height) / after

    for axes in figure.axes:
        box = axes.get_position(original=True)
        axes.set_position((box.x0, moved(box.y0), box.width, box.height * before / after))
    for text in figure.texts:
        x, y = text.get_position()
        text.set_position((x, moved(y)))


def _row(figure: Figure, from_below: int, n: int) -> list[Axes]:
    """Add `n` axes side by side over the width of the figure."""
    width, _ = figure.get_size_inches()
    each = (width - LEFT - RIGHT - (n - 1) * GAP) / n
    bottom = from_below * (ROW_BELOW + ROW_HEIGHT + ROW_ABOVE) + ROW_BELOW
    return [add_axes(figure, LEFT + i * (each + GAP), bottom, each, ROW_HEIGHT) for i in range(n)]


def _draw_metrics(
    axes: Axes, sweep: Sweep, names: tuple[tuple[str, str], ...], scale: float, unit: str
) -> None:
    for (field, label), colour in zip(names, COLOURS, strict=False):
        _band(axes, sweep.alphas, scale * sweep.of(field), label, colour)
    _finish(axes, "metrics" + (f" ({unit})" if unit else ""))


def _band(axes: Axes, alphas: np.ndarray, values: np.ndarray, label: str, colour: str) -> None:
    there = np.isfinite(values).all(axis=0)
    x, y = alphas[there], values[:, there]
    axes.plot(x, y.mean(axis=0), ".-", color=colour, label=label, linewidth=1.2, markersize=4)
    axes.fill_between(x, y.min(axis=0), y.max(axis=0), color=colour, alpha=0.25, linewidth=0)


def _draw_scores(axes: Axes, sweep: Sweep, estimates: dict[str, AlphaEstimate]) -> None:
    for i, (name, found) in enumerate(estimates.items()):
        colour = COLOURS[i % len(COLOURS)]
        # Curves relative to their maxima: only the position of the peak matters.
        best = found.score[:, found.grid_best].mean()
        shown = found.text().split(" (")[0]
        _band(axes, sweep.alphas, found.score - best, f"{name}: {shown}", colour)
        axes.axvline(found.alpha, color=colour, linewidth=0.8)
        if np.isfinite(found.uncertainty):
            ends = np.clip(found.alpha + found.uncertainty * np.array([-1.0, 1.0]), 0.0, 1.0)
            axes.axvspan(*ends, color=colour, alpha=0.12, linewidth=0)
    _finish(axes, f"score of {sweep.estimate.metric}, 0 at its best")


def _draw_combinations(axes: Axes, sweep: Sweep, grid: np.ndarray) -> None:
    regions = sweep.regions
    assert regions is not None
    drawn = axes.contourf(
        sweep.alphas, sweep.alphas, np.ma.masked_invalid(grid).T, 20, cmap="cividis"
    )
    axes.figure.colorbar(drawn, ax=axes, pad=0.02).ax.tick_params(labelsize=TICK_PT)
    at = [float(sweep.alphas[i]) for i in regions.best]
    axes.plot(*at, "o", color="white", markeredgecolor="black", markersize=5)
    axes.plot([0, 1], [0, 1], "--", color="white", linewidth=0.7)
    axes.set_xlim(sweep.alphas[0], sweep.alphas[-1])
    axes.set_ylim(sweep.alphas[0], sweep.alphas[-1])
    names = [f"{ALPHA} of {name}" for name in regions.names]
    axes.set_title("score of all combinations", fontsize=LABEL_PT)
    axes.set_xlabel(names[0], fontsize=LABEL_PT, labelpad=2, parse_math=False)
    axes.set_ylabel(names[1], fontsize=LABEL_PT, labelpad=2, parse_math=False)
    axes.tick_params(labelsize=TICK_PT)


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=LABEL_PT)
    axes.set_xlabel(ALPHA, fontsize=LABEL_PT, labelpad=2)
    axes.tick_params(labelsize=TICK_PT)
    axes.grid(visible=True, linewidth=0.3)
    legend = axes.legend(fontsize=TICK_PT - 0.5, framealpha=0.8)
    for text in legend.get_texts():
        text.set_parse_math(False)
