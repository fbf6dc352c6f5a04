"""Captures: the complex samples of one frame, simulated or measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.array import AntennaArray
from clradar.model.record import Record
from clradar.model.waveform import Waveform


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Capture(Record):
    """One frame: the complex response of every pair of antennas at every frequency.

    Parameters
    ----------
    data : array_like, shape (n_tx, n_rx, n_freq), complex64
        A path of total length d contributes exp(-j 2 pi f d / c).
    array : AntennaArray
    waveform : Waveform
    meta : mapping
        Provenance, in types of JSON: numbers, strings, lists and mappings.

    Raises
    ------
    ModelError
        The shape does not fit `array` and `waveform`, or `data` has NaN or infinite values.

    Examples
    --------
    The echo of a point 0.3 m in front of one Tx and Rx: the slope of its phase over frequency gives
    the path length back.

    >>> import numpy as np
    >>> import clradar
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)
    >>> k_per_m = waveform.frequencies_hz / 299_792_458
    >>> capture = clradar.Capture([[np.exp(-2j * np.pi * k_per_m * 0.6)]], array, waveform)
    >>> capture.data.shape
    (1, 1, 64)
    >>> slope = np.polyfit(2 * np.pi * k_per_m, np.unwrap(np.angle(capture.data[0, 0])), 1)[0]
    >>> print(f"{-slope:.4f} m")
    0.6000 m
    """

    data: np.ndarray
    array: AntennaArray
    waveform: Waveform
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.instance("Capture.array", self.array, AntennaArray)
        checks.instance("Capture.waveform", self.waveform, Waveform)
        shape = (self.array.n_tx, self.array.n_rx, self.waveform.n_freq)
        self._set_array("data", np.complex64, shape, " (tx, rx, freq)")
        self._set(meta=checks.frozen_mapping("Capture.meta", self.meta))


def check_same_radar(field: str, capture: Capture, reference: Capture) -> None:
    """Raise a `ModelError` unless both captures have the same antennas and frequencies."""
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
