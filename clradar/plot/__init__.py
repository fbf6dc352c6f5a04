"""Figures of images and comparisons, in the radar's view (x increases to the left), and captures.

Everything is built on `matplotlib.figure.Figure`: no pyplot, no open windows, no state between
calls.
"""

from clradar.plot.array import array_figure
from clradar.plot.captures import capture_figure, recording_figure
from clradar.plot.comparison import comparison_figure
from clradar.plot.figures import image_figure, panels_figure
from clradar.plot.saving import save_figure
from clradar.plot.views import plane_of

__all__ = [
    "array_figure",
    "capture_figure",
    "comparison_figure",
    "image_figure",
    "panels_figure",
    "plane_of",
    "recording_figure",
    "save_figure",
]


def __dir__() -> list[str]:
    return sorted(__all__)
