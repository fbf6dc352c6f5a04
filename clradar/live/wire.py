"""The form of frames on a stream (docs/live.md): one hello, then frames of one size.

All numbers are little-endian. Nothing is allocated before its size was checked, and the size of
frames is settled by the hello.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.errors import MeasurementError, ModelError, quoted
from clradar.files.json_text import parse_object
from clradar.model import AntennaArray, Capture, Waveform

HELLO = struct.Struct("<8sI")
"""Magic, and the bytes of JSON that follow."""

HELLO_MAGIC = b"clradar1"
MAX_HELLO_BYTES = 2**20
"""Some thousand antennas and frequencies, as text."""

FRAME = struct.Struct("<4sIQQ")
"""Magic, number of the frame, its time in microseconds, and the bytes of samples that follow."""

FRAME_MAGIC = b"FRAM"
MAX_FRAME_BYTES = 2**28
"""Samples of a frame: 30 times those of 94 x 94 pairs and 128 frequencies."""

_FIELDS = ("name", "tx_m", "rx_m", "frequencies_hz")


@dataclass(frozen=True, slots=True, eq=False)
class Hello:
    """What all frames of a stream share."""

    array: AntennaArray
    waveform: Waveform

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n_tx, n_rx, n_freq)"""
        return self.array.n_tx, self.array.n_rx, self.waveform.n_freq

    @property
    def frame_bytes(self) -> int:
        n_tx, n_rx, n_freq = self.shape
        return 8 * n_tx * n_rx * n_freq

    def encoded(self) -> bytes:
        """Return the bytes with which a stream begins."""
        values = (
            self.array.name,
            self.array.tx_m.tolist(),
            self.array.rx_m.tolist(),
            self.waveform.frequencies_hz.tolist(),
        )
        text = json.dumps(dict(zip(_FIELDS, values, strict=True))).encode()
        return HELLO.pack(HELLO_MAGIC, len(text)) + text


def hello_bytes(head: bytes) -> int:
    """Return how many bytes of JSON follow the first ones of a stream.

    Raises
    ------
    MeasurementError
        It is not a stream of frames, or the hello is too long.
    """
    magic, n_bytes = HELLO.unpack(head)
    if magic != HELLO_MAGIC:
        raise MeasurementError(f"stream: expected it to begin with {HELLO_MAGIC!r}, got {magic!r}")
    if not 0 < n_bytes <= MAX_HELLO_BYTES:
        raise MeasurementError(
            f"stream: expected a hello of 1 to {MAX_HELLO_BYTES} bytes, got {n_bytes}"
        )
    return int(n_bytes)


def decoded_hello(text: bytes) -> Hello:
    """Return antennas and frequencies of a hello's JSON.

    Raises
    ------
    MeasurementError
        No such JSON, antennas or frequencies that cannot be, or frames beyond `MAX_FRAME_BYTES`.
    """
    try:
        values: dict[str, Any] = parse_object(text.decode(), strict=True)
        if sorted(values) != sorted(_FIELDS):
            raise ValueError(f"fields {', '.join(_FIELDS)} expected, got {quoted(sorted(values))}")
        name, tx_m, rx_m, frequencies_hz = (values[field] for field in _FIELDS)
        hello = Hello(AntennaArray(tx_m, rx_m, name), Waveform(frequencies_hz))
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise MeasurementError(f"stream: bad hello: {quoted(error)}") from error
    if hello.frame_bytes > MAX_FRAME_BYTES:
        raise MeasurementError(
            f"stream: expected frames of at most {MAX_FRAME_BYTES} bytes, got {hello.shape}"
        )
    return hello


def frame_head(hello: Hello, number: int, timestamp_us: int) -> bytes:
    """Return what precedes the samples of a frame."""
    return FRAME.pack(FRAME_MAGIC, number, timestamp_us, hello.frame_bytes)


def decoded_frame_head(hello: Hello, head: bytes) -> tuple[int, int]:
    """Return number and time (microseconds) of a frame.

    Raises
    ------
    MeasurementError
        No head of a frame, or a frame of another size than the hello's: what follows cannot be
        told apart any more.
    """
    magic, number, timestamp_us, n_bytes = FRAME.unpack(head)
    if magic != FRAME_MAGIC:
        raise MeasurementError(f"stream: expected a frame, {FRAME_MAGIC!r}, got {magic!r}")
    if n_bytes != hello.frame_bytes:
        raise MeasurementError(
            f"stream: expected frames of {hello.frame_bytes} bytes, as the hello says, "
            f"got {n_bytes}"
        )
    return int(number), int(timestamp_us)


def frame_capture(
    hello: Hello, number: int, timestamp_us: int, samples: np.ndarray, source: str
) -> Capture:
    """Return a frame as a capture; `samples` is complex64 of `Hello.shape`.

    Raises
    ------
    MeasurementError
        NaN or infinite samples.
    """
    samples.flags.writeable = False
    meta = {"source": source, "frame": number, "timestamp_us": timestamp_us}
    try:
        return Capture(samples, hello.array, hello.waveform, meta)
    except ModelError as error:
        raise MeasurementError(f"frame {number}: {error}") from error
