"""The phasor sum against finufft."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from core import peers
from core.timing import ARRAY, WAVEFORM, Row, interleaved_s, relative_rms_db


class PathSums:
    """Paths spread evenly over all pairs."""

    def __init__(self, device: clradar.Device, n_paths: int) -> None:
        rng = np.random.default_rng(0)
        pair = np.sort(rng.integers(0, ARRAY.n_tx * ARRAY.n_rx, n_paths))
        length = rng.uniform(0.5, 0.8, n_paths)
        self.paths = clradar.Paths(
            pair // ARRAY.n_rx, pair % ARRAY.n_rx, length, np.ones(n_paths), np.ones(n_paths),
            ARRAY.n_tx, ARRAY.n_rx,
        )  # fmt: skip
        self.start = np.searchsorted(pair, np.arange(ARRAY.n_tx * ARRAY.n_rx + 1))
        self.peer = peers.FinufftPhasorSum(self.start, WAVEFORM.frequencies_hz, 1e-5)
        self.device = device

    def ours(self) -> np.ndarray:
        data = clradar.synthesize(self.paths, ARRAY, WAVEFORM, device=self.device).data
        return data.reshape(-1, WAVEFORM.n_freq)

    def prepare(self) -> None:
        """Make the peer's points and strengths."""
        self.peer.prepare(self.paths.length_m, self.paths.amplitude)

    def error_db(self, data: np.ndarray) -> float:
        """Against float64, for a few of the pairs."""
        some = range(0, len(self.start) - 1, 400)
        k = WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        rows = (self.paths.length_m[self.start[i] : self.start[i + 1]] for i in some)
        want = np.array([np.exp(-2j * np.pi * np.outer(d, k)).sum(axis=0) for d in rows])
        return relative_rms_db(data[some], want)


def phasor_sum(device: clradar.Device, repeats: int, n_paths: int) -> list[Row]:
    work = PathSums(device, n_paths)
    two = partial(work.peer.transform, 2)
    works: list[Callable[[], Any]] = [work.ours, work.prepare, work.peer.transform, two]
    ours_s, prepare_s, *transforms_s = interleaved_s(works, repeats).T
    transform_s = min(transforms_s, key=np.median)
    one_s, two_s = (np.median(s) for s in transforms_s)
    ratios = (prepare_s + transform_s) / ours_s
    spread = f"ratios {ratios.min():.1f} to {ratios.max():.1f}"
    alone = float(np.median(transform_s / ours_s))
    size = f"{n_paths / 1e6:g} M paths, {len(work.start) - 1} pairs x {WAVEFORM.n_freq}"
    ours_db, peer_db = work.error_db(work.ours()), work.error_db(work.peer.transform())
    return [
        Row(
            work=f"phasor sum, {size}",
            ours=f"{np.median(ours_s):.3f} s",
            peer=f"the faster of: finufft type 1, 1e-5, one thread {one_s:.3f} s, two "
            f"{two_s:.3f} s; and numba, {np.median(prepare_s):.3f} s for its points and strengths",
            ratio=float(np.median(ratios)),
            check=f"{spread}, {alone:.1f} without the preparation; against float64 ours "
            f"{ours_db:.0f} dB, the peer's {peer_db:.0f} dB",
        ),
    ]
