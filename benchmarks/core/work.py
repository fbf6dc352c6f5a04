"""Pieces of work, ours and those of peers, timed in turns; and the paper's radar.

Not in the timings: imports, the first call of everything that compiles, and what a work names as
given.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import clradar

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)

Call = Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Work:
    """The same work done by us, in one form or several, and by peers, each by its name.

    `amount` of a unit turns seconds into a rate; `agreement` is of the results, one for all forms
    or one for each. A peer does `peer_share` of the work, and is timed in proportion. A pause
    before each run lets threads of the one before end their busy waiting.
    """

    name: str
    ours: Mapping[str, Call]
    peers: Mapping[str, Call]
    agreement: str | Sequence[str]
    amount: float | None = None
    unit: str = "s"
    peer_share: float = 1.0
    pause_s: float = 0.0

    def speed(self, seconds: float) -> str:
        return f"{seconds if self.amount is None else self.amount / seconds:.3g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Row:
    """Timings in words; `ratio`: the fastest peer's time over ours."""

    work: str
    ours: str
    peer: str
    ratio: float
    check: str


def rows_of(work: Work, repeats: int) -> Iterator[Row]:
    """One for each form of ours: medians, all in turns so that other load affects all alike."""
    times = interleaved_s([*work.ours.values(), *work.peers.values()], repeats, work.pause_s)
    ours, peers = times[:, : len(work.ours)], times[:, len(work.ours) :] / work.peer_share
    speeds = [work.speed(float(s)) for s in np.median(peers, axis=0)]
    peer = "; ".join(f"{name} {v}" for name, v in zip(work.peers, speeds, strict=True))
    fastest = peers[:, np.argmin(np.median(peers, axis=0))]
    one = isinstance(work.agreement, str)
    agreements = [work.agreement] * len(work.ours) if one else work.agreement
    for name, seconds, agreement in zip(work.ours, ours.T, agreements, strict=True):
        ratios = fastest / seconds
        yield Row(
            f"{work.name}{name}", work.speed(float(np.median(seconds))), peer,
            float(np.median(ratios)), f"{ratios.min():.1f} to {ratios.max():.1f}; {agreement}",
        )  # fmt: skip


def relative_rms_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    error = np.sqrt(np.mean(np.abs(ours - theirs) ** 2) / np.mean(np.abs(theirs) ** 2))
    return float(20 * np.log10(error))


def interleaved_s(works: Sequence[Call], repeats: int, pause_s: float) -> np.ndarray:
    """Seconds of each work, shape (repeats, n_works), after one run of each."""
    for work in works:
        work()
    times = np.empty((repeats, len(works)))
    for row in times:
        for i, work in enumerate(works):
            time.sleep(pause_s)
            start = time.perf_counter()
            work()
            row[i] = time.perf_counter() - start
    return times
