"""Keep only echoes that arrive within a window of delays, at any list of frequencies."""

from __future__ import annotations

import numpy as np

KEPT_EIGENVALUE = 1e-3
"""Share of the largest eigenvalue down to which a direction is kept. Directions with less have
almost all of their energy outside the window: they would let other echoes in and little of ours."""


def gate_basis(frequencies_hz: np.ndarray, half_width_s: float) -> np.ndarray:
    """Return an orthonormal basis of the spectra of delays in [-half_width_s, half_width_s].

    The eigenvectors of the kernel sin(2 pi T (f - f')) / (pi (f - f')): for equal steps these are
    Slepian's sequences, which have as much of their energy as can be within the window. Unlike a
    window on a Fourier transform they have no trouble at the ends of the band.

    Parameters
    ----------
    frequencies_hz : ndarray, shape (n_freq,), hertz
    half_width_s : float, seconds

    Returns
    -------
    ndarray, shape (n_freq, m), float64
        m is about 2 T times the bandwidth, and a few more.

    References
    ----------
    D. Slepian, "Prolate spheroidal wave functions, Fourier analysis, and uncertainty V", Bell
    System Technical Journal 57(5), 1978, doi 10.1002/j.1538-7305.1978.tb02104.x.
    """
    apart_hz = frequencies_hz[:, None] - frequencies_hz[None, :]
    values, vectors = np.linalg.eigh(np.sinc(2.0 * half_width_s * apart_hz))
    basis: np.ndarray = vectors[:, values > KEPT_EIGENVALUE * values[-1]]
    return basis
