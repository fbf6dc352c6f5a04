"""Pictures with axes as arrays: projection, depth map, their difference, slices, and channels."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from clradar.compare.images import check_same_pixels
from clradar.errors import CompareError
from clradar.model import Capture, DepthMap
from clradar.model.length_unit import unit_for
from clradar.model.range_profile import hann, profile_transform
from clradar.plot.drawing import BELOW_MAXIMUM, DEPTH_MM, depth_limits_mm
from clradar.view.drawn import SCALES, Drawn, below_db, colours_on, nearest
from clradar.view.wish import Place

SIZE_INCHES, DPI = (3.8, 3.3), 140  # of a picture
PAPER, INK = "#1f1f1f", "#d8d8d8"

MARK_COLOUR = (53, 208, 224)

OVERVIEW_DB = 40.0  # range of the overview of all pairs
SHOWN_DB = 60.0  # what is this far below the maximum of a curve is drawn at its lower edge
PROFILE_PLACES = 600  # of a range profile, at most: more than a panel has pixels
DEPTH_STEP_MM = 5.0  # ends of the scale of depths are multiples, and stay from frame to frame


class Axis(NamedTuple):
    """A name with its unit, and the values at the left or lower and at the right or upper edge.

    A colour bar has a scale, of `SCALES`, as well; without a name it is not drawn.
    """

    name: str
    first: float
    last: float
    scale: str = ""


Box: TypeAlias = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image with its axes, in a unit of so many metres.

    The box has left, top, right and bottom of the image within, pixels.
    """

    pixels: np.ndarray
    box: Box
    across: Axis
    up: Axis
    to_m: float

    def values_m(self, across: float, down: float) -> tuple[float, float] | None:
        """Return the values on both axes at shares of width and height, metres; None: beside it."""
        left, top, right, bottom = self.box
        rows, columns = self.pixels.shape[:2]
        shares = (across * columns - left) / (right - left), (bottom - down * rows) / (bottom - top)
        if not all(0.0 <= share <= 1.0 for share in shares):
            return None
        x, y = (
            self.to_m * (axis.first + share * (axis.last - axis.first))
            for share, axis in zip(shares, (self.across, self.up), strict=True)
        )
        return x, y


def image_pictures(
    first: Drawn, second: Drawn | None, chosen: Drawn, at_m: Place | None
) -> dict[str, Picture]:
    """Return projection, depth map, and of two images the difference in depth, by their names.

    Where only one of the first two is known, it is alone. x is to the left, as the radar sees it.
    """
    image, pictures = chosen.image, {}
    marked = None if at_m is None else (at_m[0], at_m[1])
    if "projection" in chosen.known:
        title = "Amplitude, maximum over depth"
        bar = Axis(BELOW_MAXIMUM, -image.dynamic_range_db, 0.0, "amplitude")
        level_db = below_db(image.amplitude, float(image.amplitude.max()))
        pictures["projection"] = _in_radar_view(title, level_db, bar, image, marked)
    if "depth" in chosen.known:
        title, bar, per_m = "Depth: nothing above zero", Axis("", 0.0, 1.0, "depth"), 1.0
        if image.mask.any():
            low, high = (end / DEPTH_STEP_MM for end in depth_limits_mm([image]))
            near_m, far_m = (1e-3 * DEPTH_STEP_MM * x for x in (np.floor(low), np.ceil(high)))
            unit = unit_for(near_m, far_m)
            title, per_m = "Depth", unit.per_m
            bar = Axis(f"depth z ({unit.name})", per_m * near_m, per_m * far_m, "depth")
        pictures["depth"] = _in_radar_view(title, per_m * image.depth_m, bar, image, marked)
    if second is not None:
        with suppress(CompareError):  # on different voxels there is none
            check_same_pixels(first.image, second.image)
            bar = Axis("simulated - measured (mm)", -DEPTH_MM, DEPTH_MM, "difference")
            farther_mm = 1e3 * (second.image.depth_m - first.image.depth_m)
            title = "Difference in depth"
            pictures["difference"] = _in_radar_view(title, farther_mm, bar, first.image, None)
    return pictures


def slice_pictures(drawn: Drawn, at_m: Place) -> dict[str, Picture]:
    """Return x-y, x-z and z-y slices of a volume, if there is one, through the voxel nearest to a
    place, with levels relative to its strongest voxel.
    """
    if drawn.volume is None:
        return {}
    data, grid, range_db = drawn.volume.data, drawn.volume.grid, drawn.image.dynamic_range_db
    i, j, k = nearest(grid, at_m)
    to_m, (x, y, z) = _length_axes({"x": grid.x_m, "y": grid.y_m, "z": grid.z_m})
    at = float(grid.x_m[i]), float(grid.y_m[j]), float(grid.z_m[k])
    peak, bar = float(np.abs(data).max()), Axis(BELOW_MAXIMUM, -range_db, 0.0, "amplitude")
    found = {}
    for name, title, rows, across, up, marked in (
        ("xy", "Slice across z", data[k, ::-1, ::-1], x, y, (at[0], at[1])),
        ("xz", "Slice across y", data[::-1, j, ::-1], x, z, (at[0], at[2])),
        ("zy", "Slice across x", data[:, ::-1, i].T, z, y, (at[2], at[1])),
    ):
        level_db = below_db(np.abs(rows), peak)
        found[name] = _picture(title, level_db, bar, across, up, to_m, marked)
    return found


