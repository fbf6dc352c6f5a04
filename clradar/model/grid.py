"""Voxel grids: the regular points at which an image is formed."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import FINEST_SPACING_M, PLAUSIBLE_RANGE_M
from clradar.model import checks
from clradar.model.plausible import check_plausible
from clradar.model.record import Record

MAX_VOXELS = 2**31 - 1  # largest volume: its index has to fit a signed 32-bit integer on the device


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VoxelGrid(Record):
    """A regular grid of voxel centres in the antenna frame, at most 2^31 - 1 of them.

    Parameters
    ----------
    origin_m : array_like, shape (3,)
        Centre of the first voxel: x, y, z.
    spacing_m : array_like, shape (3,)
        Steps, at least 10 um.
    counts : tuple of 3 ints
        Voxels along x, y, z.

    Examples
    --------
    Volumes are indexed [z, y, x].

    >>> grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 2e-3)
    >>> grid.shape
    (41, 101, 101)
    """

    origin_m: np.ndarray
    spacing_m: np.ndarray
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        self._set_array("origin_m", np.float64, (3,))
        spacing = self._set_array("spacing_m", np.float64, (3,))
        if spacing.min() <= 0:
            checks.fail("VoxelGrid.spacing_m", "positive spacing", f"{spacing.tolist()}")
        sized = isinstance(self.counts, Sized) and not isinstance(self.counts, str)
        if not sized or len(self.counts) != 3:
            checks.fail("VoxelGrid.counts", "three counts (x, y, z)", repr(self.counts))
        nx, ny, nz = (checks.whole("VoxelGrid.counts", n, 1) for n in self.counts)
        if nx * ny * nz > MAX_VOXELS:
            checks.fail("VoxelGrid.counts", f"at most {MAX_VOXELS} voxels", f"{nx} x {ny} x {nz}")
        with np.errstate(over="ignore"):
            last_m = self.origin_m + spacing * (np.array([nx, ny, nz]) - 1)
        _check_units("VoxelGrid", self.origin_m, last_m, spacing)
        self._set(counts=(nx, ny, nz))

    @classmethod
    def from_extent(cls, x_m: Any, y_m: Any, z_m: Any, spacing_m: Any) -> VoxelGrid:
        """Return the grid between first and last voxel centres, which may be equal, along each
        axis.

        Each extent is a whole number of `spacing_m`, one for all axes or three.
        """
        spacing_in = np.asarray(spacing_m, dtype=object)
        if spacing_in.shape not in ((), (3,)):
            checks.fail("VoxelGrid.from_extent: spacing_m", "one number or three", repr(spacing_m))
        steps = [
            checks.positive("VoxelGrid.from_extent: spacing_m", s)
            for s in np.broadcast_to(spacing_in, 3)
        ]
        fields = [f"VoxelGrid.from_extent: {name}_m" for name in "xyz"]
        ends = [
            checks.read_only(field, pair, np.float64, (2,))
            for field, pair in zip(fields, (x_m, y_m, z_m), strict=True)
        ]
        firsts, lasts = np.transpose(ends)
        _check_units("VoxelGrid.from_extent", firsts, lasts, np.array(steps))
        origin, counts = [], []
        for field, (first, last), step in zip(fields, ends, steps, strict=True):
            if last < first:
                checks.fail(field, "first <= last", f"({first:g}, {last:g})")
            intervals = float(last - first) / step
            count = round(intervals)
            if abs(intervals - count) > 1e-6 * max(1.0, intervals):
                fits = first + np.floor(intervals) * step
                checks.fail(
                    field,
                    f"an extent that is a whole number of steps of {step:g} m "
                    f"(such as ({first:g}, {fits:g}))",
                    f"({first:g}, {last:g})",
                )
            origin.append(first)
            counts.append(count + 1)
        return cls(np.array(origin), np.array(steps), (counts[0], counts[1], counts[2]))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n_z, n_y, n_x), that of a volume."""
        return self.counts[::-1]

    @property
    def x_m(self) -> np.ndarray:
        """Voxel centres along x, shape (n_x,)."""
        return self._axis(0)

    @property
    def y_m(self) -> np.ndarray:
        """Voxel centres along y, shape (n_y,)."""
        return self._axis(1)

    @property
    def z_m(self) -> np.ndarray:
        """Voxel centres along z, shape (n_z,)."""
        return self._axis(2)

    def _axis(self, axis: int) -> np.ndarray:
        return self.origin_m[axis] + self.spacing_m[axis] * np.arange(self.counts[axis])

    def same_voxels(self, other: VoxelGrid, tolerance_m: float = 1e-7) -> bool:
        """Whether both have the same voxel centres, within `tolerance_m`."""
        if self.counts != other.counts:
            return False
        ends = [
            np.stack([g.origin_m, g.origin_m + g.spacing_m * (np.array(g.counts) - 1)])
            for g in (self, other)
        ]
        return bool(np.abs(ends[0] - ends[1]).max() <= tolerance_m)


def _check_units(
    field: str, first_m: np.ndarray, last_m: np.ndarray, spacing_m: np.ndarray
) -> None:
    """Raise if first and last voxels along x, y, z, or the steps, are in another unit."""
    several = last_m > first_m
    farthest_m = np.maximum(np.abs(first_m), np.abs(last_m)).max()
    low_m, high_m = PLAUSIBLE_RANGE_M
    bounds_m = (low_m if several.any() else 0.0, high_m)
    check_plausible(field, "a distance of the farthest voxel", farthest_m, bounds_m)
    check_plausible(field, "a spacing", spacing_m[several], (FINEST_SPACING_M, high_m))
