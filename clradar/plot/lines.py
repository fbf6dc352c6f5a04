"""The figure of a volume that is a single line of voxels: amplitude over position."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clradar.errors import CompareError
from clradar.model import Volume
from clradar.model.length_unit import unit_for
from clradar.plot.layout import (
    BOTTOM,
    LABEL_PT,
    LEFT,
    SINGLE_PANEL_WIDTH,
    TICK_PT,
    TITLE_PT,
    TOP,
    add_axes,
    add_text,
    new_figure,
    text_height,
    typeset,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT = 2.0
"""Of the panel, inches."""


def line_figure(
    volume: Volume, title: str | None, dynamic_range_db: float, *, dbsm: bool = False
) -> Figure:
    """Draw the amplitude of a volume with one axis of more than one voxel."""
    axes_m = {name: getattr(volume.grid, f"{name}_m") for name in "xyz"}
    name = next((name for name, axis_m in axes_m.items() if len(axis_m) > 1), None)
    at = {n: a for n, a in axes_m.items() if n != name}
    unit = unit_for(*(float(axis_m[i]) for axis_m in axes_m.values() for i in (0, -1)))
    place = ", ".join(f"{n} = {unit.per_m * axis_m[0]:g}" for n, axis_m in at.items())
    amplitude = np.abs(volume.data).ravel().astype(np.float64)
    if name is None:
        raise CompareError(
            "image: expected more than one voxel to draw, got a single one at "
            f"{place} {unit.name}, whose amplitude is {amplitude[0]:.4g}"
        )
    lines = wrapped(title or "", SINGLE_PANEL_WIDTH, TITLE_PT)
    height = (
        BOTTOM + HEIGHT + text_height(1, LABEL_PT) + text_height(len(lines), TITLE_PT) + 2 * TOP
    )
    figure = new_figure(LEFT + SINGLE_PANEL_WIDTH + LEFT / 2, height)
    axes = add_axes(figure, LEFT, BOTTOM, SINGLE_PANEL_WIDTH, HEIGHT)
    floor = 10.0 ** (-dynamic_range_db / 20.0)
    level_db = 20.0 * np.log10(np.maximum(amplitude / amplitude.max(), floor / 10.0))
    top_db = 20 * math.log10(amplitude.max()) if dbsm else 0.0
    level_db += top_db
    where = unit.per_m * axes_m[name]
    axes.plot(where, level_db, linewidth=1.0)
    axes.set_xlim(where[-1], where[0]) if name == "x" else axes.set_xlim(where[0], where[-1])
    axes.set_ylim(top_db - dynamic_range_db, top_db + 0.03 * dynamic_range_db)
    axes.grid(linewidth=0.3)
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    axes.set_xlabel(f"{name} ({unit.name})", fontsize=LABEL_PT, labelpad=2)
    quantity, unit_name = ("Radar cross section", "dBsm") if dbsm else ("Amplitude", "dB")
    axes.set_ylabel(f"{quantity.lower()} ({unit_name})", fontsize=LABEL_PT, labelpad=1)
    axes.set_title(f"{quantity} at {typeset(place)} {unit.name}", fontsize=LABEL_PT, pad=4)
    for row, line in enumerate(lines):
        top = height - TOP - text_height(row, TITLE_PT)
        middle = LEFT + SINGLE_PANEL_WIDTH / 2
        add_text(figure, middle, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure
