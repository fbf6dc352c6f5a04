"""Statistics of a surface's images that tell how rough it is, and no pixel of its speckle.

A rough surface reflects as a smooth one does, less by exp(-g/2) in amplitude, and scatters the rest
over an angle of about the slope: so what counts is how much of an image is like that of the smooth
surface, how strong the rest is at each tilt of the surface, how grainy it is, and whether it is the
same from other parts of the aperture.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calibration.roughness.surface_points import SurfacePoints

TILT_EDGES_DEG = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0)
"""Bins of the angle between the normal and the bisector of Tx and Rx. The lobe of a surface with
the slope 0.1 falls by 1/e over 8 degrees, that of 0.3 over 23; beyond 55 degrees the surface is
seen at a grazing angle."""

LEAST_IN_BIN = 40
"""Point and aperture pairs in a bin: the mean power of as many speckles is known to 0.7 dB."""


COHERENT, REST = "coherent power", "rest at"


@dataclass(frozen=True, slots=True)
class Statistic:
    """What one number of a `TextureMeter` is.

    Attributes
    ----------
    name : str
    of_power : bool
        Whether it is the logarithm of a power, which the gain of an instrument adds to.
    """

    name: str
    of_power: bool


class TextureMeter:
    """Measures the statistics of one region.

    Parameters
    ----------
    points : SurfacePoints
    region : int
    tilts : ndarray, shape (4, n_points), radians
    smooth : ndarray, shape (4, n_points), complex64
        Images of the smooth surface from the quarters of the aperture.

    Attributes
    ----------
    statistics : tuple of Statistic
        What `measure` returns; logarithms are natural.
    """

    def __init__(
        self, points: SurfacePoints, region: int, tilts: np.ndarray, smooth: np.ndarray
    ) -> None:
        self._mine = points.region == region
        self._patch = np.unique(points.patch[self._mine], return_inverse=True)[1].ravel()
        self._smooth = smooth[:, self._mine].astype(np.complex128)
        self._smooth_power = self._per_patch(np.abs(self._smooth) ** 2)
        self._level = float(np.mean(np.abs(self._smooth) ** 2))
        degrees = np.degrees(tilts[:, self._mine])
        number = np.digitize(degrees, TILT_EDGES_DEG) - 1
        n_bins = len(TILT_EDGES_DEG) - 1
        self._bins = {
            i: number == i for i in range(n_bins) if np.count_nonzero(number == i) >= LEAST_IN_BIN
        }
        ends = [(f"{TILT_EDGES_DEG[i]:g}", f"{TILT_EDGES_DEG[i + 1]:g}") for i in self._bins]
        self.statistics = (
            Statistic(COHERENT, True),
            *(Statistic(f"{REST} {low} to {high} degrees", True) for low, high in ends),
            Statistic("contrast", False),
            Statistic("correlation of apertures", False),
        )

    @property
    def n_points(self) -> int:
        return len(self._patch)

    @property
    def has_bins(self) -> bool:
        """Whether any bin of the tilt has enough points."""
        return bool(self._bins)

    def measure(self, images: np.ndarray) -> np.ndarray:
        """The statistics of images (4, n_points), complex, shape (n_statistics,), float64.

        In each patch and aperture the smooth image is fitted by one complex factor c.

        - coherent power: ln of sum |c|^2 w / sum w, with the squared power of the smooth patch w;
        - the rest: ln of the mean |V - c V_smooth|^2 in each bin of the tilt, relative to the mean
          |V_smooth|^2 of the region;
        - contrast: mean of ln |V|^2 less ln of the mean, in the bins: -0.58 for full speckle;
        - the mean correlation of |V| between apertures, over the points.
        """
        mine = images[:, self._mine].astype(np.complex128)
        product = self._per_patch(mine * self._smooth.conj())
        factor = product / np.maximum(self._smooth_power, 1e-300)
        rest = np.abs(mine - factor[:, self._patch] * self._smooth) ** 2 / self._level
        power = np.abs(mine) ** 2 + 1e-300
        coherent = np.sum(np.abs(product) ** 2) / np.sum(self._smooth_power**2)
        found = [np.log(coherent + 1e-300)]
        found += [np.log(rest[bin_].mean() + 1e-300) for bin_ in self._bins.values()]
        counts = [np.count_nonzero(bin_) for bin_ in self._bins.values()]
        grain = [np.log(power[b]).mean() - np.log(power[b].mean()) for b in self._bins.values()]
        amplitude = np.sqrt(power)
        alike = [np.corrcoef(a, b)[0, 1] for a, b in combinations(amplitude, 2)]
        found += [np.average(grain, weights=counts), float(np.mean(alike)) if alike else 0.0]
        return np.array(found)

    def _per_patch(self, values: np.ndarray) -> np.ndarray:
        n = self._patch.max() + 1
        if np.iscomplexobj(values):
            return self._per_patch(values.real) + 1j * self._per_patch(values.imag)
        return np.stack([np.bincount(self._patch, row, n) for row in values])
