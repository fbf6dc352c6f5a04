"""Figures of one image, from one side or three, and of rows of amplitude images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.compare import depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.model.length_unit import unit_for
from clradar.plot.layout import (
    DPI,
    LABEL_PT,
    LABELS,
    PANEL_WIDTH,
    ROW_WIDTH,
    SINGLE_PANEL_WIDTH,
    TICK_PT,
    Extent,
    new_panels,
    panel_size,
    settled,
    typeset,
    wrapped,
)
from clradar.plot.panels import (
    amplitude_bar,
    depth_bar,
    depth_limits_mm,
    draw_amplitude,
    draw_depth,
    draw_frame,
    peak_dbsm,
)
from clradar.plot.views import FRONT, VIEWS, projected, rcs_image, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE_HEIGHT = 2.0
"""Of the panel of a curve, inches."""


def image_figure(
    image: Volume | DepthMap,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    view: str | None = None,
    dbsm: bool = False,
) -> Figure:
    """Draw the amplitude and the depth of one image side by side.

    Parameters
    ----------
    image : Volume or DepthMap
    title : str, optional
        Plain text above both panels.
    dynamic_range_db : float, decibel
        Pixels further below the maximum are background.
    view : "xy", "xz", "yz" or "all", optional
        The axes of the figure; the volume is projected along the third. Default: along the axis
        that is thin, an eighth of either other extent at most; else "xy", the radar's view. "all":
        amplitude from all three sides.
    dbsm : bool
        Draw the radar cross section that a voxel reads (`Volume.rcs_dbsm`), in place of the level
        relative to the maximum.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in this order: amplitude, depth, colour bar of the amplitude, colour bar of the depth.
        A single slice has no depth: amplitude and its colour bar; all views have three amplitudes
        and their colour bar. A volume of a single line has one curve of amplitude over position,
        whatever the view.

    Raises
    ------
    CompareError
        Not an image, zero everywhere, without any depth, a single voxel, a depth map that was cut
        at a smaller dynamic range, or one with a view other than "xy".
    ModelError
        An unknown view; `dbsm` of an image that is not on an absolute scale.
    """
    if dbsm:
        image = rcs_image(image)
    flat = isinstance(image, Volume) and min(image.grid.counts) == 1
    if view == "all" and not flat:
        return _three_views(image, title, dynamic_range_db, dbsm=dbsm)
    seen = view_of(image, None if view == "all" else view)
    shown = projected(image, seen, dynamic_range_db, "image")
    if isinstance(image, Volume) and sum(count > 1 for count in image.grid.counts) < 2:
        return _line(image, title, dynamic_range_db, dbsm=dbsm)
    extent = Extent.around([shown])
    level = "Radar cross section" if dbsm else "Amplitude"
    names = [f"{level}, maximum over depth", "Depth"]
    axis_m = getattr(image.grid, f"{seen.along}_m") if isinstance(image, Volume) else np.empty(0)
    if len(axis_m) == 1:
        place = typeset(f"{extent.unit.per_m * float(axis_m[0]):g}")
        names = [f"{level} at {seen.along} = {place} {extent.unit.name}"]
    elif seen is not FRONT:
        names = [f"{level}, maximum over {seen.along}", f"{seen.along} of the maximum"]
    size = panel_size(SINGLE_PANEL_WIDTH, extent.aspect)
    n = len(names)
    figure, (panels,) = new_panels(1, n, size, title, bars=n, labels=(1, n))
    for panel, name in zip(panels, names, strict=True):
        draw_frame(panel, extent, size, view=seen)
        panel.set_title(name, fontsize=LABEL_PT, pad=4)
    top_db = peak_dbsm(shown) if dbsm else None
    drawn = draw_amplitude(panels[0], shown, extent.unit, top_db)
    amplitude_bar(panels[:1], drawn, dynamic_range_db, top_db)
    if n == 2:
        limits_mm = depth_limits_mm([shown])
        depth = draw_depth(panels[1], shown, extent.unit, limits_mm)
        depth_bar(panels[1:], depth, limits_mm, [shown], seen)
    return settled(figure)


def _three_views(
    image: Volume | DepthMap, title: str | None, dynamic_range_db: float, *, dbsm: bool
) -> Figure:
    """Draw the maximum of a volume along z, y and x, all below the same maximum at one scale."""
    if not isinstance(image, Volume):
        raise CompareError("view: expected a volume to draw from all sides, got a depth map")
    depth_map_of(image, dynamic_range_db, "image")  # of what cannot be drawn it says why
    shown = {name: projected(image, VIEWS[name], dynamic_range_db, "image") for name in VIEWS}
    grid = image.grid
    unit = unit_for(*grid.origin_m, *(grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1)))
    extents = [Extent.around([one], unit) for one in shown.values()]
    spans = [[float(np.ptp(ends)) for ends in (extent.x, extent.y)] for extent in extents]
    widest, highest = (max(span[i] for span in spans) for i in (0, 1))
    size = panel_size(0.8 * SINGLE_PANEL_WIDTH, highest / widest)
    figure, (panels,) = new_panels(1, 3, size, title, labels=(1, 3))
    top_db = max(peak_dbsm(one) for one in shown.values()) if dbsm else None
    for panel, (name, one), extent in zip(panels, shown.items(), extents, strict=True):
        draw_frame(panel, extent, (1.3 * size[0], 1.3 * size[1]), view=VIEWS[name])
        drawn = draw_amplitude(panel, one, unit, top_db)
        panel.set_title(f"maximum over {VIEWS[name].along}", fontsize=LABEL_PT, pad=4)
        # One scale in all: the limits of the smaller ones are widened around their middle.
        for axis, ends, whole in (("x", extent.x, widest), ("y", extent.y, highest)):
            spare = (whole - float(np.ptp(ends))) / 2
            limits = (min(ends) - spare, max(ends) + spare)
            inverted = axis == "x" and VIEWS[name].horizontal == "x"
            panel.set(**{f"{axis}lim": limits[::-1] if inverted else limits})
    amplitude_bar(panels, drawn, dynamic_range_db, top_db)
    return settled(figure)


def _line(volume: Volume, title: str | None, dynamic_range_db: float, *, dbsm: bool) -> Figure:
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
    figure, ((axes,),) = new_panels(1, 1, (SINGLE_PANEL_WIDTH, LINE_HEIGHT), title, bars=0)
    floor = 10.0 ** (-dynamic_range_db / 20.0)
    level_db = 20.0 * np.log10(np.maximum(amplitude / amplitude.max(), floor / 10.0))
    top_db = 20 * math.log10(amplitude.max()) if dbsm else 0.0
    level_db += top_db
    where = unit.per_m * axes_m[name]
    axes.plot(where, level_db, linewidth=1.0)
    axes.set_xlim(where[-1], where[0]) if name == "x" else axes.set_xlim(where[0], where[-1])
    axes.set_ylim(top_db - dynamic_range_db, top_db + 0.03 * dynamic_range_db)
    quantity = "Radar cross section" if dbsm else "Amplitude"
    label = "radar cross section (dBsm)" if dbsm else "below maximum (dB)"
    plain(axes, f"{name} ({unit.name})", label)
    axes.set_title(f"{quantity} at {typeset(place)} {unit.name}", fontsize=LABEL_PT, pad=4)
    return settled(figure)


def plain(axes: Axes, x_name: str, y_name: str) -> None:
    """Give axes of curves their names, ticks and a grid."""
    axes.grid(linewidth=0.3)
    axes.tick_params(labelsize=TICK_PT, length=2.5, width=0.6, pad=2)
    axes.set_xlabel(x_name, fontsize=LABEL_PT, labelpad=2)
    axes.set_ylabel(y_name, fontsize=LABEL_PT, labelpad=1)


def panels_figure(
    panels: Sequence[Sequence[tuple[str, DepthMap | None]]],
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw the amplitudes of several images in rows, each relative to its own maximum.

    Parameters
    ----------
    panels : sequence of rows of (label, DepthMap or None)
        From top to bottom and left to right. Labels are plain text. Each panel has its own axes; it
        stays empty without an image, or with an image that is zero.
    title : str, optional
        Plain text above all panels.
    dynamic_range_db : float, decibel
        Pixels further below an image's maximum are background.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in the order of the panels, then the colour bar.

    Raises
    ------
    CompareError
        No image at all that is not zero.
    """
    shown = [
        [
            depth_map_of(image, dynamic_range_db, f"image '{label}'")
            if image is not None and image.amplitude.any()
            else None
            for label, image in row
        ]
        for row in panels
    ]
    if not any(one for row in shown for one in row):
        raise CompareError("panels_figure: expected at least one image that is not zero, got none")
    columns = max(map(len, panels))
    width = max(ROW_WIDTH / columns - LABELS, PANEL_WIDTH)
    rows = len(panels)
    figure, drawn_in = new_panels(
        rows, columns, (width, width), title, heads=3 * rows, labels=(rows, columns), dpi=DPI / 2
    )
    drawn: Any = None
    for row, ones, all_axes in zip(panels, shown, drawn_in, strict=True):
        for axes, (label, _), one in zip(all_axes, row, ones, strict=False):
            lettering = "\n".join(wrapped(label, width + LABELS / 2, TICK_PT))
            axes.set_title(lettering, fontsize=TICK_PT, pad=3, parse_math=False)
            if one is None:
                axes.set(xticks=[], yticks=[], box_aspect=1.0, anchor="S")
                continue
            extent = Extent.around([one])
            drawn = draw_amplitude(axes, one, extent.unit)
            draw_frame(axes, extent, (width, width), margin=0.05)
        for axes in all_axes[len(row) :]:
            axes.remove()
    amplitude_bar(list(figure.axes), drawn, dynamic_range_db)
    return settled(figure)
