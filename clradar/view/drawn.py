"""Images as they are drawn: depth points or voxels with their colours, and places in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from clradar.compare import clipped_db
from clradar.model import DepthMap, Volume, VoxelGrid
from clradar.plot import AMPLITUDE_BACKGROUND
from clradar.view.wish import Place

MAX_VOXELS_DRAWN = 60_000
"""Voxels of one frame, strongest first: 9 bytes each go over the wire."""

SECOND_WEAK, SECOND_STRONG = np.array([0, 70, 90]), np.array([150, 255, 255])
"""Colours of the second image at the end of the dynamic range, and at its maximum."""

REACH = 2.0
"""A click hits what is within so many voxels of its ray."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points and their colours.

    Attributes
    ----------
    points_m : ndarray, shape (n, 3), float32, metres
        x, y, z in the antenna frame.
    colours : ndarray, shape (n, 3), uint8
    size_m : float, metres
        Of a point: the smaller of the steps of the pixels.
    """

    points_m: np.ndarray
    colours: np.ndarray
    size_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """What a data set stores of an image in place of the volume.

    Attributes
    ----------
    image : DepthMap
    known : tuple of str
        "projection", "depth", or both: which of its two arrays are stored.
    """

    image: DepthMap
    known: tuple[str, ...]

    def depth_map(self, dynamic_range_db: float) -> DepthMap:
        """Return the image, cut at a dynamic range."""
        amplitude = self.image.amplitude
        kept = amplitude >= amplitude.max() * 10.0 ** (-dynamic_range_db / 20.0)
        depth_m = np.where(kept, self.image.depth_m, np.nan)
        return DepthMap(depth_m, amplitude, self.image.x_m, self.image.y_m, dynamic_range_db)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What is drawn of an image: its depth map, its points or voxels, and slices of a volume.

    Attributes
    ----------
    image : DepthMap
        Its amplitude is the maximum projection.
    volume : Volume or None
        None where only projection or depth map are known.
    cloud : Cloud
    known : tuple of str
        As of `Flat`.
    """

    image: DepthMap
    volume: Volume | None
    cloud: Cloud
    known: tuple[str, ...]

    @classmethod
    def of(
        cls,
        image: Volume | Flat,
        dynamic_range_db: float,
        *,
        voxels: bool = False,
        second: bool = False,
    ) -> Drawn:
        """Return what is drawn, in the colours of a second image if it is."""
        volume = image if isinstance(image, Volume) else None
        shown = image.depth_map(dynamic_range_db)
        if voxels and volume is not None:
            cloud = voxels_of(volume, dynamic_range_db, second=second)
        else:
            cloud = points_of(shown, dynamic_range_db, second=second)
        known = image.known if isinstance(image, Flat) else ("projection", "depth")
        return cls(shown, volume, cloud, known)

    @property
    def ends_m(self) -> np.ndarray:
        """First and last centre of voxels or pixels along x, y and z, shape (3, 2), metres."""
        z_m: np.ndarray | list[float]
        if self.volume is not None:
            z_m = self.volume.grid.z_m
        elif self.image.mask.any():
            z_m = [np.nanmin(self.image.depth_m), np.nanmax(self.image.depth_m)]
        else:
            z_m = [0.0, 0.0]
        return np.array([[a[0], a[-1]] for a in (self.image.x_m, self.image.y_m, z_m)])

    def strongest_m(self) -> Place:
        """Return the place of the strongest voxel or pixel, metres."""
        if self.volume is not None:
            grid = self.volume.grid
            data = self.volume.data
            z, y, x = np.unravel_index(int(np.abs(data).argmax()), data.shape)
            return float(grid.x_m[x]), float(grid.y_m[y]), float(grid.z_m[z])
        row, column = divmod(int(self.image.amplitude.argmax()), len(self.image.x_m))
        depth_m = float(np.nan_to_num(self.image.depth_m[row, column]))
        return float(self.image.x_m[column]), float(self.image.y_m[row]), depth_m

    def level_db(self, at_m: Place) -> float:
        """Return the level at a place, below the maximum of the image; decibel."""
        if self.volume is not None:
            i, j, k = nearest(self.volume.grid, at_m)
            amplitude, peak = abs(self.volume.data[k, j, i]), np.abs(self.volume.data).max()
        else:
            i, j = (
                int(np.abs(a - v).argmin()) for a, v in zip(self._axes_m, at_m[:2], strict=True)
            )
            amplitude, peak = self.image.amplitude[j, i], self.image.amplitude.max()
        return float(20 * np.log10(max(amplitude / peak, 1e-30))) if peak > 0 else float("nan")

    def depth_m(self, at_m: Place) -> float:
        """Return the depth at x and y of a place, metres; NaN: none."""
        i, j = (int(np.abs(a - v).argmin()) for a, v in zip(self._axes_m, at_m[:2], strict=True))
        return float(self.image.depth_m[j, i])

    @property
    def _axes_m(self) -> tuple[np.ndarray, np.ndarray]:
        return self.image.x_m, self.image.y_m

    def pointed_m(self, at_m: Place, picture: str, across: float, up: float) -> Place:
        """Return the place that a click on a picture means, metres."""
        if self.volume is None:
            depth_m = self.depth_m((across, up, 0.0))
            return across, up, at_m[2] if np.isnan(depth_m) else depth_m
        x, y, z = at_m
        x, y, z = {"xz": (across, y, up), "zy": (x, up, across)}.get(picture, (across, up, z))
        grid = self.volume.grid
        i, j, k = nearest(grid, (x, y, z))
        if picture == "projection":
            k = int(np.abs(self.volume.data[:, j, i]).argmax())
        return float(grid.x_m[i]), float(grid.y_m[j]), float(grid.z_m[k])


