"""When the frames of a recording are due, at its own rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clradar.errors import ClradarError
from measurement_io import Recording

RATE_HZ = 8.0
"""Of recordings whose frames have no time stamps."""

RATES_HZ = (0.01, 1000.0)
"""Rates that can be; time stamps that say otherwise are not believed."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Equal steps: frame i is due i / rate_hz seconds after the first.

    Attributes
    ----------
    rate_hz : float
    assumed : bool
        Whether the recording does not tell.
    """

    rate_hz: float
    assumed: bool = False

    @property
    def words(self) -> str:
        return f"{self.rate_hz:.3g} frames/s{' (no time stamps)' if self.assumed else ''}"

    def due_s(self, frame: int) -> float:
        """Seconds after the first frame at which a frame is due."""
        return frame / self.rate_hz

    def latest(self, elapsed_s: float) -> int:
        """Return the last frame that is due after some seconds."""
        return math.floor(elapsed_s * self.rate_hz + 1e-9)


def schedule_of(recording: Recording) -> Schedule:
    """Return the mean rate between the first frame and the last that can be read."""
    n = len(recording)
    try:
        first, last = (recording[at].meta.get("timestamp_us") for at in (0, n - 1))
    except ClradarError:
        return Schedule(RATE_HZ, assumed=True)
    if n > 1 and isinstance(first, int | float) and isinstance(last, int | float) and last > first:
        rate_hz = 1e6 * (n - 1) / (last - first)
        if RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
            return Schedule(rate_hz)
    return Schedule(RATE_HZ, assumed=True)
