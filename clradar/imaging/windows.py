"""Weights over frequency."""

from __future__ import annotations

import numpy as np

from clradar.model import checks

WINDOWS = ("rect", "hann", "taylor")


def frequency_weights(window: str | np.ndarray, n_freq: int) -> np.ndarray:
    """Return the weight of each frequency, (n_freq,), float64, of a window's name or as given.

    "hann" and "taylor" (nbar 4, -30 dB) are scipy's symmetric windows, with maximum 1, not scaled
    to mean 1; "rect" is 1.
    """
    if isinstance(window, str):
        checks.one_of("window", window, WINDOWS)
        if window == "rect" or n_freq == 1:
            return np.ones(n_freq)
        from scipy.signal import windows

        values = windows.hann(n_freq) if window == "hann" else windows.taylor(n_freq)
        return np.asarray(values, dtype=np.float64)
    return checks.read_only("window", window, np.float64, (n_freq,))
