"""Delay profiles of captures, and whether those of two captures agree."""

from __future__ import annotations

import math

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, Waveform

MOST_LOSS_DB = 30.0
"""Losses beyond this are told as this: the echoes of two captures cancel each other."""

POWER_FLOOR = 1e-10
"""Of the strongest echo's power: below are sidelobes and rounding."""


def path_lengths_m(waveform: Waveform) -> np.ndarray:
    """Path lengths of the bins of `delay_profiles`, shape (n_freq,), metres."""
    count = waveform.n_freq
    path_m = np.arange(count) * SPEED_OF_LIGHT_M_PER_S / max(waveform.span_hz, 1.0)
    return np.asarray(path_m * ((count - 1) / count if count > 1 else 1.0))


def delay_profiles(capture: Capture) -> np.ndarray:
    """Delay profiles, Hann window, shape (n_tx, n_rx, n_freq), complex64."""
    waveform = capture.waveform
    offsets_hz = waveform.frequencies_hz - waveform.center_hz
    count = waveform.n_freq
    cycles = np.outer(offsets_hz, path_lengths_m(waveform)) / SPEED_OF_LIGHT_M_PER_S
    # Without the two zeros at the ends, which would discard samples (all of them for two).
    window = np.hanning(count + 2)[1:-1]
    transform = window[:, None] * np.exp(2j * np.pi * cycles) / np.sqrt(count)
    profiles = np.empty(capture.data.shape, np.complex64)
    for out, row in zip(profiles, capture.data, strict=True):
        out[:] = row.astype(np.complex128) @ transform
    return profiles


def averaging_loss_db(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """How much weaker the echoes of two captures are in their mean, where they lose most.

    Parameters
    ----------
    one, other : ndarray, shape (n_tx, n_rx, n_freq), complex
        Delay profiles.

    Returns
    -------
    loss_db : float, decibel
        0 where both differ by no more than noise; `MOST_LOSS_DB` at most.
    delay_bin : int
        Where that is.

    Notes
    -----
    In bin q with the powers P1 and P2 over all pairs and that of the difference, D, the power of
    the mean is (P1 + P2)/2 - D/4 of (P1 + P2)/2. Noise is white, so it adds the same to D in every
    bin: the median over the bins, which echoes that moved fill only a part of. The estimate of D in
    a bin from n pairs scatters by 1/sqrt(n); six times that is taken for noise, too. A phase
    difference of phi costs -20 log10(cos(phi/2)) dB: 1 dB at 54 degrees, or 0.29 mm at 77 GHz.
    """
    power = np.zeros(one.shape[-1])
    difference = np.zeros(one.shape[-1])
    for a, b in zip(one, other, strict=True):
        power += (np.abs(a) ** 2 + np.abs(b) ** 2).sum(axis=0, dtype=np.float64)
        difference += (np.abs(a - b) ** 2).sum(axis=0, dtype=np.float64)
    pairs = one.shape[0] * one.shape[1]
    noise = float(np.median(difference)) * (1 + 6 / math.sqrt(pairs))
    floor = POWER_FLOOR * float(power.max())
    changed = (difference - noise).clip(0)
    share = np.divide(changed, 2 * power, out=np.zeros_like(power), where=power > floor).clip(0, 1)
    worst = int(share.argmax())
    left = max(1 - float(share[worst]), 10 ** (-MOST_LOSS_DB / 10))
    return -10 * math.log10(left), worst
