"""Captures to image, and the error of an image."""

import numpy as np

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform, reference

QAR50 = clradar.arrays.qar50()
SWEEP = Waveform.sfcw(72e9, 82e9, 128)


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
