"""The imaging operator and its adjoint, term by term: host side of ``kernels/direct_sum.cl``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.fast import Report, array_parts
from clradar.model import AntennaArray, Waveform
from clradar.opencl import Buffers, Device, build
from clradar.opencl.buffers import antenna_rows, hi_lo

TX_BLOCK, RX_BLOCK = 4, 2
"""Transmitters and receivers that an item sums side by side, as registers allow."""

FREQUENCY_CHUNK = 8  # frequencies per call, so that their part of the cube stays in the cache
LEAST_POINTS = 256  # points per call: two sides of the phasors of one frequency stay in the cache
CHUNK_PHASORS = 2**18
"""Points times antennas of a call that may have more points. Part of the order of summation, like
the other sizes, so it depends on the array alone."""


@dataclass(frozen=True, slots=True)
class _Sizes:
    """Compile-time constants."""

    width: int
    tx_block: int = TX_BLOCK
    rx_block: int = RX_BLOCK


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Points, and which antennas see them."""

    n: int
    points_m: Callable[[int, int], np.ndarray]  # of [start, stop): (stop - start, 3), float64
    tx_visible: np.ndarray | None = None  # (n, n_tx), bool; None: every one sees every point
    rx_visible: np.ndarray | None = None  # (n, n_rx), bool


