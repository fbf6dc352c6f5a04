"""Images of a surface from the quarters of an aperture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.imaging.operator import ImagingOperator
from clradar.model import AntennaArray, Capture, Waveform
from clradar.opencl import Device


@dataclass(frozen=True, slots=True, eq=False)
class SubApertures:
    """Two halves of the Tx, each with two halves of the Rx: four views of the same surface.

    Attributes
    ----------
    arrays : list of AntennaArray
    pairs : list of tuple of ndarray
        Indices of the Tx and of the Rx of each.
    operators : list of ImagingOperator
        From the points of the surface.
    """

    arrays: list[AntennaArray]
    pairs: list[tuple[np.ndarray, np.ndarray]]
    operators: list[ImagingOperator]

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
        return np.stack(
            [
                operator.adjoint(samples) / np.float32(samples.size)
                for operator, samples in zip(self.operators, self._parts(capture), strict=True)
            ]
        )

    def _parts(self, capture: Capture) -> list[np.ndarray]:
        return [np.ascontiguousarray(capture.data[np.ix_(*pair)]) for pair in self.pairs]


def halves(antennas_m: np.ndarray) -> list[np.ndarray]:
    """Indices of the antennas at either end of their longest extent; of a single one, that."""
    if len(antennas_m) < 2:
        return [np.arange(len(antennas_m))]
    off_m = antennas_m - antennas_m.mean(axis=0)
    axis = np.linalg.svd(off_m, full_matrices=False)[2][0]
    order = np.argsort(off_m @ axis, kind="stable")
    middle = len(order) // 2
    return [np.sort(order[:middle]), np.sort(order[middle:])]
