"""The image of a point against the array factor."""

import numpy as np

import clradar
from clradar import VoxelGrid, Waveform
from truths import measured, optics
from truths.page import Row

Z_M = 0.3
REACH_M = 0.025


def factor(x_m: np.ndarray, frequency_hz: float) -> np.ndarray:
    """Array factor of the imager along x in the plane of a point on its axis at `Z_M`.

    Tx stand in two columns at x = -a and a, Rx in two rows along x; both are written about their
    mean distance to the point, where a step along x changes their phases by k x_i / R_i.
    """
    k = 2 * np.pi * frequency_hz / measured.C_M_PER_S
    side, pitch, n = 0.0705, 3e-3, 47
    along = (np.arange(n) - (n - 1) / 2) * pitch
    tx_r = np.sqrt(side**2 + along**2 + Z_M**2)
    tx = np.mean(np.cos(k * side * x_m[:, None] / tx_r), axis=1)
    # A row is a uniform line seen from the mean of its elements' distances.
    rx_r = np.sqrt(along**2 + side**2 + Z_M**2).mean()
    return np.asarray(tx * optics.dirichlet(n, k * pitch * x_m / rx_r))


def cut(frequencies_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places along x, metres, and amplitude of the image of a point over its maximum."""
    array, waveform = clradar.arrays.qar50(), Waveform(frequencies_hz)
    point = np.array([[0.0, 0.0, Z_M]])
    capture = clradar.forward(point, np.ones(1), array, waveform)
    grid = VoxelGrid.from_extent((-REACH_M, REACH_M), (0, 0), (Z_M, Z_M), spacing_m=0.1e-3)
    row = np.abs(clradar.backproject(capture, grid).data[0, 0]).astype(float)
    x = np.linspace(-REACH_M, REACH_M, len(row))
    return x, row / row.max()


def width_m(x_m: np.ndarray, amplitude: np.ndarray) -> float:
    """Full width at half power, by linear interpolation."""
    above = amplitude >= np.sqrt(0.5)
    first = np.argmax(above)
    last = len(above) - 1 - np.argmax(above[::-1])

    def crossing(inside: int, outside: int) -> float:
        low, high = amplitude[outside], amplitude[inside]
        share = (np.sqrt(0.5) - low) / (high - low)
        return float(x_m[outside] + share * (x_m[inside] - x_m[outside]))

    return crossing(last, last + 1) - crossing(first, first - 1)


def side_lobe_db(x_m: np.ndarray, amplitude: np.ndarray) -> tuple[float, float]:
    """Highest side lobe, dB, and where it is, metres."""
    rising = (amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] >= amplitude[2:])
    peaks = np.flatnonzero(rising) + 1
    peaks = peaks[np.abs(x_m[peaks]) > 1e-3]
    best = peaks[np.argmax(amplitude[peaks])]
    return float(20 * np.log10(amplitude[best])), float(abs(x_m[best]))


AMPLITUDE_BOUND = 0.04
"""Phases to first order in x and the mean distance of a row: at x = 25 mm the ends of a row are off
by k x 69 mm (1/R - 1/R_mean) = 0.11 rad, on side lobes of at most 0.22, and Tx by half of it."""


def rows(x_m: np.ndarray, found: np.ndarray, truth: np.ndarray) -> list[Row]:
    lobe, place = side_lobe_db(x_m, found)
    lobe_truth, place_truth = side_lobe_db(x_m, truth)
    worst = float(np.abs(found - truth).max())
    w, w_truth = width_m(x_m, found), width_m(x_m, truth)
    return [
        Row("width at half power", 1e3 * w_truth, 1e3 * w, 0.02e3 * w_truth, "mm", 3),
        Row("highest side lobe", lobe_truth, lobe, 0.5),
        Row("its place", 1e3 * place_truth, 1e3 * place, 0.02e3 * place_truth, "mm"),
        Row("largest difference of amplitudes", 0, worst, AMPLITUDE_BOUND, "", 3, at_most=True),
    ]
