"""The figure of a volume from three sides: maximum along z, along y and along x."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clradar.compare import depth_map_of
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume
from clradar.model.length_unit import unit_for
from clradar.plot.layout import (
    BAR_GAP,
    BAR_LABELS,
    BAR_WIDTH,
    BOTTOM,
    LABEL_PT,
    LEFT,
    SINGLE_PANEL_WIDTH,
    TITLE_PT,
    TOP,
    Extent,
    add_axes,
    add_text,
    new_figure,
    panel_size,
    text_height,
    wrapped,
)
from clradar.plot.panels import amplitude_bar, draw_amplitude, draw_frame, peak_dbsm
from clradar.plot.views import VIEWS, projected

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def three_views_figure(
    image: Volume | DepthMap, title: str | None, dynamic_range_db: float, *, dbsm: bool
) -> Figure:
    """Draw the maximum of a volume along z, y and x, all below the same maximum."""
    if not isinstance(image, Volume):
        raise CompareError("view: expected a volume to draw from all sides, got a depth map")
    depth_map_of(image, dynamic_range_db, "image")  # of what cannot be drawn it says why
    shown = {name: projected(image, VIEWS[name], dynamic_range_db, "image") for name in VIEWS}
    grid = image.grid
    unit = unit_for(*grid.origin_m, *(grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1)))
    extents = [Extent.around([one], unit) for one in shown.values()]
    sizes = [panel_size(SINGLE_PANEL_WIDTH, extent.aspect) for extent in extents]
    bar = BAR_GAP + BAR_WIDTH + BAR_LABELS
    width = sum(LEFT + panel_w for panel_w, _ in sizes) + bar
    lines = wrapped(title or "", width - LEFT - bar, TITLE_PT)
    panel_h = max(height for _, height in sizes)
    titles_h = text_height(1, LABEL_PT) + text_height(len(lines), TITLE_PT)
    height = BOTTOM + panel_h + titles_h + 2 * TOP
    figure = new_figure(width, height)
    top_db = max(peak_dbsm(one) for one in shown.values()) if dbsm else None
    left, drawn = 0.0, None
    for (name, one), extent, (panel_w, own_h) in zip(shown.items(), extents, sizes, strict=True):
        panel = add_axes(figure, left + LEFT, BOTTOM, panel_w, own_h)
        draw_frame(
            panel, extent, panel_w, own_h,
            x_labels=True, y_labels=True, margin=0.0, view=VIEWS[name],
        )  # fmt: skip
        drawn = draw_amplitude(panel, one, unit, top_db)
        panel.set_title(f"maximum over {VIEWS[name].along}", fontsize=LABEL_PT, pad=4)
        left += LEFT + panel_w
    amplitude_bar(
        add_axes(figure, left + BAR_GAP, BOTTOM, BAR_WIDTH, max(panel_h, 1.0)),
        drawn, dynamic_range_db, top_db,
    )  # fmt: skip
    for row, line in enumerate(lines):
        top = height - TOP - text_height(row, TITLE_PT)
        add_text(figure, (LEFT + left) / 2, top, line, size=TITLE_PT, ha="center", bold=True)
    return figure
