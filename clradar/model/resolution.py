"""Lateral resolution of an array."""

from __future__ import annotations

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model.capture import Capture


def lateral_resolution_m(capture: Capture, axis: int, range_m: float) -> float:
    """Wavelength over the sines that both apertures span, metres; infinite without aperture."""
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.center_hz
    spanned = 0.0
    for antennas in (capture.array.tx_m, capture.array.rx_m):
        ends = antennas[:, axis].min(), antennas[:, axis].max()
        spanned += float(
            ends[1] / np.hypot(ends[1], range_m) - ends[0] / np.hypot(ends[0], range_m)
        )
    return wavelength_m / spanned if spanned > 0 else float("inf")
