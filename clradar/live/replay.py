"""Sends the frames of a recording to `clradar live`, at its own rate."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np

from clradar.errors import ClradarError, MeasurementError
from clradar.live import wire
from clradar.live.schedule import Schedule, schedule_of
from clradar.model import checks
from measurement_io import Recording

CONNECT_S = 10.0


def replay(
    recording: Recording,
    host: str,
    port: int,
    *,
    rate_hz: float | None = None,
    repeats: int = 1,
    say: Callable[[str], None] = lambda words: None,
) -> int:
    """Send the frames of a recording by TCP, in the form of `clradar.live.wire`.

    Parameters
    ----------
    recording : Recording
    host : str
    port : int
    rate_hz : float, optional
        Frames per second; the recording's own if not given. Infinite: as fast as they go.
    repeats : int
        How often the recording is sent.
    say : callable
        Called with what was sent at the end, and with every frame that cannot be read.

    Returns
    -------
    int
        Frames sent.

    Raises
    ------
    ModelError
        A rate that is not positive.
    MeasurementError
        Nobody listens, or the receiver has gone.
    """
    if rate_hz is not None and not rate_hz > 0:
        checks.fail("rate_hz", "a positive number", f"{rate_hz:g}")
    schedule = schedule_of(recording) if rate_hz is None else Schedule(rate_hz)
    hello = wire.Hello(recording.array, recording.waveform)
    sent = 0
    try:
        with socket.create_connection((host, port), timeout=CONNECT_S) as connection:
            connection.settimeout(None)
            connection.sendall(hello.encoded())
            begun_s = time.perf_counter()
            for at in range(repeats * len(recording)):
                try:
                    capture = recording[at % len(recording)]
                except ClradarError as error:
                    say(str(error))
                    continue
                time.sleep(max(0.0, begun_s + schedule.due_s(at) - time.perf_counter()))
                connection.sendall(wire.frame_head(hello, at, time.time_ns() // 1000))
                connection.sendall(capture.data.reshape(-1).view(np.uint8).data)
                sent += 1
    except (OSError, UnicodeError) as error:
        raise MeasurementError(f"{host}:{port}: {sent} frames sent, then: {error}") from error
    took_s = max(time.perf_counter() - begun_s, 1e-9)
    say(f"{sent} frames sent in {took_s:.1f} s ({sent / took_s:.1f} per second)")
    return sent
