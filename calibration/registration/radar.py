"""Antennas, waveform and aperture that a registration simulates with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.mesh_rendering import Aperture
from clradar import arrays
from clradar.model import AntennaArray, Waveform, checks


@dataclass(frozen=True, slots=True)
class Radar:
    array: AntennaArray
    waveform: Waveform
    aperture: Aperture

    @classmethod
    def of(cls, function: str, array: AntennaArray | None, waveform: Waveform | None) -> Radar:
        """Check an instrument; by default the 94 x 94 imager, 72 to 82 GHz in 128 steps."""
        array = arrays.qar50() if array is None else array
        waveform = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
        checks.instance(f"{function}: array", array, AntennaArray)
        checks.instance(f"{function}: waveform", waveform, Waveform)
        return cls(array, waveform, Aperture(array, float(np.mean(waveform.frequencies_hz))))
