"""The absolute scale of an image: what a point target of known radar cross section reads (E9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import checks
from clradar.model.antenna_side import AntennaSide
from clradar.model.array import AntennaArray
from clradar.model.grid import VoxelGrid
from clradar.model.record import Record
from clradar.model.waveform import Waveform

NODES = (8, 16, 32)  # per axis, tried in this order; 8 are enough for the paper's grid
NODE_ERROR = 1e-4  # of one side's mean field, relative: 0.001 dB each
PROBES = 5  # per axis, beside its ends: voxels at which the polynomials are compared with the sum


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ImageScale(Record):
    """What an image on an absolute scale was formed with.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    weights : array_like, shape (n_freq,)
        The window over frequency, as it was used.
    """

    array: AntennaArray
    waveform: Waveform
    weights: np.ndarray

    def __post_init__(self) -> None:
        checks.instance("ImageScale.array", self.array, AntennaArray)
        checks.instance("ImageScale.waveform", self.waveform, Waveform)
        self._set_array("weights", np.float64, (self.waveform.n_freq,))

    def of_square_metre(self, grid: VoxelGrid) -> np.ndarray:
        """Return what an isotropic point target of 1 m^2 in each voxel reads there.

        Amplitudes by E9 of docs/equations.md, shape (n_z, n_y, n_x), float32; infinite at an
        antenna, 0 where all antennas of a side are blind.
        """
        wavelengths_m = SPEED_OF_LIGHT_M_PER_S / self.waveform.frequencies_hz
        factor = abs(float((self.weights * wavelengths_m).mean())) / (4 * np.pi) ** 1.5
        tx, rx = (_mean_field(side, grid) for side in self.array.sides)
        with np.errstate(invalid="ignore"):  # at an antenna, where the other side is blind
            tx *= rx
        tx[np.isnan(tx)] = 0.0
        tx *= np.float32(factor)
        return tx


def _mean_field(side: AntennaSide, grid: VoxelGrid) -> np.ndarray:
    """Return the mean of a / R over antennas at each voxel, shape (n_z, n_y, n_x), float32.

    It is smooth away from the antennas: polynomials through few nodes per axis are taken as soon as
    they agree with the sum at some voxels, else the sum at all.
    """
    axes_m = (grid.z_m, grid.y_m, grid.x_m)
    random = np.random.default_rng(0)
    drawn = [np.unique([0, len(a) - 1, *random.integers(len(a), size=PROBES)]) for a in axes_m]
    probes_m = [axis_m[at] for axis_m, at in zip(axes_m, drawn, strict=True)]
    wanted = _field_at(side, *probes_m)
    for count in NODES:
        nodes_m = [_nodes_m(axis_m, count) for axis_m in axes_m]
        if 2 * np.prod([len(n) for n in nodes_m]) > np.prod(grid.shape):
            break
        values = _field_at(side, *nodes_m).astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):  # blind antennas, voxels at one
            error = np.abs(_interpolated(values, nodes_m, probes_m) / wanted - 1).max()
        if error <= NODE_ERROR:
            return _interpolated(values, nodes_m, axes_m)
    return _field_at(side, *axes_m).astype(np.float32)


def _nodes_m(axis_m: np.ndarray, count: int) -> np.ndarray:
    """Return Chebyshev points between the ends of an axis, or its voxels where these are few."""
    if len(axis_m) <= count:
        return axis_m
    middle_m, half_m = (axis_m[0] + axis_m[-1]) / 2, (axis_m[-1] - axis_m[0]) / 2
    return middle_m + half_m * np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _interpolated(
    values: np.ndarray, nodes_m: list[np.ndarray], axes_m: Sequence[np.ndarray]
) -> np.ndarray:
    """Evaluate the polynomials through `values`, shape (m_z, m_y, m_x), where the axes cross."""
    for nodes, axis_m in zip(nodes_m, axes_m, strict=True):
        middle_m, half_m = (nodes.min() + nodes.max()) / 2, np.ptp(nodes) / 2 or 1.0
        at_nodes, at_axis = (
            chebvander((where - middle_m) / half_m, len(nodes) - 1) for where in (nodes, axis_m)
        )
        weights = np.linalg.solve(at_nodes.T, at_axis.T).T.astype(np.float32)
        values = np.tensordot(values, weights, axes=(0, 1))  # the next axis comes to the front
    return values


def _field_at(side: AntennaSide, z_m: np.ndarray, y_m: np.ndarray, x_m: np.ndarray) -> np.ndarray:
    """Return the mean of a / R over antennas where the axes cross, shape (n_z, n_y, n_x)."""
    gains = np.ones(len(side.antennas_m)) if side.gain is None else side.gain
    total = np.zeros((len(z_m), len(y_m), len(x_m)), gains.dtype)
    for at_m, axis, gain in zip(side.antennas_m, side.axes, gains, strict=True):
        aside_m = axis[0] * (x_m - at_m[0]) + axis[1] * (y_m[:, None] - at_m[1])
        across_m2 = (y_m[:, None] - at_m[1]) ** 2 + (x_m - at_m[0]) ** 2
        for row, height_m in zip(total, z_m - at_m[2], strict=True):
            with np.errstate(divide="ignore"):
                inverse = 1 / np.sqrt(across_m2 + height_m**2)
            if side.pattern is not None:
                at_antenna = np.isinf(inverse)
                cosine = (axis[2] * height_m + aside_m) * np.where(at_antenna, 0.0, inverse)
                inverse *= np.where(at_antenna, 1.0, side.pattern.amplitude(cosine))
            row += inverse if side.gain is None else gain * inverse
    return np.abs(total) / len(side.antennas_m)
