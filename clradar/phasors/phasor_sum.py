"""The phasor sum over path lengths, accumulated tile by tile: host side of ``synthesize.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import AntennaArray, Waveform, checks
from clradar.opencl import Device, build
from clradar.opencl.buffers import FEWEST_BYTES, OnDevice, hi_lo
from clradar.phasors.length_blocks import MOMENTS, MOST_SLOTS, length_blocks
from clradar.tracing.lit_surface import SUM_SHARE

CALL_PATHS = 2**18
"""Paths per kernel call; a smaller device makes it smaller. No result depends on it."""

PATH_BYTES = 8 + 4  # device memory of a path: float64 length, float32 amplitude
GROUP_PAIRS = 16
"""Pairs per item of the last kernel with eight lanes, which share the phases of their blocks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesizeOptions:
    """Options of ``synthesize.cl``."""

    width: int
    in_parts: bool
    pairs: int
    moments: int = MOMENTS
    most_slots: int = MOST_SLOTS


def pairs_within(n_bytes: float, waveform: Waveform, device: Device) -> int:
    """Return of how many pairs the sum takes at most so much memory.

    With the table, and where the paths of each pair begin in a call and in the next.
    """
    blocks, n_columns = length_blocks(waveform), _n_columns(waveform, device)
    whole = len(blocks.table) * 4 * n_columns + 2 * FEWEST_BYTES
    return int(n_bytes - whole) // (sum(_bytes_of_pair(blocks.n_slots, n_columns)) + 2 * 4)


