"""Independent streams of counter-based random numbers (Philox, Salmon et al. 2011)."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from clradar.model import checks

SEED_LIMIT = 2**64 - 1
FRAME_LIMIT = 999_999
"""Largest number of a recorded frame."""


class Part(IntEnum):
    """Quantities that are drawn. A number never changes its meaning."""

    NOISE = 1
    TX_GAIN = 2
    RX_GAIN = 3
    TX_PHASE = 4
    RX_PHASE = 5
    TX_DELAY = 6
    RX_DELAY = 7
    TX_PHASE_DRIFT = 8
    RX_PHASE_DRIFT = 9
    TX_GAIN_DRIFT = 10
    RX_GAIN_DRIFT = 11
    COMMON_PHASE_DRIFT = 12


def random_stream(seed: int, part: Part, frame: int = 0) -> np.random.Generator:
    """Return the generator of one part of one frame.

    Philox4x64-10 with the key (seed, part), started at the counter (0, 0, 0, frame): the streams of
    all parts and frames are independent.

    Parameters
    ----------
    seed : int, 0 to 2**64 - 1
    part : Part
    frame : int, 0 to 999999

    Raises
    ------
    ModelError
        A seed or a frame outside these limits.

    References
    ----------
    J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
    """
    key = np.array([checks.whole("seed", seed, 0, SEED_LIMIT), part], dtype=np.uint64)
    counter = np.array([0, 0, 0, checks.whole("frame", frame, 0, FRAME_LIMIT)], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))
