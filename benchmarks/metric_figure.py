"""The figure of docs/metrics.md: every metric over a shift and over alpha."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

SHIFTS = {"x": ("#0072b2", "shift sideways (x)"), "z": ("#d55e00", "shift in depth (z)")}
TRUTH_COLORS = ("#009e73", "#cc79a7")
COLUMNS = 2


def draw(
    names: Sequence[str],
    pairs: dict[str, dict[str, np.ndarray]],
    sweeps: dict[str, dict[float, dict[str, np.ndarray]]],
) -> Figure:
    """Return two panels per metric; bands are the range over the hands."""
    rows = -(-(len(names) + 1) // COLUMNS)
    figure = Figure(figsize=(10.0, 2.0 * rows), dpi=160, facecolor="white", layout="constrained")
    grid = figure.subplots(rows, 2 * COLUMNS)
    panels = [grid[i // COLUMNS, 2 * (i % COLUMNS) :][:2] for i in range(rows * COLUMNS)]
    for name, (left, right) in zip(names, panels, strict=False):
        _shift_panel(left, name, pairs)
        _alpha_panel(right, name, sweeps)
        title = name.replace("simulated_to", "simulated_\nto").replace(
            "measured_to", "measured_\nto"
        )
        left.set_title(title, fontsize=8, loc="left", fontweight="bold")
        if name.endswith("_m"):
            left.set_ylabel("mm", fontsize=7)
    for unused in panels[len(names) :]:
        for panel, drawn in zip(unused, panels[0], strict=True):
            panel.axis("off")
            handles, labels = drawn.get_legend_handles_labels()
            panel.legend(handles, labels, loc="center left", fontsize=8, frameon=False)
    return figure


def _line(axes: Axes, x: Sequence[float], values: Sequence[np.ndarray], **style: Any) -> None:
    """Draw the mean over everything, and the range over the hands behind it."""
    hands = np.array([v.mean(axis=(1, 2)) for v in values])
    axes.fill_between(
        x, hands.min(axis=1), hands.max(axis=1), color=style["color"], alpha=0.15, lw=0
    )
    axes.plot(x, hands.mean(axis=1), marker="o", ms=3, lw=1.2, **style)


def _shift_panel(axes: Axes, name: str, pairs: dict[str, dict[str, np.ndarray]]) -> None:
    ceiling, floor = (pairs[key][name] for key in ("ceiling", "another pose"))
    for axis, (color, label) in SHIFTS.items():
        steps = {int(k.split()[1]): v[name] for k, v in pairs.items() if k.startswith(f"{axis} ")}
        _line(axes, [0, *steps], [ceiling, *steps.values()], color=color, label=label)
    axes.axhline(ceiling.mean(), color="0.3", lw=0.8, label="ceiling: another seed")
    axes.axhline(floor.mean(), color="0.3", lw=0.8, ls="--", label="floor: another pose")
    _finish(axes, "shift (mm)")


def _alpha_panel(
    axes: Axes, name: str, sweeps: dict[str, dict[float, dict[str, np.ndarray]]]
) -> None:
    for color, (label, sweep) in zip(TRUTH_COLORS, sweeps.items(), strict=True):
        values = [v[name][..., :1] for v in sweep.values()]
        _line(axes, list(sweep), values, color=color, label=label)
        axes.axvline(float(label.split()[-1]), color=color, lw=0.8, ls=":")
    _finish(axes, "\N{GREEK SMALL LETTER ALPHA} of the simulation")


def _finish(axes: Axes, x_label: str) -> None:
    axes.set_xlabel(x_label, fontsize=7)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
