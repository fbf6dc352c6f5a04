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

from calibration.roughness.surface_points import SurfacePoints, contrast, tilt_bins
from clradar.imaging.operator import ImagingOperator
from clradar.model import AntennaArray, Capture, Waveform
from clradar.opencl import Device

LEAST_IN_BIN = 40
"""Point and aperture pairs in a bin: the mean power of as many speckles is known to 0.7 dB."""

COHERENT, REST = "coherent power", "rest at"
CONTRAST, ALIKE = "contrast", "correlation of apertures"


def of_power(statistics: tuple[str, ...]) -> np.ndarray:
    """Whether each is the logarithm of a power, which the gain of an instrument adds to."""
    return np.array([name not in (CONTRAST, ALIKE) for name in statistics])


@dataclass(frozen=True, slots=True, eq=False)
class SubApertures:
    """Two halves of the Tx, each with two halves of the Rx: four views of the same surface."""

    arrays: list[AntennaArray]
    pairs: list[tuple[np.ndarray, np.ndarray]]  # indices of the Tx and of the Rx of each
    operators: list[ImagingOperator]  # image the surface's points

    @classmethod
    def of(
        cls, array: AntennaArray, waveform: Waveform, points_m: np.ndarray, device: Device
    ) -> SubApertures:
        """The quarters of an aperture, for images at points, shape (n, 3), metres."""
        pairs = [(tx, rx) for tx in halves(array.tx_m) for rx in halves(array.rx_m)]
        arrays = [AntennaArray(array.tx_m[tx], array.rx_m[rx]) for tx, rx in pairs]
        operators = [ImagingOperator(own, waveform, points_m, device=device) for own in arrays]
        return cls(arrays, pairs, operators)

    def images(self, capture: Capture) -> np.ndarray:
        """Mean over the pairs and frequencies, shape (4, n_points), complex64."""
        found = []
        for operator, pair in zip(self.operators, self.pairs, strict=True):
            samples = np.ascontiguousarray(capture.data[np.ix_(*pair)])
            found.append(operator.adjoint(samples) / np.float32(samples.size))
        return np.stack(found)


def halves(antennas_m: np.ndarray) -> list[np.ndarray]:
    """Indices of the antennas at either end of their longest extent; of a single one, that."""
    if len(antennas_m) < 2:
        return [np.arange(len(antennas_m))]
    off_m = antennas_m - antennas_m.mean(axis=0)
    axis = np.linalg.svd(off_m, full_matrices=False)[2][0]
    order = np.argsort(off_m @ axis, kind="stable")
    middle = len(order) // 2
    return [np.sort(order[:middle]), np.sort(order[middle:])]


class TextureMeter:
    """Measures the statistics of one region.

    `tilts`, shape (4, n_points), are in radians; `smooth`, of the same shape, images of the smooth
    surface from the quarters of the aperture. `names` are of what `measure` returns, natural
    logarithms.
    """

    def __init__(
        self, points: SurfacePoints, region: int, tilts: np.ndarray, smooth: np.ndarray
    ) -> None:
        self._mine = points.region == region
        self._patch = np.unique(points.patch[self._mine], return_inverse=True)[1].ravel()
        self.n_points = len(self._patch)
        self._smooth = smooth[:, self._mine].astype(np.complex128)
        self._smooth_power = self._per_patch(np.abs(self._smooth) ** 2)
        self._level = float(np.mean(np.abs(self._smooth) ** 2))
        self.bins = tilt_bins(tilts[:, self._mine], LEAST_IN_BIN)
        self.names = (COHERENT, *(f"{REST} {tilt}" for tilt in self.bins), CONTRAST, ALIKE)

    def measure(self, images: np.ndarray) -> np.ndarray:
        """The statistics of images (4, n_points), complex.

        In each patch and aperture the smooth image is fitted by one complex factor c.

        - coherent power: ln of sum |c|^2 w / sum w, with the squared power of the smooth patch w;
        - the rest: ln of the mean |V - c V_smooth|^2 in each bin of the tilt, relative to the mean
          |V_smooth|^2 of the region;
        - the contrast of |V|^2;
        - the mean correlation of |V| between apertures, over the points.
        """
        mine = images[:, self._mine].astype(np.complex128)
        product = self._per_patch(mine * self._smooth.conj())
        factor = product / np.maximum(self._smooth_power, 1e-300)
        rest = np.abs(mine - factor[:, self._patch] * self._smooth) ** 2 / self._level
        power = np.abs(mine) ** 2 + 1e-300
        coherent = np.sum(np.abs(product) ** 2) / np.sum(self._smooth_power**2)
        bins = self.bins.values()
        logarithms = np.log([coherent + 1e-300, *(rest[own].mean() + 1e-300 for own in bins)])
        alike = [np.corrcoef(a, b)[0, 1] for a, b in combinations(np.sqrt(power), 2)]
        return np.array([*logarithms, contrast(power, bins), np.mean(alike) if alike else 0.0])

    def _per_patch(self, values: np.ndarray) -> np.ndarray:
        n = self._patch.max() + 1
        if np.iscomplexobj(values):
            return self._per_patch(values.real) + 1j * self._per_patch(values.imag)
        return np.stack([np.bincount(self._patch, row, n) for row in values])