def nearest(grid: VoxelGrid, at_m: Place) -> tuple[int, int, int]:
    """Return the indices of the voxel that is nearest to a place."""
    i, j, k = (
        int(np.abs(axis - value).argmin())
        for axis, value in zip((grid.x_m, grid.y_m, grid.z_m), at_m, strict=True)
    )
    return i, j, k


def points_of(image: DepthMap, dynamic_range_db: float, second: bool = False) -> Cloud:
    """Return the depth points of an image, coloured by amplitude."""
    steps_m = [float(np.diff(a).min()) for a in (image.x_m, image.y_m) if len(a) > 1]
    colours = np.empty((0, 3), np.uint8)
    if image.mask.any():
        level_db = clipped_db(image)[image.mask]
        colours = amplitude_colours(level_db, dynamic_range_db, second)
    return Cloud(image.points_m().astype(np.float32), colours, min(steps_m, default=1e-3))


def voxels_of(
    volume: Volume, dynamic_range_db: float, most: int = MAX_VOXELS_DRAWN, second: bool = False
) -> Cloud:
    """Return the voxels within the dynamic range, at most `most`, the strongest."""
    amplitude, grid = np.abs(volume.data), volume.grid
    size_m = float(grid.spacing_m.max())
    peak = float(amplitude.max())
    if peak == 0.0:
        return Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8), size_m)
    found = np.flatnonzero(amplitude >= peak * 10 ** (-dynamic_range_db / 20))
    if len(found) > most:
        strongest = np.argpartition(amplitude.ravel()[found], -most)[-most:]
        found = np.sort(found[strongest])
    z, y, x = np.unravel_index(found, amplitude.shape)
    points_m = np.stack([grid.x_m[x], grid.y_m[y], grid.z_m[z]], axis=1).astype(np.float32)
    level_db = 20 * np.log10(amplitude.ravel()[found] / peak)
    return Cloud(points_m, amplitude_colours(level_db, dynamic_range_db, second), size_m)


def clicked_m(
    points_m: np.ndarray, origin_m: np.ndarray, direction: np.ndarray, voxel_m: float
) -> Place | None:
    """Return the point that a ray meets first, None where it meets none."""
    direction = direction / np.linalg.norm(direction)
    from_eye = points_m.astype(np.float64) - origin_m
    along = from_eye @ direction
    aside = np.linalg.norm(from_eye - along[:, None] * direction, axis=1)
    hit = np.flatnonzero((aside <= REACH * voxel_m) & (along > 0))
    if len(hit) == 0:
        return None
    # Of what is met, the nearest to the ray in the layer nearest to the eye.
    layer = hit[along[hit] <= along[hit].min() + REACH * voxel_m]
    x, y, z = points_m[layer[aside[layer].argmin()]]
    return float(x), float(y), float(z)


def amplitude_pixels(amplitude: np.ndarray, peak: float, dynamic_range_db: float) -> np.ndarray:
    """Return the colours of amplitudes relative to a peak, shape (..., 3), uint8."""
    pixels = blank(amplitude.shape, AMPLITUDE_BACKGROUND)
    if peak > 0.0:
        seen = amplitude >= peak * 10 ** (-dynamic_range_db / 20)
        level_db = 20 * np.log10(amplitude[seen] / peak)
        pixels[seen] = amplitude_colours(level_db, dynamic_range_db)
    return pixels


def amplitude_colours(
    level_db: np.ndarray, dynamic_range_db: float, second: bool = False
) -> np.ndarray:
    """Return the colour of levels below the maximum, shape (n, 3), uint8.

    Those of a second image are from dark to light cyan, which no level of a first one has.
    """
    index = scale_index(1 + level_db / dynamic_range_db)
    if not second:
        return amplitude_scale()[index]
    share = index[:, None] / 255
    return np.round((1 - share) * SECOND_WEAK + share * SECOND_STRONG).astype(np.uint8)


def blank(shape: tuple[int, ...], colour: str) -> np.ndarray:
    """Return pixels of one colour, "#rrggbb"; shape (..., 3), uint8."""
    rgb = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)
    return np.broadcast_to(rgb, (*shape, 3)).copy()


def scale_index(share: np.ndarray) -> np.ndarray:
    """Return where on a scale of 256 colours shares of it are."""
    return np.clip(np.round(255 * share), 0, 255).astype(np.uint8)


@cache
def amplitude_scale() -> np.ndarray:
    """Return the colours of levels, shape (256, 3), uint8."""
    return scale_of("inferno", 0.2)


@cache
def scale_of(name: str, first: float = 0.0) -> np.ndarray:
    """Return colours of matplotlib from a share of the scale on, shape (256, 3), uint8."""
    import matplotlib

    colours = matplotlib.colormaps[name](np.linspace(first, 1.0, 256))[:, :3]
    return np.round(255 * colours).astype(np.uint8)
