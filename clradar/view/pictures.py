"""Volumes as arrays to draw: projection and depth map, points, voxels, and slices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from clradar.compare import clipped_db
from clradar.model import DepthMap, Volume
from clradar.plot import AMPLITUDE_BACKGROUND, DEPTH_BACKGROUND, depth_limits_mm

PANEL_PX = 360
"""Pixels along the longer side of an image in the panel."""

MAX_VOXELS_DRAWN = 60_000
"""Voxels of one frame, strongest first: 9 bytes each go over the wire."""


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
    """What is drawn of one volume.

    Attributes
    ----------
    amplitude, depth : ndarray, shape (n_rows, n_columns, 3), uint8
        Maximum projection and depth map in the radar's view: y upwards, x to the left.
    depth_mm : pair of floats, millimetres
        The depths that the colours of `depth` span; NaN where nothing is seen.
    cloud : Cloud
        Depth points, coloured by amplitude.
    """

    amplitude: np.ndarray
    depth: np.ndarray
    depth_mm: tuple[float, float]
    cloud: Cloud


def picture_of(volume: Volume, dynamic_range_db: float) -> Picture:
    """Return projection, depth map and depth points of a volume.

    Raises
    ------
    ModelError
        As `Volume.depth_map`.
    """
    image = volume.depth_map(dynamic_range_db)
    mask = image.mask
    shape = (*mask.shape, 3)
    amplitude = np.broadcast_to(_rgb(AMPLITUDE_BACKGROUND), shape).copy()
    depth = np.broadcast_to(_rgb(DEPTH_BACKGROUND), shape).copy()
    limits_mm = (float("nan"), float("nan"))
    colours = np.empty((0, 3), np.uint8)
    if mask.any():
        colours = amplitude_colours(clipped_db(image)[mask], dynamic_range_db)
        amplitude[mask] = colours
        limits_mm = depth_limits_mm([image])
        share = (1e3 * image.depth_m[mask] - limits_mm[0]) / (limits_mm[1] - limits_mm[0])
        depth[mask] = _scale("viridis_r", 0.0)[_index(share)]
    cloud = Cloud(image.points_m().astype(np.float32), colours)
    return Picture(in_radar_view(amplitude, image), in_radar_view(depth, image), limits_mm, cloud)


def amplitude_colours(level_db: np.ndarray, dynamic_range_db: float) -> np.ndarray:
    """Return the colour of levels below the maximum, shape (n, 3), uint8."""
    return _scale("inferno", 0.2)[_index(1 + level_db / dynamic_range_db)]


def voxels_of(volume: Volume, dynamic_range_db: float, most: int = MAX_VOXELS_DRAWN) -> Cloud:
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
    return Cloud(points_m, amplitude_colours(level_db, dynamic_range_db))


def in_radar_view(pixels: np.ndarray, image: DepthMap) -> np.ndarray:
    """Turn and enlarge an image, rows along y and columns along x, to panel size."""
    turned = pixels[::-1, ::-1]
    extents = [_extent(image.y_m), _extent(image.x_m)]
    sizes = [max(1, round(PANEL_PX * extent / max(extents))) for extent in extents]
    rows, columns = (
        (np.arange(size) * count) // size
        for size, count in zip(sizes, turned.shape[:2], strict=True)
    )
    return np.ascontiguousarray(turned[rows[:, None], columns])


def _extent(axis_m: np.ndarray) -> float:
    step_m = float(np.diff(axis_m).min()) if len(axis_m) > 1 else 1e-3
    return float(axis_m[-1] - axis_m[0]) + step_m


@cache
def _scale(name: str, first: float) -> np.ndarray:
    import matplotlib

    colours = matplotlib.colormaps[name](np.linspace(first, 1.0, 256))[:, :3]
    return np.round(255 * colours).astype(np.uint8)


def _rgb(colour: str) -> np.ndarray:
    return np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)


def _index(share: np.ndarray) -> np.ndarray:
    return np.clip(np.round(255 * share), 0, 255).astype(np.uint8)
