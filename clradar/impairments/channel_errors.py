"""Random channel errors: the fixed ones of an uncalibrated instrument, and drift over frames.

Random numbers are of Philox, which counts: J. Salmon et al., "Parallel random numbers: as easy as
1, 2, 3", SC 2011.
"""

from __future__ import annotations

from collections.abc import Iterable
from threading import Lock
from typing import Any

import numpy as np

from clradar.model import AntennaArray, ChannelResponse, Waveform, checks

SEED_LIMIT = 2**64 - 1
FRAME_LIMIT = 999_999  # largest number of a recorded frame


DRAWN = (
    *("noise", "tx gain", "rx gain", "tx phase", "rx phase", "tx delay", "rx delay"),
    *("tx phase drift", "rx phase drift", "tx gain drift", "rx gain drift", "common phase drift"),
)
"""Quantities that are drawn, by numbers from 1 on: none ever changes its place."""


def random_stream(seed: int, drawn: str, frame: int = 0) -> np.random.Generator:
    """Return the generator of one of `DRAWN` in one frame, independent of those of all others.

    Philox4x64-10 with the key (seed, its number), started at the counter (0, 0, 0, frame).
    """
    number = DRAWN.index(drawn) + 1
    key = np.array([checks.whole("seed", seed, 0, SEED_LIMIT), number], dtype=np.uint64)
    counter = np.array([0, 0, 0, checks.whole("frame", frame, 0, FRAME_LIMIT)], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))


GAIN_LIMIT_DB = 300.0  # complex64 holds amplitudes from -900 to 760 dB, so a signal still fits in
_WALKS: dict[Any, tuple[int, np.ndarray, Any]] = {}
_LOCK = Lock()


def draw_channels(
    array: AntennaArray,
    waveform: Waveform,
    *,
    seed: int = 0,
    gain_db: float = 3.0,
    phase_rad: float = np.pi,
    delay_s: float = 20e-12,
    dead_tx: Iterable[int] = (),
    dead_rx: Iterable[int] = (),
) -> ChannelResponse:
    """Draw the gains and delays of an uncalibrated instrument, each uniform within +- its spread.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
        The gains are those at its centre frequency.
    seed : int
        Gain, phase and delay have streams of their own: another `gain_db` leaves the phases.
    gain_db : float
    phase_rad : float, at most pi
        With pi all phases are equally likely.
    delay_s : float
    dead_tx, dead_rx : iterable of int
        Channels whose gain is 0.

    Returns
    -------
    ChannelResponse

    Examples
    --------
    >>> clradar.draw_channels(capture.array, capture.waveform, dead_rx=[0]).rx_gain
    array([0.+0.j])
    """
    checks.instance("draw_channels: array", array, AntennaArray)
    checks.instance("draw_channels: waveform", waveform, Waveform)
    gain = checks.within("draw_channels: gain_db", gain_db, 0.0, GAIN_LIMIT_DB)
    phase = checks.within("draw_channels: phase_rad", phase_rad, 0.0, np.pi)
    delay = checks.within("draw_channels: delay_s", delay_s, 0.0, np.inf)
    drawn: dict[str, np.ndarray] = {}
    for side, count, dead in (("tx", array.n_tx, dead_tx), ("rx", array.n_rx, dead_rx)):
        kinds = (f"{side} {kind}" for kind in ("gain", "phase", "delay"))
        units = [random_stream(seed, kind).uniform(-1, 1, count) for kind in kinds]
        response = 10 ** (gain * units[0] / 20) * np.exp(1j * phase * units[1])
        field = f"draw_channels: dead_{side}"
        for channel in checks.several(field, dead):
            response[checks.whole(field, channel, 0, count - 1)] = 0
        drawn |= {f"{side}_gain": response, f"{side}_delay_s": delay * units[2]}
    return ChannelResponse(**drawn, reference_hz=waveform.center_hz)


def drift_factors(
    array: AntennaArray,
    *,
    seed: int,
    frame: int,
    phase_rad: float,
    gain_db: float,
    common_phase_rad: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the complex drift of the channels since frame 0, shape (n_tx,) and (n_rx,).

    Random walks: each frame adds a normal step to the phase (standard deviation `phase_rad`) and to
    the gain (`gain_db`) of every channel, and one to the phase that all share. Frame 0 has none.
    """
    common = _walked(seed, "common phase drift", 1, frame, common_phase_rad)
    sides = []
    for side, count in (("tx", array.n_tx), ("rx", array.n_rx)):
        gain = _walked(seed, f"{side} gain drift", count, frame, gain_db)
        if (most := np.abs(gain).max()) > GAIN_LIMIT_DB:
            got = f"{most:g} dB at frame {frame}"
            checks.fail("drift_gain_db", f"a walk within {GAIN_LIMIT_DB:g} dB", got)
        phase = _walked(seed, f"{side} phase drift", count, frame, phase_rad)
        sides.append(10 ** (gain / 20) * np.exp(1j * phase))
    return sides[0] * np.exp(1j * common), sides[1]


def _walked(seed: int, drawn: str, count: int, frame: int, deviation: float) -> np.ndarray:
    """Sum of the normal steps of so many frames, shape (count,): from the frame before, if that is
    the last that was asked for, so that a recording of n frames does not cost n^2 steps."""
    if not deviation:
        return np.zeros(count)
    key = (seed, drawn, count)
    with _LOCK:
        done, position, random = _WALKS.pop(key, (0, np.zeros(count), None))
        if random is None or done > frame:
            done, position, random = 0, np.zeros(count), random_stream(seed, drawn)
        for _ in range(done, frame):
            position = position + random.standard_normal(count)
        _WALKS[key] = (frame, position, random)
        while len(_WALKS) > 64:  # are remembered
            del _WALKS[next(iter(_WALKS))]
        return deviation * position
