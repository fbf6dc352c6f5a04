from .array import array_figure as array_figure
from .captures import capture_figure as capture_figure, recording_figure as recording_figure
from .images import (
    comparison_figure as comparison_figure,
    image_figure as image_figure,
    panels_figure as panels_figure,
)
from .saving import save_figure as save_figure
from .views import plane_of as plane_of
