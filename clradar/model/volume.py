"""Images: complex volumes, their maximum projection and their depth map (E9)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.model import checks, labelled
from clradar.model.grid import VoxelGrid
from clradar.model.record import Record
from clradar.model.scale import ImageScale

if TYPE_CHECKING:
    import xarray

SLAB_VOXELS = 2**22
"""Voxels whose amplitude is taken at a time: whole planes, and one more on either side."""


class Planes(Protocol):
    """The complex voxels of a volume, (n_z, n_y, n_x): an array, or planes that are on disk."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, planes: slice, /) -> np.ndarray: ...


def plane_slabs(grid: VoxelGrid, voxels: int = SLAB_VOXELS) -> Iterator[slice]:
    """Yield slices along z of at most so many voxels, or of one plane."""
    n_x, n_y, n_z = grid.counts
    step = max(1, voxels // (n_x * n_y))
    for first in range(0, n_z, step):
        yield slice(first, min(first + step, n_z))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DepthMap(Record):
    """Depth of the strongest reflection along z, where there is one.

    Parameters
    ----------
    depth_m : array_like, shape (n_y, n_x), float64
        z in the antenna frame; NaN where the amplitude is below the dynamic range.
    amplitude : array_like, shape (n_y, n_x), float32
        Maximum projection, linear, everywhere.
    x_m, y_m : array_like, shape (n_x,) and (n_y,)
        Pixel centres, ascending.
    dynamic_range_db : float
        Level of the cut below the maximum, at most 1000.

    Examples
    --------
    >>> depth_m = [[0.30, np.nan], [0.31, 0.32]]
    >>> amplitude = [[1.0, 0.01], [0.5, 0.25]]
    >>> image = clradar.DepthMap(depth_m, amplitude, x_m=[0.0, 0.01], y_m=[0.0, 0.01])
    >>> image.points_m()
    array([[0.  , 0.  , 0.3 ],
           [0.  , 0.01, 0.31],
           [0.01, 0.01, 0.32]])
    """

    depth_m: np.ndarray
    amplitude: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    dynamic_range_db: float = DYNAMIC_RANGE_DB

    def __post_init__(self) -> None:
        x_m = checks.one_axis("DepthMap.x_m", self.x_m)
        y_m = checks.one_axis("DepthMap.y_m", self.y_m)
        shape = (len(y_m), len(x_m))
        depth = self._set_array("depth_m", np.float64, shape, " (y, x)", finite=False)
        if np.isinf(depth).any():
            checks.fail("DepthMap.depth_m", "finite depths or NaN", "infinite values")
        checks.within_reach("DepthMap.x_m, y_m, depth_m", x_m, y_m, depth)
        amplitude = self._set_array("amplitude", np.float32, shape, " (y, x)")
        if amplitude.min() < 0:
            checks.fail("DepthMap.amplitude", "amplitudes >= 0", f"{amplitude.min():g}")
        level_db = checks.dynamic_range("DepthMap.dynamic_range_db", self.dynamic_range_db)
        self._set(x_m=x_m, y_m=y_m, dynamic_range_db=level_db)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._own_array(dtype, copy)

    def to_xarray(self) -> xarray.Dataset:
        """Return `depth_m` and `amplitude` along y_m and x_m, with units."""
        return labelled.depth_dataset(self)

    @property
    def mask(self) -> np.ndarray:
        """Where there is a depth, shape (n_y, n_x), bool."""
        return ~np.isnan(self.depth_m)

    def points_m(self) -> np.ndarray:
        """Return the pixels that have a depth as points (x, y, z), shape (n, 3), metres."""
        row, column = np.nonzero(self.mask)
        return np.stack([self.x_m[column], self.y_m[row], self.depth_m[row, column]], axis=1)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Volume(Record):
    """A complex image on a voxel grid.

    Parameters
    ----------
    data : array_like, shape (n_z, n_y, n_x), complex64
    grid : VoxelGrid
    meta : mapping
        Provenance, in types of JSON.
    scale : ImageScale, optional
        Antennas, frequencies and window of an image of S-parameters.

    Examples
    --------
    The amplitude peaks between two voxels.

    >>> grid = clradar.VoxelGrid([0, 0, 0.30], [1e-3, 1e-3, 1e-3], (1, 1, 4))
    >>> volume = clradar.Volume([[[0.2]], [[1.0]], [[0.8]], [[0.1]]], grid)
    >>> print(f"{1e3 * volume.depth_map().depth_m[0, 0]:.1f} mm")
    301.3 mm
    """

    data: np.ndarray
    grid: VoxelGrid
    meta: Mapping[str, Any] = field(default_factory=dict)
    scale: ImageScale | None = None

    def __post_init__(self) -> None:
        if self.scale is not None:
            checks.instance("Volume.scale", self.scale, ImageScale)
        checks.instance("Volume.grid", self.grid, VoxelGrid)
        self._set_array("data", np.complex64, self.grid.shape, " (z, y, x)")
        self._set(meta=checks.frozen_mapping("Volume.meta", self.meta))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._own_array(dtype, copy)

    def to_xarray(self) -> xarray.DataArray:
        """Return the voxels along z_m, y_m and x_m, with units and `meta` as JSON."""
        return labelled.volume_array(self)

    @property
    def absolute(self) -> bool:
        """Whether it has a `scale`, and can be read in dBsm."""
        return self.scale is not None

    def max_projection(self) -> np.ndarray:
        """Return the maximum of the amplitude over z, shape (n_y, n_x), float32, linear."""
        highest = np.zeros(self.grid.shape[1:], np.float32)
        for slab in plane_slabs(self.grid):
            np.maximum(highest, _amplitude(self.data[slab]).max(axis=0), out=highest)
        return highest

    def as_rcs(self) -> Volume:
        """Return the image whose squared amplitude is a radar cross section in m^2."""
        if self.scale is None:
            checks.fail(
                "Volume.scale",
                "an image on an absolute scale, of a capture by estimator='physical' or one whose "
                "meta has 'absolute': True since its samples are S-parameters, by back-projection",
                "an image on a relative scale, as images by iteration always are",
            )
        reference = self.scale.of_square_metre(self.grid)
        seen = reference > 0
        data = np.divide(self.data, reference, out=np.zeros_like(self.data), where=seen)
        data.flags.writeable = False
        return Volume(data, self.grid, self.meta)

    def rcs_dbsm(self) -> np.ndarray:
        """Return the radar cross section that each voxel shows, dBsm, float32.

        The maximum over a point target's image is that of the target; larger targets read less
        (docs/absolute-scale.md). -inf where the image is 0 and where no antenna looks.
        """
        with np.errstate(divide="ignore"):
            return np.float32(20) * np.log10(_amplitude(self.as_rcs().data))

    def depth_map(self, dynamic_range_db: float = DYNAMIC_RANGE_DB) -> DepthMap:
        """Return the depth of the maximum along z, at the strongest places.

        It is that of the strongest voxel, refined by the parabola through the amplitudes of it and
        its two neighbours, by half a spacing at most; not at the ends of the grid. Pixels more than
        `dynamic_range_db` below the image's maximum get NaN.
        """
        return depth_map_of_planes(self.data, self.grid, dynamic_range_db)


def capture_meta(meta: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what the metadata of an image, or of a capture itself, say of its capture.

    Of an image of several that in which they agree.
    """
    captures = meta.get("capture")
    if isinstance(captures, Sequence) and captures and not isinstance(captures, str):
        first, *others = captures
        if all(isinstance(own, Mapping) for own in captures):
            return {k: v for k, v in first.items() if all(o.get(k) == v for o in others)}
    return captures if isinstance(captures, Mapping) else meta


def depth_map_of_planes(planes: Planes, grid: VoxelGrid, dynamic_range_db: float) -> DepthMap:
    """Return the depth map of a volume whose planes are read a few at a time."""
    dynamic_range_db = checks.dynamic_range("depth_map: dynamic_range_db", dynamic_range_db)
    pixels = grid.shape[1:]
    rows, columns = np.indices(pixels, sparse=True)
    top = np.zeros(pixels, np.intp)
    before, peak, after = (np.full(pixels, -1, np.float32) for _ in range(3))
    for slab in plane_slabs(grid):
        first = max(slab.start - 1, 0)
        amplitude = _amplitude(planes[first : slab.stop + 1])
        at = amplitude[slab.start - first : slab.stop - first].argmax(axis=0) + slab.start - first
        found = amplitude[at, rows, columns]
        stronger = found > peak
        last = len(amplitude) - 1
        np.copyto(before, amplitude[np.maximum(at - 1, 0), rows, columns], where=stronger)
        np.copyto(after, amplitude[np.minimum(at + 1, last), rows, columns], where=stronger)
        np.copyto(peak, found, where=stronger)
        np.copyto(top, at + first, where=stronger)
    return refined_depth_map(grid, top, (before, peak, after), dynamic_range_db)


def _amplitude(data: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        amplitude = np.abs(data)
    if not np.isfinite(amplitude.max()):
        checks.fail("Volume.data", "amplitudes within the range of float32", "an overflow")
    return amplitude


def refined_depth_map(
    grid: VoxelGrid,
    top: np.ndarray,
    amplitudes: tuple[np.ndarray, np.ndarray, np.ndarray],
    dynamic_range_db: float,
) -> DepthMap:
    """Return the depth map of the strongest voxels, see `Volume.depth_map`.

    `top`, (n_y, n_x), is the index along z of each pixel's strongest voxel; `amplitudes` are those
    of the voxel before, of that voxel, and of the one after, any where there is none.
    """
    # In float64: twice a float32 can be beyond its range.
    before, after = (amplitudes[i].astype(np.float64) for i in (0, 2))
    peak, n_z = amplitudes[1], grid.counts[2]
    curvature = before - 2.0 * peak.astype(np.float64) + after
    inside = (top > 0) & (top < n_z - 1) & (curvature < 0)
    shift = np.where(inside, 0.5 * (before - after) / np.where(inside, curvature, -1.0), 0.0)
    depth = grid.origin_m[2] + grid.spacing_m[2] * (top + np.clip(shift, -0.5, 0.5))
    threshold = peak.max() * 10.0 ** (-dynamic_range_db / 20.0)
    depth = np.where((peak >= threshold) & (peak > 0), depth, np.nan)
    return DepthMap(depth, peak, grid.x_m, grid.y_m, dynamic_range_db)
