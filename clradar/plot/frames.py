"""Frames of a recording: one picture each, all with the same scales, and curves over time."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clradar.errors import CompareError
from clradar.files.atomic import write_file
from clradar.model import DepthMap
from clradar.plot.figures import image_figure
from clradar.plot.layout import LABEL_PT, TICK_PT, TITLE_PT, printable
from clradar.plot.saving import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of Okabe and Ito (2008)."""

PICTURE_DPI = 120
LEAST_STEP_S = 0.02
"""Between pictures of a GIF; browsers slow down those that are faster."""


class FramePictures:
    """Draws the frames of a recording, level and depth with the same colours in every frame.

    Parameters
    ----------
    images : iterable of DepthMap
        All frames, of the same pixels; gone through once for the scales.
    dynamic_range_db : float, decibel
        Pixels further below the maximum of all frames are background.

    Raises
    ------
    CompareError
        No image above zero.
    """

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
    """Write PNG files as an animated GIF that repeats; one picture is in memory at a time.

    Parameters
    ----------
    path : Path
        Replaced if it is there.
    pictures : sequence of Path
        At least one; all of the same size.
    step_s : float, seconds
        From one to the next, rounded to hundredths, of which a GIF counts.
    """
    from PIL import GifImagePlugin, Image

    # Block by block: `Image.save` keeps all frames until it has the last one.
    step_ms = 10 * round(100 * max(step_s, LEAST_STEP_S))
    colours: Image.Image | None = None
    before = np.empty((0, 0), np.uint8)
    content = io.BytesIO()
    for picture in pictures:
        with Image.open(picture) as opened:
            image = opened.convert("RGB")
        if colours is None:
            colours = image.quantize(255)
        frame = image.quantize(palette=colours, dither=Image.Dither.NONE)
        codes = np.asarray(frame)
        if not content.tell():
            content.writelines(GifImagePlugin.getheader(frame, info={"loop": 0})[0])
        box = left, top, right, bottom = _changed(before, codes)
        part = codes[top:bottom, left:right]
        if before.size:  # the colour behind the 255: as before
            part = np.where(part == before[top:bottom, left:right], np.uint8(255), part)
        content.writelines(
            GifImagePlugin.getdata(
                Image.fromarray(part), box[:2], duration=step_ms, transparency=255
            )
        )
        before = codes
    content.write(b";")
    write_file(path, content.getvalue(), force=True)


def _changed(before: np.ndarray, now: np.ndarray) -> tuple[int, int, int, int]:
    """The box of the pixels that changed: left, top, and behind right and bottom; one at least."""
    if before.shape != now.shape:
        return 0, 0, now.shape[1], now.shape[0]
    rows, columns = (np.flatnonzero((before != now).any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def curves_figure(
    time: np.ndarray, panels: Mapping[str, Mapping[str, np.ndarray]], time_name: str, title: str
) -> Figure:
    """Draw quantities over time, one panel below the other.

    Parameters
    ----------
    time : ndarray, shape (n,)
    panels : mapping of axis name -> curves
        Curves by their name, each of shape (n,); NaN leaves a gap.
    time_name : str
        With its unit, as the names of the panels.
    title : str
        Plain text.
    """
    from matplotlib.figure import Figure

    height = 1.5 * len(panels) + 0.9
    figure = Figure(figsize=(8.0, height), facecolor="white")
    for axes, (name, curves) in zip(
        figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0],
        panels.items(),
        strict=True,
    ):
        for i, (label, values) in enumerate(curves.items()):
            colour = COLOURS[i % len(COLOURS)]
            axes.plot(time, values, color=colour, linewidth=1.0, marker=".", markersize=3.0,
                      label=printable(label))  # fmt: skip
        axes.set_ylabel(name, fontsize=LABEL_PT)
        axes.tick_params(labelsize=TICK_PT)
        axes.grid(color="0.9", linewidth=0.5)
        if len(curves) > 1:
            axes.legend(
                loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TICK_PT, frameon=False
            )
    axes.set_xlabel(time_name, fontsize=LABEL_PT)
    figure.suptitle(printable(title), fontsize=TITLE_PT, parse_math=False)
    bottom, top = 0.5 / height, 1 - 0.4 / height
    figure.subplots_adjust(left=0.11, right=0.8, bottom=bottom, top=top, hspace=0.12)
    figure.align_ylabels()
    return figure
