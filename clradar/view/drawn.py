"""Images as they are drawn: depth points or voxels with their colours, and places in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from clradar.compare.images import clipped_db
from clradar.model import DepthMap, Volume, VoxelGrid
from clradar.plot.drawing import AMPLITUDE_SCALE, DEPTH_SCALE, DIFFERENCE_SCALE
from clradar.view.wish import Place

MAX_VOXELS_DRAWN = 60_000  # voxels of one frame, strongest first: 9 bytes each go over the wire
SECOND_COLOURS = ("#00465a", "#96ffff")
"""Of the second image at the end of the dynamic range, and at its maximum: no level of a first one
has such."""

SCALES = {
    "amplitude": AMPLITUDE_SCALE,
    "second": LinearSegmentedColormap.from_list("second", [*SECOND_COLOURS]),
    "depth": DEPTH_SCALE,
    "difference": DIFFERENCE_SCALE,
}
"""Of amplitudes, of those of a second image, of depths, of differences in depth."""

REACH = 2.0  # a click hits what is within so many voxels of its ray


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """What a data set stores of an image in place of the volume: "projection", "depth", or both."""

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
    """What is drawn of an image: its depth map, the volume if there is one, points or voxels.

    Points or middles of voxels have the shape (n, 3), metres, colours as well, and one size.
    """

    image: DepthMap
    volume: Volume | None
    known: tuple[str, ...]
    points_m: np.ndarray
    colours: np.ndarray
    size_m: float

    @classmethod
    def of(
        cls,
        image: Volume | Flat,
        dynamic_range_db: float,
        voxels: bool = False,
        second: bool = False,
    ) -> Drawn:
        """Return what is drawn, in the colours of a second image if it is."""
        shown = image.depth_map(dynamic_range_db)
        known = image.known if isinstance(image, Flat) else ("projection", "depth")
        volume = image if isinstance(image, Volume) else None
        if voxels and volume is not None:
            points_m, level_db = voxels_of(volume, dynamic_range_db)
            size_m = float(volume.grid.spacing_m.max())
        else:
            points_m = shown.points_m()
            level_db = clipped_db(shown)[shown.mask] if len(points_m) else np.empty(0)
            steps_m = [float(np.diff(a).min()) for a in (shown.x_m, shown.y_m) if len(a) > 1]
            size_m = min(steps_m, default=1e-3)
        scale = "second" if second else "amplitude"
        colours = colours_on(scale, level_db, -dynamic_range_db, 0.0)
        return cls(shown, volume, known, points_m.astype(np.float32), colours, size_m)

    @property
    def ends_m(self) -> np.ndarray:
        """First and last centre of voxels or pixels along x, y and z, shape (3, 2), metres."""
        z_m = np.zeros(1)
        if self.volume is not None:
            z_m = self.volume.grid.z_m
        elif self.image.mask.any():
            z_m = np.sort(self.image.depth_m[self.image.mask])
        return np.array([[a[0], a[-1]] for a in (self.image.x_m, self.image.y_m, z_m)])

    def strongest_m(self) -> Place:
        """Return the place of the strongest voxel or pixel, metres."""
        j, i = divmod(int(self.image.amplitude.argmax()), len(self.image.x_m))
        return self._column_m(j, i, 0.0)

    def _column_m(self, j: int, i: int, otherwise_m: float) -> Place:
        """Return the place of the strongest voxel over a pixel, or of its depth if it has one."""
        if self.volume is not None:
            z_m = self.volume.grid.z_m[int(np.abs(self.volume.data[:, j, i]).argmax())]
        else:
            z_m = np.nan_to_num(self.image.depth_m[j, i], nan=otherwise_m)
        return float(self.image.x_m[i]), float(self.image.y_m[j]), float(z_m)

    def level_db(self, at_m: Place) -> float:
        """Return the level at a place, below the maximum of the image; decibel."""
        amplitude, peak = self.image.amplitude[self._pixel(at_m)], self.image.amplitude.max()
        if self.volume is not None:
            i, j, k = nearest(self.volume.grid, at_m)
            amplitude = abs(self.volume.data[k, j, i])
        return float(20 * np.log10(max(amplitude / peak, 1e-30))) if peak > 0 else float("nan")

    def depth_m(self, at_m: Place) -> float:
        """Return the depth at x and y of a place, metres; NaN: none."""
        return float(self.image.depth_m[self._pixel(at_m)])

    def _pixel(self, at_m: Place) -> tuple[int, int]:
        x, y, _ = at_m
        image = self.image
        return int(np.abs(image.y_m - y).argmin()), int(np.abs(image.x_m - x).argmin())

    def pointed_m(self, at_m: Place, picture: str, across: float, up: float) -> Place:
        """Return the place that a click on a picture means, metres."""
        x, y, z = at_m
        if picture not in ("xy", "xz", "zy") or self.volume is None:
            return self._column_m(*self._pixel((across, up, 0.0)), z)
        x, y, z = {"xy": (across, up, z), "xz": (across, y, up), "zy": (x, up, across)}[picture]
        grid = self.volume.grid
        i, j, k = nearest(grid, (x, y, z))
        return float(grid.x_m[i]), float(grid.y_m[j]), float(grid.z_m[k])


def nearest(grid: VoxelGrid, at_m: Place) -> tuple[int, int, int]:
    """Return the indices of the voxel that is nearest to a place."""
    axes = zip((grid.x_m, grid.y_m, grid.z_m), at_m, strict=True)
    i, j, k = (int(np.abs(axis - value).argmin()) for axis, value in axes)
    return i, j, k


def voxels_of(
    volume: Volume, dynamic_range_db: float, most: int = MAX_VOXELS_DRAWN
) -> tuple[np.ndarray, np.ndarray]:
    """Return places, metres, and levels of the strongest voxels within the dynamic range."""
    amplitude, grid = np.abs(volume.data), volume.grid
    peak = float(amplitude.max())
    level = peak * 10 ** (-dynamic_range_db / 20)
    seen = np.flatnonzero((amplitude >= level) & (amplitude > 0))
    if len(seen) > most:
        strongest = np.argpartition(amplitude.ravel()[seen], -most)[-most:]
        seen = np.sort(seen[strongest])
    z, y, x = np.unravel_index(seen, amplitude.shape)
    level_db = 20 * np.log10(amplitude.ravel()[seen] / (peak or 1.0))
    level_db = np.maximum(level_db, -dynamic_range_db)  # which rounding can be below
    return np.stack([grid.x_m[x], grid.y_m[y], grid.z_m[z]], axis=1), level_db


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


def below_db(amplitude: np.ndarray, peak: float) -> np.ndarray:
    """Return the levels of amplitudes relative to a peak; decibel."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 20 * np.log10(amplitude / peak)


def colours_on(scale: str, values: np.ndarray, first: float, last: float) -> np.ndarray:
    """Return the colours of values on a scale with these ends, of NaN that of nothing; uint8."""
    colours: np.ndarray = SCALES[scale]((values - first) / (last - first), bytes=True)
    return colours[..., :3]
