"""Figures of one image, from one side or three, and of rows of amplitude images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.compare import depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.plot.layout import (
    DPI,
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
    from matplotlib.figure import Figure


def image_figure(
    image: Volume | DepthMap,
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    view: str | None = None,
    dbsm: bool = False,
) -> Figure:
    """Draw the amplitude and the depth of one image side by side, each with its colour bar.

    Pixels more than `dynamic_range_db` below the maximum are background. `view` names the axes of
    the figure, "xy", "xz" or "yz"; the volume is projected along the third. Default: along an axis
    that is thin, an eighth of either other extent at most, else "xy", the radar's view. "all":
    amplitude from all three sides. `dbsm` draws the radar cross section that a voxel reads instead
    of the level. A single slice has no depth. What cannot be drawn, as a line of voxels, is a
    `CompareError`.
    """
    if dbsm:
        image = rcs_image(image)
    flat = isinstance(image, Volume) and min(image.grid.counts) == 1
    if view == "all" and not flat:
        return _three_views(image, title, dynamic_range_db, dbsm=dbsm)
    seen = view_of(image, None if view == "all" else view)
    shown = projected(image, seen, dynamic_range_db, "image")
    if isinstance(image, Volume) and sum(count > 1 for count in image.grid.counts) < 2:
        counts = " x ".join(map(str, image.grid.counts))
        raise CompareError(f"image: expected a plane of voxels, or more, to draw, got {counts}")
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
    figure, (panels,) = new_panels(1, n, size, title, bars=n, labels=n)
    for panel, name in zip(panels, names, strict=True):
        draw_frame(panel, extent, name, view=seen)
    drawn = draw_amplitude(panels[0], shown, extent.unit, peak_dbsm(shown) if dbsm else None)
    amplitude_bar(panels[:1], drawn, dbsm=dbsm)
    if n == 2:
        depth = draw_depth(panels[1], shown, extent.unit, depth_limits_mm([shown]))
        depth_bar(panels[1:], depth, [shown], seen)
    return settled(figure)


def _three_views(
    image: Volume | DepthMap, title: str | None, dynamic_range_db: float, *, dbsm: bool
) -> Figure:
    """Draw the maximum of a volume along z, y and x, all below the same maximum at one scale."""
    if not isinstance(image, Volume):
        raise CompareError("view: expected a volume to draw from all sides, got a depth map")
    depth_map_of(image, dynamic_range_db, "image")  # whose error says what cannot be drawn
    shown = {name: projected(image, VIEWS[name], dynamic_range_db, "image") for name in VIEWS}
    unit = Extent.around(list(shown.values())).unit
    extents = [Extent.around([one], unit) for one in shown.values()]
    spans = [[float(np.ptp(ends)) for ends in (extent.x, extent.y)] for extent in extents]
    widest, highest = (max(span[i] for span in spans) for i in (0, 1))
    size = panel_size(0.8 * SINGLE_PANEL_WIDTH, highest / widest)
    figure, (panels,) = new_panels(1, 3, size, title, labels=3)
    top_db = max(peak_dbsm(one) for one in shown.values()) if dbsm else None
    for panel, (name, one), extent in zip(panels, shown.items(), extents, strict=True):
        # One scale in all: the limits of the smaller ones are widened around their middle.
        x, y = (
            (min(ends) - (whole - np.ptp(ends)) / 2, max(ends) + (whole - np.ptp(ends)) / 2)
            for ends, whole in ((extent.x, widest), (extent.y, highest))
        )
        wide = Extent(x, y, unit)
        draw_frame(panel, wide, f"maximum over {VIEWS[name].along}", view=VIEWS[name])
        drawn = draw_amplitude(panel, one, unit, top_db)
    amplitude_bar(panels, drawn, dbsm=dbsm)
    return settled(figure)


def panels_figure(
    panels: Sequence[Sequence[tuple[str, DepthMap | None]]],
    title: str | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Figure:
    """Draw the amplitudes of several images in rows, each relative to its own maximum.

    `panels` has rows of (label, image), from top to bottom; a panel stays empty without an image.
    Each panel has its own axes; then comes the colour bar.
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
    rows, columns = len(panels), max(map(len, panels))
    width = max(ROW_WIDTH / columns - LABELS, PANEL_WIDTH)
    titles = [[wrapped(label, width + LABELS / 2, TICK_PT) for label, _ in row] for row in panels]
    size = (width, width)
    figure, drawn_in = new_panels(rows, columns, size, title, labels=columns, dpi=DPI / 2)
    drawn: Any = None
    for lines, ones, all_axes in zip(titles, shown, drawn_in, strict=True):
        for axes, name, one in zip(all_axes, lines, ones, strict=False):
            if one is None:
                axes.set(xticks=[], yticks=[], box_aspect=1.0, anchor="S")
            else:
                extent = Extent.around([one])
                drawn = draw_amplitude(axes, one, extent.unit)
                draw_frame(axes, extent)
            axes.set_title("\n".join(name), fontsize=TICK_PT, pad=3, parse_math=False)
        for axes in all_axes[len(ones) :]:
            axes.remove()
    amplitude_bar(list(figure.axes), drawn)
    return settled(figure)
