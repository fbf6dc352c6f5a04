"""The phasor sum against finufft, steps equal and unequal, results compared with float64."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.bench.phasor_sums import PathSums
from clradar.bench.timing import WAVEFORM

Measured = Callable[[Callable[[], Any]], Any]
N_PATHS = 1_000_000

OURS_DB, PEER_DB = -120.0, -95.0
"""Ours: a few float32 roundings of terms of one pair, compensated. The peer: 1e-5 is requested."""


@pytest.fixture(scope="module")
def work(device: clradar.Device) -> PathSums:
    return PathSums(device, N_PATHS)


@pytest.mark.benchmark(group="phasor sum, 1 M paths")
@pytest.mark.parametrize("steps", ["equal", "unequal"])
def test_ours(measured: Measured, work: PathSums, steps: str) -> None:
    waveform = WAVEFORM if steps == "equal" else work.unequal
    data: np.ndarray = measured(partial(work.ours, waveform))
    assert work.error_db(data, waveform) <= OURS_DB


@pytest.mark.benchmark(group="phasor sum, 1 M paths")
def test_finufft(measured: Measured, work: PathSums) -> None:
    """Its points and strengths included."""

    def both() -> np.ndarray:
        work.prepare()
        return work.peer.transform()

    data: np.ndarray = measured(both)
    assert work.error_db(data) <= PEER_DB
