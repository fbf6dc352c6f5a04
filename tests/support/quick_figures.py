"""Stand-ins for figures, which take a second each, and other short cuts of tests of commands."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import clradar.report.page  # noqa: F401  (it keeps the real ones)
from clradar.model import DepthMap


def no_figure(figure: Any, path: Path, **options: Any) -> None:
    """Stands for `clradar.plot.save_figure`."""
    path.write_bytes(b"drawn")


class Levels:
    """Stands for `clradar.plot.captures.FramePictures`: the level of each pixel."""

    def __init__(self, images: Any, _: float) -> None:
        self.shape = next(image.amplitude.shape for image in images)

    def png(self, image: DepthMap | None, _: str) -> bytes:
        level = np.zeros(self.shape) if image is None else image.amplitude / image.amplitude.max()
        file = io.BytesIO()
        Image.fromarray((255 * level).astype(np.uint8)).save(file, "PNG")
        return file.getvalue()


def lay_out_once(patch: pytest.MonkeyPatch) -> None:
    """Leave axes of figures where they are: finding better places costs as much as drawing."""
    patch.setattr(
        "clradar.plot.drawing.settled",
        lambda figure, *_: figure.set_layout_engine("none") or figure,
    )


def seek_nothing_else(patch: pytest.MonkeyPatch) -> None:
    """Let images be formed without a search for grating lobes and for echoes beside the grid."""
    for name in ("warn_of_confusions", "_echo_outside"):
        patch.setattr(f"clradar.imaging.grid_check.{name}", lambda *_, **__: None)


def draw_quickly(patch: pytest.MonkeyPatch) -> None:
    """Let commands make figures without content."""
    patch.setattr("clradar.plot.captures.FramePictures", Levels)
    patch.setattr("clradar.plot.save_figure", no_figure)
    patch.setattr("clradar.plot.captures.curves_figure", lambda *_: Figure())
    for kind in ("image", "comparison", "capture", "recording"):
        patch.setattr(f"clradar.plot.{kind}_figure", lambda *_, **__: Figure())
