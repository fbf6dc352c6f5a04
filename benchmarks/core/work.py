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
from clradar.constants import SPEED_OF_LIGHT_M_PER_S

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


def rows_of(work: Work, repeats: int) -> Iterator[dict[str, Any]]:
    """One for each form of ours: medians, all in turns so that other load affects all alike.

    The ratio is the fastest peer's time over ours.
    """
    times = interleaved_s([*work.ours.values(), *work.peers.values()], repeats, work.pause_s)
    ours, peers = times[:, : len(work.ours)], times[:, len(work.ours) :] / work.peer_share
    speeds = [work.speed(float(s)) for s in np.median(peers, axis=0)]
    peer = "; ".join(f"{name} {v}" for name, v in zip(work.peers, speeds, strict=True))
    fastest = peers[:, np.argmin(np.median(peers, axis=0))]
    one = isinstance(work.agreement, str)
    agreements = [work.agreement] * len(work.ours) if one else work.agreement
    for name, seconds, agreement in zip(work.ours, ours.T, agreements, strict=True):
        ratios = fastest / seconds
        yield {
            "work": f"{work.name}{name}", "ours": work.speed(float(np.median(seconds))),
            "peer": peer, "ratio": float(np.median(ratios)),
            "check": f"{ratios.min():.1f} to {ratios.max():.1f}; {agreement}",
        }  # fmt: skip


def lengths_m(array: clradar.AntennaArray, at_m: np.ndarray) -> list[np.ndarray]:
    """From points (n, 3) to the antennas of either side, (n, antennas)."""
    return [np.linalg.norm(at_m[:, None] - side.antennas_m, axis=2) for side in array.sides]


def exact_by_gemm(capture: clradar.Capture, points_m: np.ndarray, dtype: Any) -> np.ndarray:
    """The exact sum as one complex matrix product per frequency, in float64 phases."""
    out, sides = np.zeros(len(points_m), dtype), lengths_m(capture.array, points_m)
    for n, f_hz in enumerate(capture.waveform.frequencies_hz):
        jk = 2j * np.pi * f_hz / SPEED_OF_LIGHT_M_PER_S
        tx, rx = (np.exp(jk * length_m).astype(dtype) for length_m in sides)
        out += ((tx @ np.ascontiguousarray(capture.data[:, :, n], dtype)) * rx).sum(axis=1)
    return out / capture.data.size


def forward_by_gemm(
    points_m: np.ndarray,
    rho: np.ndarray,
    array: clradar.AntennaArray,
    waveform: clradar.Waveform,
    dtype: Any,
) -> np.ndarray:
    """The imaging operator, one complex matrix product per frequency, in float64 phases."""
    out = np.empty((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)
    sides = lengths_m(array, points_m)
    for n, f_hz in enumerate(waveform.frequencies_hz):
        jk = -2j * np.pi * f_hz / SPEED_OF_LIGHT_M_PER_S
        tx, rx = (np.exp(jk * length_m).astype(dtype) for length_m in sides)
        out[:, :, n] = (tx.T * rho) @ rx
    return out


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
