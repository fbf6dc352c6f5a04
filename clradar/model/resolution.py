"""Lateral resolution of an array."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model.capture import Capture


def lateral_resolution_m(capture: Capture | Sequence[Capture], axis: int, range_m: float) -> float:
    """Wavelength over the sines that both apertures span, metres; infinite without aperture.

    Of several captures, whose images add up, those that all of them span together.
    """
    captures = [capture] if isinstance(capture, Capture) else capture
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / captures[0].waveform.center_hz
    lows, highs = [], []
    for one in captures:
        own = [antennas[:, axis] for antennas in (one.array.tx_m, one.array.rx_m)]
        lows.append([at.min() / np.hypot(at.min(), range_m) for at in own])
        highs.append([at.max() / np.hypot(at.max(), range_m) for at in own])
    low, high = min(lows, key=sum), max(highs, key=sum)
    spanned = float(high[0] - low[0]) + float(high[1] - low[1])
    return wavelength_m / spanned if spanned > 0 else float("inf")
