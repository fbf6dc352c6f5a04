"""Slepian (DPSS) tapers for a delay window, generalised to uneven frequencies.

D. J. Thomson, "Spectrum estimation and harmonic analysis", Proc. IEEE 70(9), 1982,
doi 10.1109/PROC.1982.12433.
"""

from __future__ import annotations

import numpy as np

MIN_CELLS, MAX_CELLS = 1.0, 4.0
"""Half width of a window in resolution cells 1 / bandwidth. Below the minimum nothing is rejected;
at the maximum other echoes are more than 90 dB down, and more width would only cost resolution."""

CONCENTRATED = 0.5
"""Eigenvectors with at least this fraction of the largest eigenvalue span the window."""


def delay_taper(frequencies_hz: np.ndarray, half_width_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Weights over frequency that pass delays in [-half_width_s, half_width_s].

    The taper with the largest fraction of its energy within the window: the first eigenvector of
    the kernel sin(2 pi T (f - f')) / (pi (f - f')), for equal steps Slepian's sequence. Truncating
    a Fourier transform to the window would keep the sidelobes that the band's two ends give to
    echoes elsewhere.

    Parameters
    ----------
    frequencies_hz : ndarray, shape (n_freq,), hertz
    half_width_s : float, seconds
        At most `MAX_CELLS` resolution cells are used.

    Returns
    -------
    weight : ndarray, shape (n_freq,), float64
        Not negative, with a sum of 1.
    basis : ndarray, shape (n_freq, m), float64
        Orthonormal spectra that span the window, to measure noise with.

    References
    ----------
    D. Slepian, "Prolate spheroidal wave functions, Fourier analysis, and uncertainty V", Bell
    System Technical Journal 57(5), 1978, doi 10.1002/j.1538-7305.1978.tb02104.x.
    """
    band_hz = float(np.ptp(frequencies_hz))
    half_width_s = min(half_width_s, MAX_CELLS / band_hz)
    apart_hz = frequencies_hz[:, None] - frequencies_hz[None, :]
    values, vectors = np.linalg.eigh(np.sinc(2.0 * half_width_s * apart_hz))
    taper = np.abs(vectors[:, -1])  # of one sign, but for rounding
    return taper / taper.sum(), vectors[:, values > CONCENTRATED * values[-1]]
