"""What the radar records, simulated or measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.array import AntennaArray
from clradar.model.record import reduced, summary
from clradar.model.waveform import Waveform


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Capture:
    """One frame: the complex response of every pair of antennas at every frequency.

    Parameters
    ----------
    data : array_like, shape (n_tx, n_rx, n_freq), complex64
        A path of total length d contributes exp(-j 2 pi f d / c).
    array : AntennaArray
    waveform : Waveform
    meta : mapping
        Where it comes from, in types that JSON knows: numbers, strings, lists and mappings.

    Raises
    ------
    ModelError
        The shape does not fit `array` and `waveform`, or `data` has NaN or infinite values.
    """

    data: np.ndarray
    array: AntennaArray
    waveform: Waveform
    meta: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = summary
    __reduce__ = reduced

    def __post_init__(self) -> None:
        checks.instance("Capture.array", self.array, AntennaArray)
        checks.instance("Capture.waveform", self.waveform, Waveform)
        shape = (self.array.n_tx, self.array.n_rx, self.waveform.n_freq)
        data = checks.read_only("Capture.data (tx, rx, freq)", self.data, np.complex64, shape)
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "meta", checks.frozen_mapping("Capture.meta", self.meta))


def check_same_radar(field: str, capture: Capture, reference: Capture) -> None:
    """Raise unless both captures have the same antennas and frequencies.

    Raises
    ------
    ModelError
        It names `field`, what `reference` has, and what `capture` has.
    """
    if not capture.array.same_positions(reference.array):
        words = [
            f"'{a.name}', {a.n_tx} Tx and {a.n_rx} Rx" for a in (reference.array, capture.array)
        ]
        checks.fail(field, f"the same antennas ({words[0]})", f"others ({words[1]})")
    if not capture.waveform.same_frequencies(reference.waveform):
        words = [
            f"{w.n_freq} from {w.frequencies_hz[0] / 1e9:g} to {w.frequencies_hz[-1] / 1e9:g} GHz"
            for w in (reference.waveform, capture.waveform)
        ]
        checks.fail(field, f"the same frequencies ({words[0]})", f"others ({words[1]})")
