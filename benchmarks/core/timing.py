"""Timing pieces of work alternately, a row of results for each, and the paper's radar.

Not in the timings: imports, the first call of everything that compiles, and what a row names as
given.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import clradar

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)


@dataclass(frozen=True, slots=True)
class Row:
    """Timings of one piece of work in words; `ratio`: the peer's time over ours."""

    work: str
    ours: str
    peer: str = ""
    ratio: float | None = None
    check: str = ""


def relative_rms_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    error = np.sqrt(np.mean(np.abs(ours - theirs) ** 2) / np.mean(np.abs(theirs) ** 2))
    return float(20 * np.log10(error))


def interleaved_s(
    works: Sequence[Callable[[], Any]], repeats: int, pause_s: float = 0.0
) -> np.ndarray:
    """Seconds of each work, shape (repeats, n_works), alternately: other load affects all alike.

    A pause before each lets threads of the one before end their busy waiting.
    """
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
