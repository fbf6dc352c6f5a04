"""Sign of range from wavefront curvature, without an image.

The delay of an echo grows with the antennas' distance from the axis, because wavefronts diverge
from the reflector: over the pairs (t, r), a point at range R has

    |v - t| + |v - r| = 2 R - (u_t . t + u_r . r) + (|t|^2 + |r|^2) / (2 R) + ...

and a mirror at distance z has |t - r|^2 / (4 z), the same coefficient of |t|^2 + |r|^2. If either
the frequency order or the phase sign is the opposite of the assumed one, delays are negative, and
so is the coefficient.
"""

from __future__ import annotations

import numpy as np

from calibration.conventions.search_region import window_of
from clradar.backproject import frequency_weights
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture

HALF_WIDTH_M = 0.15
"""Echoes within this path length of the strongest one are used, metres."""

BINS = 61

MIN_ANTENNAS = 10
"""Tx and Rx together: with fewer, their scatter does not estimate the error."""


def curvature_sigma(capture: Capture, path_m: float) -> float:
    """Curvature of the wavefronts over its standard error.

    Parameters
    ----------
    capture : Capture
    path_m : float
        Path length at which the mean range profile is strongest.

    Returns
    -------
    float
        Positive for diverging wavefronts. The delay of a pair is the centroid of its power within
        `HALF_WIDTH_M`; its errors may be correlated among all pairs of a Tx and of an Rx. 0 where
        the curvature is unobservable: too few antennas, or all equally far from the axis.
    """
    array, waveform = capture.array, capture.waveform
    if array.n_tx + array.n_rx < MIN_ANTENNAS:
        return 0.0
    away_m = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, BINS)
    weights = frequency_weights(window_of(waveform), waveform.n_freq)
    k = (waveform.frequencies_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    to_path = weights[:, None] * np.exp(2j * np.pi * np.outer(k, path_m + away_m))
    flat = capture.data.reshape(-1, waveform.n_freq)
    profile = np.abs(flat @ to_path.astype(np.complex64)).astype(np.float64) ** 2
    power = profile.sum(axis=1)
    if not power.any():
        return 0.0
    centroid_m = profile @ away_m / np.where(power > 0, power, 1.0)

    t = np.repeat(array.tx_m, array.n_rx, axis=0)
    r = np.tile(array.rx_m, (array.n_tx, 1))
    bend = (t**2).sum(axis=1) + (r**2).sum(axis=1)
    flatter = np.column_stack([np.ones(len(t)), t, r])
    root = np.sqrt(power)
    # Only the part of `bend` that is orthogonal to a constant and a tilt carries information.
    tilt = np.linalg.lstsq(flatter * root[:, None], bend * root, rcond=None)[0]
    rest = bend - flatter @ tilt
    information = float((power * rest**2).sum())
    if information <= 1e-9 * float((power * bend**2).sum()):
        return 0.0
    design = np.column_stack([flatter, rest])
    fit = np.linalg.lstsq(design * root[:, None], centroid_m * root, rcond=None)[0]
    score = (power * rest * (centroid_m - design @ fit)).reshape(array.n_tx, array.n_rx)
    variance = float((score.sum(axis=0) ** 2).sum() + (score.sum(axis=1) ** 2).sum())
    if variance <= 0:
        return 0.0
    return float(fit[-1]) * information / float(np.sqrt(variance))
