"""When an imager records each sample of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.record import Record

STEP_S = 2.5e-6
"""Time of one frequency at one Tx. The imager's own is not published: this is an assumption, by
which its 94 Tx and 128 frequencies take 30 ms."""

RATE_HZ = 8.0  # frames per second of the recordings that are known
ORDERS = ("tx", "frequency")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SweepTiming(Record):
    """When the samples of one sweep are recorded, from its beginning on.

    Parameters
    ----------
    times_s : array_like, shape (n_tx, n_rx or 1, n_freq), float64
        Of every sample; with one column all Rx record at the same time.
    """

    times_s: Any

    def __post_init__(self) -> None:
        self._set_array("times_s", np.float64, (None, None, None), " (tx, rx or 1, freq)")

    @classmethod
    def in_order(
        cls, n_tx: int, n_freq: int, *, step_s: float = STEP_S, order: str = "tx"
    ) -> SweepTiming:
        """Return the timing of Tx that take turns, a sample each `step_s`, at all Rx at once.

        The order "tx" records all frequencies at each Tx, "frequency" switches through all Tx at
        each frequency; a step of 0 records all at once.
        """
        n_tx = checks.whole("n_tx", n_tx, 1)
        n_freq = checks.whole("n_freq", n_freq, 1)
        step_s = checks.within("step_s", step_s, 0.0, np.inf, " s")
        checks.one_of("order", order, ORDERS)
        tx, step = np.arange(n_tx)[:, None, None], np.arange(n_freq)[None, None]
        slot = tx * n_freq + step if order == "tx" else step * n_tx + tx
        return cls(slot * step_s)

    @property
    def begin_s(self) -> float:
        """Time of the first sample."""
        return float(self.times_s.min())

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return float(self.times_s.max())