class DirectSum:
    """The sums over points and over pairs, to float32 rounding.

    `number` says which of the values of a larger set, raveled, are those of the points.
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        number: np.ndarray | slice,
        points: PointSet,
        device: Device,
    ) -> None:
        self.array, self.number, self.points, self.device = array, number, points, device
        self.k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        self.program = build(device, "direct_sum.cl", _Sizes(device.width))

    def forward(self, values: np.ndarray, out: np.ndarray, report: Report) -> None:
        """Add the samples of values to `out`, complex64, (n_tx, n_rx, n_freq)."""
        reflectivity = values.ravel()[self.number]
        with Buffers(self.device) as buffers:
            for tx, rx, part in array_parts(self.array):
                n_tx, n_rx = _whole(part.n_tx, TX_BLOCK), _whole(part.n_rx, RX_BLOCK)
                for chunk in self._frequencies():
                    n_freq = len(self.k[chunk])
                    capture = buffers.zeros(8 * n_freq * n_tx * n_rx)
                    for held in self._phasors(buffers, tx, rx, chunk, reflectivity):
                        self.program.launch(
                            "sum_over_points", (n_rx // RX_BLOCK, n_tx // TX_BLOCK, n_freq),
                            *_numbers(held.n_points, n_tx, n_rx, n_freq), held.tx, held.rx, capture,
                            work=8.0 * TX_BLOCK * RX_BLOCK * held.n_points,
                        )  # fmt: skip
                        report(self._share(tx, rx, chunk, held.stop))
                    sums = buffers.read(capture, (n_freq, n_tx, n_rx), np.complex64)
                    buffers.release(capture)
                    sums = sums[:, : part.n_tx, : part.n_rx]
                    out[tx, rx, chunk] += sums.transpose(1, 2, 0)

    def adjoint(
        self, data: np.ndarray, weights: np.ndarray, out: np.ndarray, report: Report
    ) -> None:
        """Add the values of samples, weighted by frequency, to `out`, complex64."""
        total = np.zeros(self.points.n, np.complex128)
        with Buffers(self.device) as buffers:
            for tx, rx, part in array_parts(self.array):
                n_tx, n_rx = _whole(part.n_tx, TX_BLOCK), _whole(part.n_rx, RX_BLOCK)
                for chunk in self._frequencies():
                    n_freq = len(self.k[chunk])
                    cube = np.zeros((n_freq, n_tx, n_rx), np.complex64)
                    weighted = data[tx, rx, chunk] * weights[chunk]
                    cube[:, : part.n_tx, : part.n_rx] = weighted.transpose(2, 0, 1)
                    capture = buffers.upload(cube)
                    for held in self._phasors(buffers, tx, rx, chunk, None):
                        n_points = held.n_points
                        values = buffers.empty(8 * n_freq * n_points)
                        self.program.launch(
                            "sum_over_pairs", (n_points // self.device.width, n_freq),
                            *_numbers(n_points, n_tx, n_rx, n_freq), held.tx, held.rx, capture,
                            values, work=8.0 * n_tx * n_rx,
                        )  # fmt: skip
                        shape = (n_freq, 2, n_points)
                        sums = buffers.read(values, shape, np.float32).sum(axis=0, dtype=np.float64)
                        buffers.release(values)
                        sums = sums[:, : held.stop - held.start]
                        total[held.start : held.stop] += sums[0] + 1j * sums[1]
                        report(self._share(tx, rx, chunk, held.stop))
                    buffers.release(capture)
        out.reshape(-1)[self.number] += total.astype(np.complex64)

    def _frequencies(self) -> list[slice]:
        starts = range(0, len(self.k), FREQUENCY_CHUNK)
        return [slice(start, start + FREQUENCY_CHUNK) for start in starts]

    def _share(self, tx: slice, rx: slice, chunk: slice, stop: int) -> float:
        """Return the fraction of the work that is done after some points of a part of the array."""
        n_f = len(self.k)
        parts = [(t, r) for t, r, _ in array_parts(self.array)]
        done = parts.index((tx, rx)) * n_f + chunk.start
        done += len(self.k[chunk]) * stop / self.points.n
        return done / (len(parts) * n_f)

    def _phasors(
        self,
        buffers: Buffers,
        tx: slice,
        rx: slice,
        chunk: slice,
        reflectivity: np.ndarray | None,
    ) -> Iterator[_Phasors]:
        """Yield the phasors of some points at a time, freed when the next are asked for."""
        sides = (self.array.tx_m[tx], self.array.rx_m[rx])
        n_antennas = sum(len(side) for side in sides)
        at_once = max(LEAST_POINTS, CHUNK_PHASORS // n_antennas // 8 * 8)
        k = buffers.upload(np.stack(hi_lo(self.k[chunk])))
        n_freq = len(self.k[chunk])
        for start in range(0, self.points.n, at_once):
            stop = min(start + at_once, self.points.n)
            n_points = _whole(stop - start, 8)
            points_m = np.zeros((n_points, 3))
            points_m[: stop - start] = self.points.points_m(start, stop)
            points = buffers.upload(antenna_rows(points_m).T)
            held, seen_by = [], (self.points.tx_visible, self.points.rx_visible)
            for i, (side, antennas, block) in enumerate(
                zip((tx, rx), sides, (TX_BLOCK, RX_BLOCK), strict=True)
            ):
                amplitude = np.zeros((2, n_points), np.float32)
                amplitude[0, : stop - start] = 1.0
                if i == 0 and reflectivity is not None:
                    amplitude[0, : stop - start] = reflectivity[start:stop].real
                    amplitude[1, : stop - start] = -reflectivity[start:stop].imag
                seen = np.ones((len(antennas), n_points), np.float32)
                visible = seen_by[i]
                if visible is not None:
                    seen[:, : stop - start] = visible[start:stop, side].T
                n_padded = _whole(len(antennas), block)
                phasors = buffers.empty(8 * n_freq * n_padded * n_points)
                given = [buffers.upload(a) for a in (antenna_rows(antennas), amplitude, seen)]
                self.program.launch(
                    "point_phasors", (n_points // self.device.width, n_padded),
                    *_numbers(n_points, len(antennas), n_freq, n_padded), points, given[0], k,
                    *given[1:], phasors, work=40.0 * n_freq,
                )  # fmt: skip
                for buffer in given:
                    buffers.release(buffer)
                held.append(phasors)
            yield _Phasors(start, stop, n_points, held[0], held[1])
            for buffer in (points, *held):
                buffers.release(buffer)
        buffers.release(k)


@dataclass(frozen=True, slots=True, eq=False)
class _Phasors:
    """Phasors of the points [start, stop), n_points with those that fill up whole lanes."""

    start: int
    stop: int
    n_points: int
    tx: Any
    rx: Any


def _numbers(*values: int) -> list[np.uint32]:
    return [np.uint32(value) for value in values]


def _whole(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple
