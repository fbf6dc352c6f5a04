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

    Standard deviations are those of single seeds (n - 1); the mean is better by the square root of
    n.

    Parameters
    ----------
    mean : Volume
        Complex mean of the images: what is the same in all.
    amplitude, amplitude_sd : array_like, shape (n_y, n_x), float64
        Mean and standard deviation of their maximum projections, linear.
    depth_m, depth_sd_m : array_like, shape (n_y, n_x), float64
        The same over the seeds in which the pixel has a depth; NaN with none, or fewer than two.
    depth_count : array_like, shape (n_y, n_x), int32
        How many these are.
    seeds : tuple of int
    varying_share : float, 0 to 1
        Share of the images' power that changes from seed to seed, all voxels together.
    varies : str
        What changes: "shot noise of random rays", "choice of samples", "roughness", or "nothing",
        with "and noise" where impairments were added.
    dynamic_range_db : float
        Of the depth maps.
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
        share = checks.within("Spread.varying_share", self.varying_share, 0, 1)
        level_db = checks.dynamic_range("Spread.dynamic_range_db", self.dynamic_range_db)
        self._set(seeds=tuple(self.seeds), varying_share=share, dynamic_range_db=level_db)

    @property
    def x_m(self) -> np.ndarray:
        """Pixel centres along x."""
        return self.mean.grid.x_m

    @property
    def y_m(self) -> np.ndarray:
        """Pixel centres along y."""
        return self.mean.grid.y_m

    def to_depth_map(self) -> DepthMap:
        """Return mean depth and mean amplitude, for all that takes a depth map."""
        return DepthMap(self.depth_m, self.amplitude, self.x_m, self.y_m, self.dynamic_range_db)
