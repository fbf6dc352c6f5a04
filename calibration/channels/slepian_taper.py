"""Look at the echoes within a window of delays only, at any list of frequencies."""

from __future__ import annotations

import numpy as np

MIN_CELLS, MAX_CELLS = 1.0, 4.0
"""Half width of a window in resolution cells 1 / bandwidth. Below the least nothing is shut out; at
the most other echoes are more than 90 dB down, and a wider window would only cost bandwidth."""

CONCENTRATED = 0.5
"""Share of the largest eigenvalue down to which a spectrum counts as one of the window's."""


def delay_taper(frequencies_hz: np.ndarray, half_width_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return weights over frequency that look at delays in [-half_width_s, half_width_s].

    Of all tapers, the first has the largest share of its energy within the window: the first
    eigenvector of the kernel sin(2 pi T (f - f')) / (pi (f - f')), for equal steps Slepian's
    sequence. Cutting a Fourier transform to the window would not do: what an echo elsewhere leaves
    there is the side lobes of the band's two ends.

    Parameters
    ----------
    frequencies_hz : ndarray, shape (n_freq,), hertz
    half_width_s : float, seconds
        At most `MAX_CELLS` cells of it are used.

    Returns
    -------
    weight : ndarray, shape (n_freq,), float64
        Not negative, with a sum of 1.
    basis : ndarray, shape (n_freq, m), float64
        Orthonormal spectra within the window, to measure noise with.

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
