"""Captures to image, the terms of an image in float64, and its error."""

import numpy as np

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform, reference

QAR50 = clradar.arrays.qar50()
SWEEP = Waveform.sfcw(72e9, 82e9, 128)
C_M_PER_S = 299_792_458.0


def noise(array: AntennaArray, waveform: Waveform, seed: int = 1) -> Capture:
    """Independent normal samples: no voxel is stronger than the rest."""
    re, im = np.random.default_rng(seed).normal(size=(2, array.n_tx, array.n_rx, waveform.n_freq))
    return Capture(re + 1j * im, array, waveform)


def scatterers(array: AntennaArray, waveform: Waveform, grid: VoxelGrid, n: int = 60) -> Capture:
    """The echoes of points in the volume of a grid."""
    rng = np.random.default_rng(2)
    last = grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1)
    points = rng.uniform(grid.origin_m, last, (n, 3))
    return reference.point_targets(array, waveform, points, rng.normal(size=n))


def rms_db(error: np.ndarray, image: np.ndarray) -> float:
    """RMS of an error relative to the RMS of an image, decibel."""
    squares = [np.mean(np.abs(values.astype(complex)) ** 2) for values in (error, image)]
    return float(10 * np.log10(squares[0] / squares[1] + 1e-60))


def centres_m(grid: VoxelGrid) -> np.ndarray:
    """Voxel centres, shape (n_voxels, 3), in the order of a volume's `data.ravel()`."""
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def phasors(
    points_m: np.ndarray, array: AntennaArray, waveform: Waveform
) -> tuple[np.ndarray, np.ndarray]:
    """exp(-j 2 pi f d / c) of both sides, shape (n_freq, n_points, n), complex128."""
    sides = []
    for antennas_m in (array.tx_m, array.rx_m):
        length_m = np.linalg.norm(points_m[:, None] - antennas_m, axis=-1)
        cycles = waveform.frequencies_hz[:, None, None] / C_M_PER_S * length_m
        sides.append(np.exp(-2j * np.pi * cycles))
    return sides[0], sides[1]
