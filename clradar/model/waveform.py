"""Stepped-frequency continuous waveforms (SFCW)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.constants import MAX_FREQUENCIES, PLAUSIBLE_HZ, SPEED_OF_LIGHT_M_PER_S
from clradar.model import checks
from clradar.model.plausible import check_plausible
from clradar.model.record import Record


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Waveform(Record):
    """The list of frequencies at which the radar measures.

    Parameters
    ----------
    frequencies_hz : array_like, shape (n_freq,), float64
        Strictly ascending, from 0.1 GHz to 1 THz; the steps need not be equal.

    Examples
    --------
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    >>> print(f"{1e3 * waveform.range_resolution_m:.1f} mm, {waveform.unambiguous_range_m:.3f} m")
    15.0 mm, 1.904 m
    """

    frequencies_hz: np.ndarray

    def __post_init__(self) -> None:
        axis = checks.one_axis("Waveform.frequencies_hz", self.frequencies_hz)
        if axis[0] <= 0:
            checks.fail("Waveform.frequencies_hz", "positive frequencies", f"{axis[0]:g} Hz")
        check_plausible("Waveform.frequencies_hz", "frequencies", axis, PLAUSIBLE_HZ, "Hz")
        self._set(frequencies_hz=axis)

    @classmethod
    def sfcw(cls, start_hz: float, stop_hz: float, steps: int) -> Waveform:
        """Return `steps` equally spaced frequencies from `start_hz` to `stop_hz`, both included."""
        start = checks.positive("Waveform.sfcw: start_hz", start_hz)
        stop = checks.positive("Waveform.sfcw: stop_hz", stop_hz)
        count = checks.whole("Waveform.sfcw: steps", steps, 1, MAX_FREQUENCIES)
        check_plausible("Waveform.sfcw", "frequencies", [start, stop], PLAUSIBLE_HZ, "Hz")
        if (count == 1) != (start == stop) or stop < start:
            checks.fail(
                "Waveform.sfcw",
                "stop_hz above start_hz (or equal, for one step)",
                f"{start:g} Hz to {stop:g} Hz in {count} steps",
            )
        return cls(np.linspace(start, stop, count))

    @property
    def n_freq(self) -> int:
        return len(self.frequencies_hz)

    @property
    def center_hz(self) -> float:
        """Middle between the lowest and the highest frequency."""
        return float(self.frequencies_hz[0] + self.frequencies_hz[-1]) / 2

    @property
    def span_hz(self) -> float:
        """Highest minus lowest frequency."""
        return float(self.frequencies_hz[-1] - self.frequencies_hz[0])

    @property
    def range_resolution_m(self) -> float:
        """c / (2 B), B the span of the frequencies; infinite for a single frequency."""
        return SPEED_OF_LIGHT_M_PER_S / (2 * self.span_hz) if self.n_freq > 1 else float("inf")

    @property
    def unambiguous_range_m(self) -> float:
        """c / (2 df), after which the range profile repeats; 0 for a single frequency.

        For uneven steps df is the median step, or a quarter of the mean if larger.
        """
        if self.n_freq == 1:
            return 0.0
        mean_hz = self.span_hz / (self.n_freq - 1)
        median_hz = float(np.median(np.diff(self.frequencies_hz)))
        return SPEED_OF_LIGHT_M_PER_S / (2 * max(median_hz, mean_hz / 4))

    def same_frequencies(self, other: Waveform, relative: float = 1e-9) -> bool:
        """Whether both have the same frequencies within `relative` of their value."""
        return self.n_freq == other.n_freq and bool(
            np.allclose(self.frequencies_hz, other.frequencies_hz, rtol=relative, atol=0.0)
        )
