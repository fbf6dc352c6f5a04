"""Antenna positions in another unit than the reader took them for: which factors are plausible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, Volume

UNITS = {
    10.0: "centimetres read as millimetres",
    0.1: "millimetres read as centimetres",
    100.0: "metres read as centimetres",
    0.01: "centimetres read as metres",
    1000.0: "metres read as millimetres",
    0.001: "millimetres read as metres",
}
"""Factors that positions have to be multiplied by, and what explains each."""

FOCUSED_DB = 6.0
"""Contrast of an image that focuses, twice that of speckle, which wrong units leave. Five points in
noise of 0 dB had 8 dB with 16 x 16 antennas."""

SPECKLE_CONTRAST_DB = 10 * float(np.log10(2.0))
"""Contrast of circular Gaussian values: E|V|^4 = 2 (E|V|^2)^2."""

_MIN_ANTENNAS = 8
_EXTENT_M = (5e-3, 1.0)
"""Extent of a near-field array; the grids of larger ones are so fine that a trial takes long."""

_APART_WAVELENGTHS = (0.2, 20.0)
"""From one antenna to the next: antennas are about half a wavelength wide."""


def plausible_scales(capture: Capture) -> list[float]:
    """Return the factors of `UNITS` that give the array a plausible extent and spacing."""
    array = capture.array
    if array.n_tx + array.n_rx < _MIN_ANTENNAS:
        return []
    both = np.concatenate([array.tx_m, array.rx_m])
    extent_m = float(np.ptp(both, axis=0).max())
    apart_m = min(_next_distance_m(array.tx_m), _next_distance_m(array.rx_m))
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.center_hz
    return [
        scale
        for scale in UNITS
        if _EXTENT_M[0] <= scale * extent_m <= _EXTENT_M[1]
        and _APART_WAVELENGTHS[0] <= scale * apart_m / wavelength_m <= _APART_WAVELENGTHS[1]
    ]


def _next_distance_m(antennas_m: np.ndarray) -> float:
    """Return the median distance from an antenna to the next; infinite for a single one."""
    distinct = np.unique(antennas_m, axis=0)
    if len(distinct) < 2:
        return float("inf")
    return float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))


def with_scaled_positions(capture: Capture, scale: float) -> Capture:
    """Return the capture with all antenna positions times a factor."""
    array = capture.array
    scaled = replace(array, tx_m=array.tx_m * scale, rx_m=array.rx_m * scale)
    return Capture(capture.data, scaled, capture.waveform, capture.meta)


def contrast_db(volume: Volume) -> float:
    """Return the mean of |V|^4 over the squared mean of |V|^2, decibel.

    Unlike sharpness, it compares images of different resolution: speckle has 3 dB in all of them,
    and a focused image as much more as the share of the field of view that is dark.
    """
    power = np.abs(volume.data).astype(np.float64) ** 2
    mean = float(power.mean())
    return 10 * float(np.log10((power**2).mean() / mean**2)) if mean > 0 else SPECKLE_CONTRAST_DB
