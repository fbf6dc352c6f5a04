"""The figure of an antenna array: elements, virtual aperture, response over directions and cuts."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clradar.arrays.lobes import ArrayFigures
from clradar.arrays.point_spread import Clusters, clusters_of, response
from clradar.model import Waveform
from clradar.model.length_unit import METRES, LengthUnit, unit_for
from clradar.plot import drawing

SIZE = (8.0, 7.2)
LEVELS_DB, CIRCLED_DB = 40.0, -20.0
SHOWN_BEAMS = 10.0  # widths of the main lobe that directions reach, or to the circled lobes
CUT_WIDTHS = 6.0  # widths at -3 dB that cuts reach to either side
MOST_NUMBERS = 64  # of clusters, in the picture

RX_COLOUR, TX_COLOUR, PAIR_COLOUR = *drawing.CURVE_COLOURS[:2], "#555555"
CENTRED: dict[str, Any] = {"fontsize": drawing.TICK_PT, "ha": "center", "va": "center"}


def array_figure(
    array: Clusters, waveform: Waveform, found: ArrayFigures, title: str | None = None
) -> Figure:
    """Draw an array, or clusters, and what `clradar.arrays.array_figures` found of it.

    Axes in this order: elements and virtual aperture, as the radar sees the scene (x to the left);
    the response at the middle frequency over directions, with the lobes; cuts of the response of
    the whole band along x, y and z through the focus.
    """
    figure = drawing.new_figure(*SIZE, title or clusters_of(array)[0].name)
    axes = figure.subplots(2, 2)
    draw_elements(axes[0, 0], array)
    _virtual(axes[0, 1], array)
    _directions(axes[1, 0], found)
    _cuts(axes[1, 1], array, waveform, found)
    return figure


def draw_elements(axes: Axes, array: Clusters) -> None:
    """Draw the places of the antennas, as the radar sees the scene."""
    own, unit = clusters_of(array), _unit(array)
    for sides_m, colour, marker, name in (
        ([one.tx_m for one in own], TX_COLOUR, "s", "Tx"),
        ([one.rx_m for one in own], RX_COLOUR, "o", "Rx"),
    ):
        x, y = unit.per_m * np.concatenate(sides_m)[:, :2].T
        label = f"{len(sides_m[0])} {name}" + (f", {len(own)} times" if len(own) > 1 else "")
        axes.plot(x, y, marker, color=colour, markersize=3, fillstyle="none", label=label)
    if 1 < len(own) <= MOST_NUMBERS:
        for i, one in enumerate(own, start=1):
            middle = unit.per_m * np.concatenate([one.tx_m, one.rx_m])[:, :2].mean(axis=0)
            axes.text(middle[0], middle[1], str(i), **CENTRED)
    _equal(axes, unit, "elements" if len(own) == 1 else "elements, and the numbers of clusters")
    axes.legend(fontsize=drawing.TICK_PT)


def _virtual(axes: Axes, array: Clusters) -> None:
    """The middle of every pair: where a single antenna would see nearly the same phase far away."""
    unit = _unit(array)
    sides = [[side.antennas_m[:, :2] / 2 for side in one.sides] for one in clusters_of(array)]
    middles = np.concatenate([(tx[:, None] + rx[None]).reshape(-1, 2) for tx, rx in sides])
    places = unit.per_m * np.unique(middles.round(7), axis=0)
    axes.plot(places[:, 0], places[:, 1], ".", color=PAIR_COLOUR, markersize=1.5)
    _equal(axes, unit, f"virtual aperture: {len(middles)} pairs at {len(places)} places")


def _unit(array: Clusters) -> LengthUnit:
    sides = [side for one in clusters_of(array) for side in one.sides]
    return unit_for(*np.ravel(np.concatenate([side.antennas_m for side in sides])[:, :2]))


def _equal(axes: Axes, unit: LengthUnit, title: str) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    drawing.label_axes(axes, f"\N{LEFTWARDS ARROW} x ({unit.name})", f"y ({unit.name})", title)
    axes.invert_xaxis()


def _directions(axes: Axes, found: ArrayFigures) -> None:
    directions, level = found.over_directions.directions, found.over_directions.level
    level_db = 20 * np.log10(np.maximum(level, 10 ** (-LEVELS_DB / 20)))
    sines = directions[0, :, 0], directions[:, 0, 1]
    at_ghz = found.over_directions.frequency_hz / 1e9
    title = f"response at {at_ghz:.4g} GHz; lobes numbered as in the table"
    places = [lobe.position_m / np.linalg.norm(lobe.position_m) for lobe in found.lobes]
    if min(level.shape) == 1:  # a line of antennas
        along = 0 if level.shape[0] == 1 else 1
        axes.plot(sines[along], level_db.ravel(), color=PAIR_COLOUR, linewidth=0.8)
        drawing.label_axes(axes, f"sine of the angle along {'xy'[along]}", "dB", title)
        for lobe, at in zip(found.lobes, places, strict=True):
            axes.plot(at[along], lobe.level_db, "v", color=TX_COLOUR, markersize=4)
        return
    mesh = axes.pcolormesh(*sines, level_db, shading="nearest", rasterized=True)
    drawing.add_bar([axes], mesh)
    beam = max((w for w in found.widths_m[:2] if np.isfinite(w)), default=np.inf)
    strong = [i for i, lobe in enumerate(found.lobes) if lobe.level_db >= CIRCLED_DB]
    taken = [np.zeros(2), *(places[i][:2] for i in strong)]
    # Room for numbers of lobes along the surface of the array.
    reach = min(max(SHOWN_BEAMS * beam / found.focus_m[2], 1.15 * np.abs(taken).max()), 1.1)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), facecolor=mesh.cmap(0.0), aspect="equal")
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    around = 0.09 * reach * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for i in strong:
        colour, spots = TX_COLOUR if found.lobes[i].grating else "white", places[i][:2] + around
        axes.plot(*places[i][:2], "o", fillstyle="none", color=colour, markersize=8)
        x, y = spots[np.linalg.norm(spots[:, None] - taken, axis=2).min(axis=1).argmax()]
        taken.append(np.array([x, y]))
        axes.text(x, y, str(i + 1), color="white", **CENTRED)
    x_name, y_name = "\N{LEFTWARDS ARROW} sine of the angle along x", "sine of the angle along y"
    drawing.label_axes(axes, x_name, y_name, title)
    axes.invert_xaxis()


def _cuts(axes: Axes, array: Clusters, waveform: Waveform, found: ArrayFigures) -> None:
    widest_m = max((width for width in found.widths_m if np.isfinite(width)), default=0.01)
    reaches_m = [
        min(CUT_WIDTHS * min(width_m, widest_m), 0.95 * float(found.focus_m[2]))
        for width_m in found.widths_m
    ]
    unit = unit_for(*reaches_m)
    for axis, reach_m in enumerate(reaches_m):
        offsets_m = np.linspace(-reach_m, reach_m, 601)
        points_m = found.focus_m + offsets_m[:, None] * np.eye(3)[axis]
        level = response(array, waveform.frequencies_hz, found.focus_m, points_m)
        width = unit.per_m * found.widths_m[axis]
        text = f"{width:.{3 if unit is METRES else 1}f} {unit.name}"
        level_db = 20 * np.log10(np.maximum(level, 1e-9))
        level_db[level_db <= -LEVELS_DB] = np.nan  # below the panel, not a flat line in it
        axes.plot(
            unit.per_m * offsets_m, level_db, ("-", "--", "-.")[axis],  # x and y can be the same
            color=drawing.CURVE_COLOURS[axis], linewidth=0.9,
            label=f"{'xyz'[axis]}: {text if np.isfinite(width) else 'none'}",
        )  # fmt: skip
    axes.axhline(-3, color="#999999", linewidth=0.6, linestyle=":")
    title = "response of the whole band; widths at -3 dB"
    drawing.label_axes(axes, f"distance from the focus ({unit.name})", drawing.BELOW_MAXIMUM, title)
    axes.legend(fontsize=drawing.TICK_PT)
