"""Where the panels of a figure are, so that a click in its picture finds a place in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from clradar.model import DepthMap
from clradar.plot.layout import Extent

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def panel_places(figure: Figure, images: Sequence[DepthMap]) -> list[dict[str, Any]]:
    """Return the panels of amplitudes and depths, in types of JSON.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Its first axes are the amplitudes of the images and then their depths, x to the side and y
        upwards.
    images : sequence of DepthMap

    Returns
    -------
    list of dict
        `image`: the index; `box`: left, lower, right, upper end, fractions of the figure; `x`, `y`:
        millimetres at the left and right, and at the lower and upper end.
    """
    to_mm = 1e3 / Extent.around(images).unit.per_m
    places = []
    for i, axes in enumerate(figure.axes[: 2 * len(images)]):
        axes.apply_aspect()  # an image of another shape fills a part of its place
        places.append(
            {
                "image": i % len(images),
                "box": list(axes.get_position().extents),
                "x": [to_mm * value for value in axes.get_xlim()],
                "y": [to_mm * value for value in axes.get_ylim()],
            }
        )
    return places
