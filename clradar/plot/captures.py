"""Figures of captures and of recordings: echoes, levels, frames in the same colours, curves."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from clradar.errors import CompareError, quoted
from clradar.files.atomic import write_file
from clradar.model import Capture, DepthMap, checks
from clradar.model.length_unit import unit_for
from clradar.model.progress import Progress
from clradar.model.range_profile import PROFILE_PAIRS, RangeProfile, antenna_subset, range_profile
from clradar.plot import drawing
from clradar.plot.images import image_figure
from clradar.plot.saving import figure_bytes

SIZE_INCHES, DPI = (8.0, 3.2), 200
SHOWN_DB = 60.0  # of echoes below the strongest: the coupling of antennas, where it is recorded
PAIRS_DB = 30.0  # of levels of channels below the strongest one
PICTURE_DPI = 120
LEAST_STEP_S = 0.02  # between pictures of a GIF; browsers slow down those that are faster


def capture_figure(capture: Capture, title: str | None = None) -> Figure:
    """Draw what is in a capture without forming an image.

    Axes in this order: mean power over range, half of the path length, dB below its maximum (not of
    a single frequency); RMS level of every pair of antennas; its colour bar.
    """
    checks.instance("capture_figure: capture", capture, Capture)
    if not capture.data.any():
        raise CompareError("capture_figure: expected samples to draw, got zeros")
    ranged = capture.waveform.n_freq > 1
    figure, panels = _panels(title, 2 if ranged else 1)
    if ranged:
        profile = range_profile(capture)
        unit = unit_for(profile.path_m[-1] / 2)
        ranges = unit.per_m * profile.path_m / 2
        level_db = _level_db(profile.power)
        panels[0].plot(ranges, level_db, color=drawing.CURVE_COLOURS[0], linewidth=0.9)
        panels[0].set(xlim=(0, _reach(ranges, level_db)), ylim=(-SHOWN_DB, 2))
        x_name = f"half path length ({unit.name})"
        title = "Echoes, mean power of all pairs"
        drawing.label_axes(panels[0], x_name, drawing.BELOW_MAXIMUM, title)
    power = np.asarray(np.mean(np.abs(capture.data) ** 2, axis=2, dtype=np.float64))
    drawn = panels[-1].imshow(
        _level_db(power), origin="lower", aspect="auto", vmin=-PAIRS_DB, vmax=0, cmap="viridis"
    )
    for axis in (panels[-1].xaxis, panels[-1].yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    drawing.label_axes(panels[-1], "Rx", "Tx", "Level of every pair", grid=False)
    drawing.add_bar(panels[-1:], drawn)
    return figure


def _reach(ranges: np.ndarray, level_db: np.ndarray) -> float:
    """Return where the axis of ranges ends: twice as far as the last that is shown."""
    return float(min(ranges[-1], 2 * ranges[np.flatnonzero(level_db > -SHOWN_DB)[-1]]))


def recording_figure(
    captures: Iterable[Capture],
    frames: Sequence[int],
    title: str | None = None,
    *,
    progress: Progress | None = None,
) -> Figure:
    """Draw the echoes of a recording over range and time, without forming images.

    `captures` are the frames, one in memory at a time, `frames` their numbers. Axes in this order:
    power over range for every frame, from some of the pairs, dB below the maximum of all frames
    (not of a single frequency); RMS level of every frame; the colour bar of the first.
    """
    profiles: list[RangeProfile] = []
    levels = []
    for done, capture in enumerate(checks.several("recording_figure: captures", captures), 1):
        levels.append(float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64)))
        if capture.waveform.n_freq > 1:
            profiles.append(range_profile(antenna_subset(capture, PROFILE_PAIRS)))
        if progress is not None:
            progress(done, len(frames))
    if not any(levels):
        raise CompareError("recording_figure: expected samples to draw, got zeros")
    figure, panels = _panels(title, 2 if profiles else 1)
    if profiles:
        power = np.array([profile.power for profile in profiles])
        unit = unit_for(profiles[0].path_m[-1] / 2)
        places = unit.per_m * profiles[0].path_m / 2
        drawn = panels[0].pcolormesh(
            frames, places, _level_db(power).T, vmin=-SHOWN_DB, vmax=0, cmap="viridis",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        y_name = f"half path length ({unit.name})"
        panels[0].set_ylim(0, _reach(places, _level_db(power).max(axis=0)))
        drawing.label_axes(panels[0], "frame", y_name, "Echoes of every frame", grid=False)
        drawing.add_bar(panels[:1], drawn)
    panels[-1].plot(
        frames, _level_db(np.array(levels)), ".-",
        color=drawing.CURVE_COLOURS[0], linewidth=0.9, markersize=4,
    )  # fmt: skip
    drawing.label_axes(panels[-1], "frame", "RMS below maximum (dB)", "Level of every frame")
    for panel in panels:
        panel.xaxis.get_major_locator().set_params(integer=True)
    return figure


def _panels(title: str | None, count: int) -> tuple[Figure, list[Any]]:
    figure = drawing.new_figure(*SIZE_INCHES, title, DPI)
    return figure, figure.subplots(1, count, squeeze=False)[0].tolist()


def _level_db(power: np.ndarray) -> np.ndarray:
    """Decibel below the maximum; what is zero is far below what is shown."""
    return np.asarray(10 * np.log10(np.maximum(power / power.max(), 1e-20)))


class FramePictures:
    """Draws the frames of a recording, level and depth with the same colours in every frame."""

    def __init__(self, images: Iterable[DepthMap], dynamic_range_db: float) -> None:
        others = iter(images)
        reference: Any = next(others, None)
        for image in others:
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
        self._title.set_text(quoted(title))
        return figure_bytes(self._figure, dpi=PICTURE_DPI)


def write_gif(path: Path, pictures: Sequence[Path], step_s: float) -> None:
    """Write PNG files as an animated GIF that repeats, all with the colours of the first."""

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
    figure = drawing.new_figure(8.0, 1.0 * len(panels) + 0.9, title)
    rows: list[Any] = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0].tolist()
    for axes, (name, curves) in zip(rows, panels.items(), strict=True):
        for (label, values), colour in zip(curves.items(), cycle(drawing.CURVE_COLOURS)):
            axes.plot(time, values, ".-", color=colour, lw=1.0, ms=3.0, label=quoted(label))
        drawing.label_axes(axes, "", name)
        if len(curves) > 1:
            beside: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
            axes.legend(fontsize=drawing.TICK_PT, frameon=False, **beside)
    rows[-1].set_xlabel(time_name, fontsize=drawing.LABEL_PT)
    figure.align_ylabels()
    return figure