def overview_picture(capture: Capture, tx: int, rx: int) -> Picture:
    """Return the RMS over frequency of all pairs of antennas, Tx upwards."""
    n_tx, n_rx, _ = capture.data.shape
    level = np.linalg.norm(capture.data, axis=2)
    across, up = Axis("Rx", -0.5, n_rx - 0.5), Axis("Tx", -0.5, n_tx - 0.5)
    level_db = below_db(level, float(level.max()))
    bar = Axis(BELOW_MAXIMUM, -OVERVIEW_DB, 0.0, "amplitude")
    return _picture("RMS over frequency", level_db[::-1], bar, across, up, 1.0, (rx, tx))


def pair_curves(
    capture: Capture, tx: int, rx: int
) -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
    """Return magnitude (dB), phase (turns) and range profile (dB) of a pair: name and values of x,
    and values of y, all finite.
    """
    tx, rx = min(tx, capture.array.n_tx - 1), min(rx, capture.array.n_rx - 1)
    waveform = capture.waveform
    samples = capture.data[tx, rx].astype(np.complex128)
    turns = np.unwrap(np.angle(samples)) / (2 * np.pi)
    place_m = np.linspace(0.0, waveform.unambiguous_range_m, PROFILE_PLACES)
    weights = hann(waveform.n_freq)
    profile = samples @ profile_transform(waveform, weights, 2 * place_m)
    frequency = ("frequency (GHz)", 1e-9 * waveform.frequencies_hz)
    return {
        "magnitude (dB)": (*frequency, _level_db(samples)),
        "phase (turns)": (*frequency, turns),
        "range profile (dB)": ("half the path (mm)", 1e3 * place_m, _level_db(profile)),
    }


def _level_db(samples: np.ndarray) -> np.ndarray:
    level_db = below_db(np.maximum(np.abs(samples), 1e-30), 1.0)
    return np.maximum(level_db, level_db.max() - SHOWN_DB)


def _in_radar_view(
    title: str,
    values: np.ndarray,
    bar: Axis,
    image: DepthMap,
    marked: tuple[float, float] | None,
) -> Picture:
    to_m, (x, y) = _length_axes({"x": image.x_m, "y": image.y_m})
    return _picture(title, values[::-1, ::-1], bar, x, y, to_m, marked)


def _length_axes(centres_m: Mapping[str, np.ndarray]) -> tuple[float, list[Axis]]:
    """Return the unit in metres, and the axes of pixels with these centres, from edge to edge."""
    unit = unit_for(*(float(axis[i]) for axis in centres_m.values() for i in (0, -1)))
    axes = []
    for name, axis_m in centres_m.items():
        step_m = float(np.diff(axis_m).min()) if len(axis_m) > 1 else 1e-3
        ends = (unit.per_m * (axis_m[i] + s * step_m / 2) for i, s in ((0, -1), (-1, 1)))
        first, last = (round(float(end), 6) for end in ends)
        if name == "x":
            name, first, last = "\N{LEFTWARDS ARROW} x", last, first
        axes.append(Axis(f"{name} ({unit.name})", first, last))
    return 1 / unit.per_m, axes


def _picture(
    title: str,
    values: np.ndarray,
    bar: Axis,
    across: Axis,
    up: Axis,
    to_m: float,
    marked: tuple[float, float] | None,
) -> Picture:
    """Draw values, the first row of which is the upper one, in axes; mark a place of them."""
    paper, box = _paper(title, across, up, bar)
    left, top, right, bottom = box
    pixels = colours_on(bar.scale, values, bar.first, bar.last)
    rows = (np.arange(bottom - top) * len(pixels)) // (bottom - top)
    columns = (np.arange(right - left) * pixels.shape[1]) // (right - left)
    drawn = paper.copy()
    drawn[top:bottom, left:right] = pixels[rows[:, None], columns]
    if marked is not None:
        shares = (
            (value / to_m - axis.first) / (axis.last - axis.first)
            for value, axis in zip(marked, (across, up), strict=True)
        )
        column, row = next(shares), next(shares)
        if 0 <= column < 1:
            drawn[top:bottom, left + int(column * (right - left))] = MARK_COLOUR
        if 0 < row <= 1:
            drawn[bottom - 1 - int(row * (bottom - top - 1)), left:right] = MARK_COLOUR
    return Picture(drawn, box, across, up, to_m)


@lru_cache(maxsize=64)
def _paper(title: str, across: Axis, up: Axis, bar: Axis) -> tuple[np.ndarray, Box]:
    """Return axes without an image, and where it goes: drawn once, not for every frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(SIZE_INCHES, DPI, facecolor=PAPER, layout="compressed")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.set(
        xlim=(across.first, across.last), ylim=(up.first, up.last), aspect="equal", title=title,
        xlabel=across.name, ylabel=up.name, facecolor=PAPER,
    )  # fmt: skip
    panels = [axes]
    if bar.name:
        drawn = ScalarMappable(Normalize(bar.first, bar.last), SCALES[bar.scale])
        places = MaxNLocator(5, steps=[1, 2, 5, 10])
        panels.append(figure.colorbar(drawn, ax=axes, label=bar.name, ticks=places, shrink=0.9).ax)
        if bar.scale == "depth":
            panels[1].invert_yaxis()  # near is above
    for panel in panels:
        panel.tick_params(colors=INK)
        for text in (panel.title, panel.xaxis.label, panel.yaxis.label):
            text.set_color(INK)
        for spine in panel.spines.values():
            spine.set_edgecolor(INK)
    canvas.draw()
    extent = axes.get_window_extent()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    left, right = round(extent.x0) + 1, round(extent.x1)
    top, bottom = len(pixels) - round(extent.y1) + 1, len(pixels) - round(extent.y0)
    return pixels, (left, top, max(right, left + 1), max(bottom, top + 1))
