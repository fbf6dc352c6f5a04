"""Volumes as they are drawn: points, voxels, projection, depth map, and their differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from clradar.compare import clipped_db
from clradar.compare.images import check_same_pixels
from clradar.model import DepthMap, Volume
from clradar.model.length_unit import LengthUnit, unit_for
from clradar.plot import AMPLITUDE_BACKGROUND, DEPTH_BACKGROUND, depth_limits_mm
from clradar.plot.differences import DEPTH_MM, MEASURED_COLOUR, SIMULATED_COLOUR
from clradar.view.framed import Axis, Bar, framed

MAX_VOXELS_DRAWN = 60_000
"""Voxels of one frame, strongest first: 9 bytes each go over the wire."""


SECOND_WEAK, SECOND_STRONG = np.array([0, 70, 90]), np.array([150, 255, 255])
"""Colours of the second volume at the end of the dynamic range, and at its maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points and their colours.

    Attributes
    ----------
    points_m : ndarray, shape (n, 3), float32, metres
        x, y, z in the antenna frame.
    colours : ndarray, shape (n, 3), uint8
    """

    points_m: np.ndarray
    colours: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What is drawn of one volume: its depth map, and the depth points coloured by amplitude."""

    image: DepthMap
    cloud: Cloud


def picture_of(volume: Volume, dynamic_range_db: float, second: bool = False) -> Picture:
    """Return depth map and depth points of a volume, in the colours of a second one if it is.

    Raises
    ------
    ModelError
        As `Volume.depth_map`.
    """
    image = volume.depth_map(dynamic_range_db)
    colours = np.empty((0, 3), np.uint8)
    if image.mask.any():
        colours = amplitude_colours(clipped_db(image)[image.mask], dynamic_range_db, second)
    return Picture(image, Cloud(image.points_m().astype(np.float32), colours))


def projection_drawing(image: DepthMap, marked_mm: tuple[float, float] | None = None) -> str:
    """Return the maximum projection as SVG, in the radar's view: y upwards, x to the left."""
    peak = float(image.amplitude.max())
    pixels = amplitude_pixels(image.amplitude, peak, image.dynamic_range_db)
    return _in_radar_view(
        "Maximum along z", pixels, image, amplitude_bar(image.dynamic_range_db), marked_mm
    )


def depth_drawing(image: DepthMap, marked_mm: tuple[float, float] | None = None) -> str:
    """Return the depth map as SVG, in the radar's view."""
    mask = image.mask
    pixels = _blank(mask.shape, DEPTH_BACKGROUND)
    if not mask.any():
        return _in_radar_view("Depth: nothing seen", pixels, image, None, marked_mm)
    first, last = depth_limits_mm([image])
    scale = _scale("viridis_r", 0.0)
    pixels[mask] = scale[_index((1e3 * image.depth_m[mask] - first) / (last - first))]
    # As in the figures, near is above.
    unit = unit_for(first / 1e3, last / 1e3)
    ends = (unit.per_m / 1e3 * end for end in (last, first))
    bar = Bar(Axis(f"z ({unit.name})", *ends), scale[::-1])
    return _in_radar_view("Depth", pixels, image, bar, marked_mm)


def difference_drawing(first: DepthMap, second: DepthMap) -> str:
    """Return where the second image is nearer or farther than the first, as SVG.

    Raises
    ------
    CompareError
        Images of other pixels.
    """
    check_same_pixels(first, second)
    differs_mm = 1e3 * (second.depth_m - first.depth_m)
    seen = np.isfinite(differs_mm)
    pixels = _blank(seen.shape, DEPTH_BACKGROUND)
    scale = _difference_scale()
    pixels[seen] = scale[_index((differs_mm[seen] + DEPTH_MM) / (2 * DEPTH_MM))]
    bar = Bar(Axis("mm", -DEPTH_MM, DEPTH_MM), scale)
    return _in_radar_view("Depth, simulated - measured", pixels, first, bar, None)


def amplitude_pixels(amplitude: np.ndarray, peak: float, dynamic_range_db: float) -> np.ndarray:
    """Return the colours of amplitudes relative to a peak, shape (..., 3), uint8."""
    pixels = _blank(amplitude.shape, AMPLITUDE_BACKGROUND)
    if peak > 0.0:
        seen = amplitude >= peak * 10 ** (-dynamic_range_db / 20)
        level_db = 20 * np.log10(amplitude[seen] / peak)
        pixels[seen] = amplitude_colours(level_db, dynamic_range_db)
    return pixels