def _n_columns(waveform: Waveform, device: Device) -> int:
    return -(-waveform.n_freq // device.width) * device.width


def _bytes_of_pair(n_slots: int, n_columns: int) -> tuple[int, int, int, int]:
    """Of tags, moments, sums, and the samples that are read."""
    return 4 * (n_slots + 1), 16 * MOMENTS * n_slots, 16 * n_columns, 8 * n_columns


@dataclass(slots=True, eq=False)
class _Slice:
    """A range of pairs whose state is on the device at a time, and that state when it is not."""

    first: int
    stop: int
    state: list[np.ndarray] | None


class PhasorSum(OnDevice):
    """The running sum of one capture on a device.

    A context manager. Where the state of all pairs exceeds the device's memory, that of one slice
    of them is there at a time, and the slices stay on the host between calls. `in_parts`: lengths
    on the device come as hi + lo, and not as float64.
    """

    def __init__(
        self, array: AntennaArray, waveform: Waveform, device: Device, in_parts: bool = False
    ) -> None:
        super().__init__(device)
        self._array, self._waveform = array, waveform
        self._n_pairs = array.n_tx * array.n_rx
        self._n_columns = _n_columns(waveform, device)
        self._blocks = length_blocks(waveform)
        self._item_pairs = 1 if device.width == 1 else GROUP_PAIRS
        options = SynthesizeOptions(width=device.width, in_parts=in_parts, pairs=self._item_pairs)
        self._program = build(device, "synthesize.cl", options)
        self._running: list[Any] = []

    def __exit__(self, *error: Any) -> None:
        try:
            self._finish_call()
        finally:
            super().__exit__(*error)

    def _prepare(self) -> None:
        n_slots, n_columns = self._blocks.n_slots, self._n_columns
        tag, moments, total, out = _bytes_of_pair(n_slots, n_columns)
        room = min(self._buffers.free_bytes, SUM_SHARE * self.device.budget_bytes)
        most = pairs_within(room, self._waveform, self.device)
        most = min(most, self.device.max_buffer_bytes // max(moments, total))
        count = max(1, min(self._n_pairs, most))
        firsts = range(0, self._n_pairs, count)
        self._slices = [_Slice(at, min(at + count, self._n_pairs), None) for at in firsts]
        fill = ((0, 0), (0, n_columns - self._waveform.n_freq))
        self._table = self._buffers.upload(np.pad(self._blocks.table, fill, mode="edge"))
        self._tag = self._buffers.zeros(tag * count)
        self._moments = self._buffers.empty(moments * count)
        self._sum = self._buffers.empty(total * count)
        self._out = self._buffers.empty(out * count)
        # The columns of a call are uploaded while those of the previous one are in use.
        left = min(self._buffers.free_bytes - 8 * (count + 1), self.device.max_buffer_bytes)
        self._call_paths = int(max(1, min(CALL_PATHS, left // 2 // PATH_BYTES)))

    def add(self, pair: np.ndarray, length_m: np.ndarray, amplitude: np.ndarray) -> None:
        """Add paths, by ascending pair, of shape (n,): lengths in float64, amplitudes in float32.

        A path of more than 2^21 wavelengths is a `ModelError`.
        """
        self._check_length(length_m.max(initial=0.0))
        for at in range(0, len(pair), self._call_paths):
            part = slice(at, at + self._call_paths)
            self._add_call(pair[part], length_m[part], amplitude[part])

    def _check_length(self, longest_m: float) -> None:
        if longest_m > self._blocks.longest_m:
            checks.fail(
                "paths",
                f"lengths up to {self._blocks.longest_m:g} m (2^21 wavelengths at "
                f"{self._waveform.frequencies_hz[-1]:g} Hz)",
                f"{longest_m:g} m",
            )

    def _add_call(self, pair: np.ndarray, length_m: np.ndarray, amplitude: np.ndarray) -> None:
        if len(pair) < self.device.width:  # the kernel reads as many paths as it has lanes
            fill = (0, self.device.width - len(pair))
            length_m, amplitude = np.pad(length_m, fill), np.pad(amplitude, fill)
        columns = [self._buffers.borrow(length_m), self._buffers.borrow(amplitude)]
        first, stop = int(pair[0]), int(pair[-1]) + 1
        starts = np.searchsorted(pair, np.arange(first, stop + 1, dtype=pair.dtype))
        self._start(starts.astype(np.uint32), first, len(length_m), columns, columns)

    def add_on_device(
        self, start: np.ndarray, length: Any, amplitude: Any, longest_m: float
    ) -> None:
        """Add paths that a kernel wrote; later commands may overwrite them.

        `start`, uint32, shape (n_pairs + 1,), has the first path of each pair, then the number of
        paths. Buffers: `length` is float64 (n), metres, or float (n, 2), hi + lo, with `in_parts`;
        `amplitude` is float (n); both for at least eight paths. None is longer than `longest_m`,
        which is a `ModelError` beyond 2^21 wavelengths.
        """
        self._check_length(longest_m)
        total = max(int(start[-1]), self.device.width)
        self._start(start, 0, total, [length, amplitude], [])

    def _start(
        self, starts: np.ndarray, at: int, total: int, columns: list[Any], borrowed: list[Any]
    ) -> None:
        """Add paths of successive pairs from `at` on and release `borrowed` afterwards."""
        for part in self._slices:
            first, stop = max(part.first, at), min(part.stop, at + len(starts) - 1)
            if first >= stop:
                continue
            start = self._buffers.borrow(starts[first - at : stop - at + 1])
            self._fetch(part)
            wait = self._program.start(
                "add_paths", (stop - first,), np.uint32(stop - first),
                np.uint32(part.stop - part.first), np.uint32(first - part.first), np.uint32(total),
                np.uint32(self._n_columns), np.uint32(self._blocks.n_slots),
                np.float32(self._blocks.block_m), np.float32(self._blocks.per_half_block),
                *hi_lo(self._blocks.wavenumber), start, *columns, self._table, self._tag,
                self._moments, self._sum, work=350.0 * total / (stop - first),
            )  # fmt: skip
            if len(self._slices) == 1:
                # The host prepares the next call while this one runs.
                self._finish_call()
                self._running = [wait, *borrowed, start]
                return
            wait()
            self._store(part)
            self._buffers.release(start)
        for column in borrowed:
            self._buffers.release(column)

    def _finish_call(self) -> None:
        """Wait for the call that is running, if any, and release what it borrowed."""
        if self._running:
            wait, *borrowed = self._running
            self._running = []
            wait()
            for buffer in borrowed:
                self._buffers.release(buffer)

    def _state(self, n_pairs: int) -> list[tuple[Any, tuple[int, ...], Any]]:
        """The state that is kept between calls: buffers with shapes and dtypes."""
        n_slots = self._blocks.n_slots
        return [
            (self._tag, (n_slots + 1, n_pairs), np.int32),
            (self._moments, (n_slots, n_pairs, 4, MOMENTS), np.float32),
            (self._sum, (n_pairs, 4, self._n_columns), np.float32),
        ]

    def _fetch(self, part: _Slice) -> None:
        """Bring a slice's state to the device; a single slice stays there."""
        if len(self._slices) == 1:
            return
        kept = self._state(part.stop - part.first)
        if part.state is None:
            tag, shape, dtype = kept[0]
            self._buffers.write(tag, np.zeros(shape, dtype))
            return
        for (buffer, _, _), values in zip(kept, part.state, strict=True):
            self._buffers.write(buffer, values)

    def _store(self, part: _Slice) -> None:
        part.state = [self._buffers.read(*kept) for kept in self._state(part.stop - part.first)]

    def on_device(self) -> tuple[Any, int] | None:
        """The sum as a buffer, complex64 (n_pairs, n), and n, of which the first n_freq count.

        None where the state of all pairs does not fit at once.
        """
        self._finish_call()
        if len(self._slices) > 1:
            return None
        self._finish(self._slices[0])
        return self._out, self._n_columns

    def result(self) -> np.ndarray:
        """The sum, shape (n_tx, n_rx, n_freq), complex64, read-only."""
        n_freq, parts = self._waveform.n_freq, []
        self._finish_call()
        for part in self._slices:
            count = part.stop - part.first
            self._finish(part)
            out = self._buffers.read(self._out, (count, self._n_columns), np.complex64)
            parts.append(np.ascontiguousarray(out[:, :n_freq]) if n_freq < self._n_columns else out)
        data = parts[0] if len(parts) == 1 else np.concatenate(parts)
        data.flags.writeable = False
        return data.reshape(self._array.n_tx, self._array.n_rx, n_freq)

    def _finish(self, part: _Slice) -> None:
        """Form all frequencies of a slice of pairs, in `_out`."""
        count = part.stop - part.first
        columns = 1 if self.device.width == 1 else self._n_columns
        self._fetch(part)
        self._program.launch(
            "finish",
            (self._n_columns // columns, -(-count // self._item_pairs)),
            np.uint32(count),
            np.uint32(self._n_columns),
            np.uint32(columns),
            np.uint32(self._blocks.n_slots),
            np.float32(self._blocks.block_m),
            self._table,
            self._tag,
            self._moments,
            self._sum,
            self._out,
            work=60.0 * self._blocks.n_slots,
        )
