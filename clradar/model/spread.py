"""Mean and standard deviation of an image over seeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model import checks
from clradar.model.record import Record
from clradar.model.volume import DepthMap, Volume


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Spread(Record):
    """How an image varies from one seed to another: what `clradar.spread` finds.

    Standard deviations are those of single seeds, with n - 1 in the denominator; the mean over n
    seeds is better by the square root of n.

    Parameters
    ----------
    mean : Volume
        Complex mean of the images: what is the same in all.
    amplitude : array_like, shape (n_y, n_x), float64
        Mean of their maximum projections, linear.
    amplitude_sd : array_like, shape (n_y, n_x), float64
        Standard deviation of these.
    depth_m : array_like, shape (n_y, n_x), float64, metres
        Mean depth over the seeds in which the pixel has one; NaN where it has one in none.
    depth_sd_m : array_like, shape (n_y, n_x), float64, metres
        Standard deviation of these; NaN where it has one in fewer than two.
    depth_count : array_like, shape (n_y, n_x), int32
        In how many seeds the pixel has a depth.
    seeds : tuple of int
    varying_share : float, 0 to 1
        Share of the images' power that changes from seed to seed, all voxels together.
    varies : str
        What changes: "shot noise of random rays", "choice of samples", "roughness", or "nothing",
        with "and noise" where impairments were added.
    dynamic_range_db : float, decibel
        Of the depth maps.

    Raises
    ------
    ModelError
        Shapes that do not fit the grid of `mean`, fewer than two seeds, a share outside [0, 1].

    Examples
    --------
    >>> grid = clradar.VoxelGrid([0, 0, 0.3], [1e-3, 1e-3, 1e-3], (1, 1, 1))
    >>> pixel = lambda value: np.full((1, 1), value)
    >>> found = clradar.Spread(
    ...     clradar.Volume(np.ones((1, 1, 1)), grid), pixel(1.1), pixel(0.2), pixel(0.3),
    ...     pixel(np.nan), pixel(1), (0, 1), 0.04, "roughness",
    ... )
    >>> found.to_depth_map().depth_m
    array([[0.3]])
    """

    mean: Volume
    amplitude: np.ndarray
    amplitude_sd: np.ndarray
    depth_m: np.ndarray
    depth_sd_m: np.ndarray
    depth_count: np.ndarray
    seeds: tuple[int, ...]
    varying_share: float
    varies: str
    dynamic_range_db: float = 15.0

    def __post_init__(self) -> None:
        checks.instance("Spread.mean", self.mean, Volume)
        shape = self.mean.grid.shape[1:]
        for name in ("amplitude", "amplitude_sd"):
            self._set_array(name, np.float64, shape, " (y, x)")
        for name in ("depth_m", "depth_sd_m"):
            self._set_array(name, np.float64, shape, " (y, x)", finite=False)
        self._set_array("depth_count", np.int32, shape, " (y, x)")
        if len(self.seeds) < 2:
            checks.fail("Spread.seeds", "two or more", self.seeds)
        share = checks.real("Spread.varying_share", self.varying_share)
        if not 0.0 <= share <= 1.0:
            checks.fail("Spread.varying_share", "a share in [0, 1]", share)
        level_db = checks.dynamic_range("Spread.dynamic_range_db", self.dynamic_range_db)
        self._set(seeds=tuple(self.seeds), varying_share=share, dynamic_range_db=level_db)

    @property
    def x_m(self) -> np.ndarray:
        """Pixel centres along x, metres."""
        return self.mean.grid.x_m

    @property
    def y_m(self) -> np.ndarray:
        """Pixel centres along y, metres."""
        return self.mean.grid.y_m

    def to_depth_map(self) -> DepthMap:
        """Return mean depth and mean amplitude, for all that takes a depth map."""
        return DepthMap(self.depth_m, self.amplitude, self.x_m, self.y_m, self.dynamic_range_db)