def amplitude_bar(dynamic_range_db: float) -> Bar:
    """Return the colour bar of amplitudes."""
    return Bar(Axis("dB", -dynamic_range_db, 0.0), _scale("inferno", 0.2))


def amplitude_colours(
    level_db: np.ndarray, dynamic_range_db: float, second: bool = False
) -> np.ndarray:
    """Return the colour of levels below the maximum, shape (n, 3), uint8.

    Those of a second volume are from dark to light cyan, which no level of a first one has.
    """
    index = _index(1 + level_db / dynamic_range_db)
    if not second:
        return _scale("inferno", 0.2)[index]
    share = index[:, None] / 255
    return np.round((1 - share) * SECOND_WEAK + share * SECOND_STRONG).astype(np.uint8)


def voxels_of(
    volume: Volume, dynamic_range_db: float, most: int = MAX_VOXELS_DRAWN, second: bool = False
) -> Cloud:
    """Return the voxels within the dynamic range, at most `most`, the strongest."""
    amplitude = np.abs(volume.data)
    peak = float(amplitude.max())
    if peak == 0.0:
        return Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
    found = np.flatnonzero(amplitude >= peak * 10 ** (-dynamic_range_db / 20))
    if len(found) > most:
        strongest = np.argpartition(amplitude.ravel()[found], -most)[-most:]
        found = np.sort(found[strongest])
    z, y, x = np.unravel_index(found, amplitude.shape)
    grid = volume.grid
    points_m = np.stack([grid.x_m[x], grid.y_m[y], grid.z_m[z]], axis=1).astype(np.float32)
    level_db = 20 * np.log10(amplitude.ravel()[found] / peak)
    return Cloud(points_m, amplitude_colours(level_db, dynamic_range_db, second))


def _in_radar_view(
    title: str,
    pixels: np.ndarray,
    image: DepthMap,
    bar: Bar | None,
    marked_mm: tuple[float, float] | None,
) -> str:
    unit, (x, y) = length_axes({"x": image.x_m, "y": image.y_m})
    left = Axis(x.name, x.last, x.first)
    marked = None
    if marked_mm is not None:
        marked = (unit.per_m / 1e3 * marked_mm[0], unit.per_m / 1e3 * marked_mm[1])
    return framed(title, pixels[::-1, ::-1], left, y, bar, marked=marked, clicked="projection")


def length_axes(centres_m: Mapping[str, np.ndarray]) -> tuple[LengthUnit, list[Axis]]:
    """Return the axes of pixels with these centres, from edge to edge, and their one unit."""
    unit = unit_for(*(float(axis[i]) for axis in centres_m.values() for i in (0, -1)))
    axes = []
    for name, axis_m in centres_m.items():
        step_m = float(np.diff(axis_m).min()) if len(axis_m) > 1 else 1e-3
        ends = unit.per_m * (axis_m[0] - step_m / 2), unit.per_m * (axis_m[-1] + step_m / 2)
        axes.append(Axis(f"{name} ({unit.name})", *ends))
    return unit, axes


def _blank(shape: tuple[int, ...], colour: str) -> np.ndarray:
    rgb = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)
    return np.broadcast_to(rgb, (*shape, 3)).copy()


@cache
def _scale(name: str, first: float) -> np.ndarray:
    import matplotlib

    colours = matplotlib.colormaps[name](np.linspace(first, 1.0, 256))[:, :3]
    return np.round(255 * colours).astype(np.uint8)


@cache
def _difference_scale() -> np.ndarray:
    from matplotlib.colors import LinearSegmentedColormap

    ends = [SIMULATED_COLOUR, "white", MEASURED_COLOUR]  # where the simulation is nearer: blue
    colours = LinearSegmentedColormap.from_list("differences", ends)(np.linspace(0, 1, 256))
    return np.round(255 * colours[:, :3]).astype(np.uint8)


def _index(share: np.ndarray) -> np.ndarray:
    return np.clip(np.round(255 * share), 0, 255).astype(np.uint8)
