"""Panels that show where two images disagree: in level, and in depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clradar.compare import Disagreement, UnmatchedObject
from clradar.plot.layout import LengthUnit
from clradar.plot.panels import DEPTH_BACKGROUND, draw_mesh, label_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED_COLOUR, SIMULATED_COLOUR = "#b35900", "#1f5fb0"
"""Ends of the scales: the measurement is stronger or nearer, or the simulation is."""

LEVEL_DB, DEPTH_MM = 20.0, 10.0
"""Ends of the scales. An object is unmatched from 12 dB, and from 10 mm."""

RING_PT = 13.0
"""Diameter of the ring around an unmatched object."""


def draw_level_difference(axes: Axes, found: Disagreement, unit: LengthUnit) -> Any:
    """Draw where an image is stronger than all of the other nearby, with unmatched objects."""
    limits = (-LEVEL_DB, LEVEL_DB)
    drawn = draw_mesh(axes, found, unit, found.level_db, _scale(), limits, DEPTH_BACKGROUND)
    for one in found.missing:
        _draw_ring(axes, one, unit, "solid")
    for one in found.surplus:
        _draw_ring(axes, one, unit, (0, (1.5, 1.5)))
    return drawn


def draw_depth_difference(axes: Axes, found: Disagreement, unit: LengthUnit) -> Any:
    limits = (-DEPTH_MM, DEPTH_MM)
    return draw_mesh(axes, found, unit, 1e3 * found.depth_m, _scale(), limits, DEPTH_BACKGROUND)


def level_difference_bar(axes: Axes, drawn: Any) -> None:
    _bar(axes, drawn, LEVEL_DB, "level difference (dB)")


def depth_difference_bar(axes: Axes, drawn: Any) -> None:
    _bar(axes, drawn, DEPTH_MM, "depth difference (mm)")


def _bar(axes: Axes, drawn: Any, end: float, name: str) -> None:
    bar = axes.figure.colorbar(drawn, cax=axes, extend="both", extendfrac=0.06)
    label_bar(bar, (-end, end), name)


def _scale() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    colours = [SIMULATED_COLOUR, "white", MEASURED_COLOUR]
    return LinearSegmentedColormap.from_list("differences", colours)


def _draw_ring(axes: Axes, one: UnmatchedObject, unit: LengthUnit, style: Any) -> None:
    x, y = (unit.per_m * value for value in one.position_m[:2])
    # A scatter, since a marker of a line cannot have a dashed edge.
    axes.scatter(
        [x], [y], s=RING_PT**2, facecolors="none", edgecolors="black", linewidths=1.0,
        linestyles=[style], clip_on=False, zorder=3,
    )  # fmt: skip
