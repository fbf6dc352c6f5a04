"""Frames of a recording: one picture each, all with the same scales, and curves over time."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import CompareError
from clradar.files.atomic import write_file
from clradar.model import DepthMap
from clradar.plot.figures import image_figure
from clradar.plot.layout import LABEL_PT, TICK_PT, label_axes, new_figure, printable
from clradar.plot.panels import CURVE_COLOURS
from clradar.plot.saving import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BOUNDED = ("overlap",)
"""Names of panels whose values are from 0 to 1."""

PICTURE_DPI = 120
LEAST_STEP_S = 0.02
"""Between pictures of a GIF; browsers slow down those that are faster."""


class FramePictures:
    """Draws the frames of a recording, level and depth with the same colours in every frame."""

    def __init__(self, images: Iterable[DepthMap], dynamic_range_db: float) -> None:
        reference: DepthMap | None = None
        for image in images:
            if reference is None:
                reference = image
                continue
            higher = image.amplitude > reference.amplitude
            reference = DepthMap(
                np.where(higher, image.depth_m, reference.depth_m),
                np.maximum(image.amplitude, reference.amplitude),
                image.x_m, image.y_m, dynamic_range_db,
            )  # fmt: skip
        if reference is None or not reference.amplitude.any():
            raise CompareError("FramePictures: expected an image above zero, got none")
        self._range_db = dynamic_range_db
        self._top = float(reference.amplitude.max())
        self._figure = image_figure(reference, "-", dynamic_range_db=dynamic_range_db)
        self._title = self._figure.texts[-1]
        self._level, self._depth = (axes.collections[0] for axes in self._figure.axes[:2])

    def png(self, image: DepthMap | None, title: str) -> bytes:
        """Return the picture of a frame; without an image it is empty."""
        level_db, depth_m = np.full((2, *self._level.get_array().shape), np.nan)  # type: ignore[union-attr]
        if image is not None:
            with np.errstate(divide="ignore"):
                level_db = 20 * np.log10(image.amplitude.astype(np.float64) / self._top)
            level_db[level_db <= -self._range_db] = np.nan
            depth_m = image.depth_m
        self._level.set_array(np.ma.masked_invalid(level_db))
        self._depth.set_array(np.ma.masked_invalid(1e3 * depth_m))
        self._title.set_text(printable(title))
        return png_bytes(self._figure, dpi=PICTURE_DPI)


def write_gif(path: Path, pictures: Sequence[Path], step_s: float) -> None:
    """Write PNG files as an animated GIF that repeats, all with the colours of the first."""
    from PIL import Image

    def frames() -> Iterator[Image.Image]:
        palette: Image.Image | None = None
        for picture in pictures:
            with Image.open(picture) as opened:
                image = opened.convert("RGB")
            palette = palette or image.quantize(255)
            yield image.quantize(palette=palette, dither=Image.Dither.NONE)

    step_ms = 10 * round(100 * max(step_s, LEAST_STEP_S))
    first, *others = frames()
    content = io.BytesIO()
    first.save(
        content, "GIF", save_all=True, append_images=others, duration=step_ms, loop=0,
        optimize=False,
    )  # fmt: skip
    write_file(path, content.getvalue(), force=True)


def curves_figure(
    time: np.ndarray, panels: Mapping[str, Mapping[str, np.ndarray]], time_name: str, title: str
) -> Figure:
    """Draw quantities over time, one panel below the other."""
    figure = new_figure(8.0, 1.0 * len(panels) + 0.9, title)
    rows: list[Any] = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0].tolist()
    for axes, (name, curves) in zip(rows, panels.items(), strict=True):
        for i, (label, values) in enumerate(curves.items()):
            axes.plot(time, values, ".-", color=CURVE_COLOURS[i % len(CURVE_COLOURS)],
                      linewidth=1.0, markersize=3.0, label=printable(label))  # fmt: skip
        label_axes(axes, "", name)
        if name in BOUNDED:
            low, high = axes.get_ylim()
            axes.set_ylim(max(low, -0.02), min(high, 1.02))
        if len(curves) > 1:
            axes.legend(
                loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TICK_PT, frameon=False
            )
    rows[-1].set_xlabel(time_name, fontsize=LABEL_PT)
    figure.align_ylabels()
    return figure
