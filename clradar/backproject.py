"""Host side of image formation: a capture to a complex volume."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, Volume, VoxelGrid, checks
from clradar.opencl import Buffers, Device, build, open_device
from clradar.packing import antenna_rows, hi_lo
from clradar.trace import Progress

METHODS = ("exact", "range")
DEFAULT_METHOD = "range"
WINDOWS = ("rect", "hann", "taylor")

CHUNK_RX = 96
"""Receivers per call: their legs are held in private memory. Part of the order of summation."""

CHUNK_TX = 512
"""Transmitters per call of the exact sum; a multiple of the kernel's block of 4."""

CHUNK_FREQ = 8
"""Frequencies per call of the exact sum, so that their part of the cube stays in the cache."""

OVERSAMPLING = 16
"""Bins of the range profile per resolution cell c / span. Linear interpolation between bins a
phase of 2 pi u / OVERSAMPLING apart, u the offset from the carrier in spans (-1/2 ... 1/2), errs by
at most (pi u / OVERSAMPLING)^2 / 2: at worst 4.8e-3, and 1.6e-3 RMS (-56 dB) over a flat band."""


@dataclass(frozen=True, slots=True)
class _BackprojectOptions:
    width: int
    chunk: int


@dataclass(frozen=True, slots=True)
class _Tile:
    """Voxels of one piece of the volume: slices along z and y, all of x."""

    z: slice
    y: slice


def frequency_weights(window: str | np.ndarray, n_freq: int) -> np.ndarray:
    """Return the weight of each frequency, shape (n_freq,), float64.

    Parameters
    ----------
    window : "rect", "hann", "taylor", or array_like of shape (n_freq,)
        "hann" and "taylor" (nbar 4, -30 dB) are scipy's symmetric windows as they are, with maximum
        1, not scaled to mean 1.
    """
    if isinstance(window, str):
        checks.one_of("window", window, WINDOWS)
        if window == "rect" or n_freq == 1:
            return np.ones(n_freq)
        from scipy.signal import windows

        values = windows.hann(n_freq) if window == "hann" else windows.taylor(n_freq)
        return np.asarray(values, dtype=np.float64)
    return checks.read_only("window", window, np.float64, (n_freq,))


def backproject(
    capture: Capture,
    grid: VoxelGrid,
    *,
    method: str = DEFAULT_METHOD,
    window: str | np.ndarray = "rect",
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Volume:
    """Form the complex image of a capture by back-projection.

    V(v) = 1 / (n_tx n_rx n_freq) sum_{tx, rx, n} w_n s[tx, rx, n]
    exp(+j 2 pi f_n (|v - tx| + |v - rx|) / c)

    Parameters
    ----------
    capture : Capture
    grid : VoxelGrid
    method : "exact" or "range"
        "exact": the brute-force sum, any frequencies, at -80 dB of the image's RMS or better.
        "range": one range profile per pair, read by linear interpolation: some 20 times faster for
        large grids on a CPU, about -54 dB. Any frequencies too.
    window : "rect", "hann", "taylor", or array_like of shape (n_freq,)
        Weights w_n over frequency; see `frequency_weights`.
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    Volume
        complex64, shape (n_z, n_y, n_x).

    Raises
    ------
    ModelError
        Unknown method or window.
    DeviceError
        The device is missing, out of memory or fails. A volume larger than its memory is tiled.
    """
    checks.one_of("backproject: method", method, METHODS)
    checks.instance("backproject: capture", capture, Capture)
    checks.instance("backproject: grid", grid, VoxelGrid)
    weights = frequency_weights(window, capture.waveform.n_freq)
    opened = open_device(device)
    former = _Exact if method == "exact" else _Range
    planes = former(capture, grid, weights, opened).run(progress)
    data = np.empty(grid.shape, dtype=np.complex64)
    np.divide(planes[0], capture.data.size, out=data.real, casting="same_kind")
    np.divide(planes[1], capture.data.size, out=data.imag, casting="same_kind")
    data.flags.writeable = False
    meta = {
        "kind": "image",
        "method": method,
        "window": window if isinstance(window, str) else "custom",
        "device": dict(opened.describe()),
        "capture": dict(capture.meta),
    }
    return Volume(data, grid, meta)


class _Former:
    """What both methods share: axes and antennas on the device, tiles, the loop over them."""

    kernel_file = ""

    def __init__(
        self, capture: Capture, grid: VoxelGrid, weights: np.ndarray, device: Device
    ) -> None:
        self.capture, self.grid, self.device = capture, grid, device
        self.weighted = (capture.data * weights).astype(np.complex64)
        self.width = device.width
        self.n_x = -(-grid.counts[0] // self.width) * self.width
        self.k = capture.waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        chunk = min(CHUNK_RX, capture.array.n_rx)
        self.program = build(device, self.kernel_file, _BackprojectOptions(self.width, chunk))

    def run(self, progress: Progress | None) -> np.ndarray:
        """Return the unscaled sum, shape (2, n_z, n_y, n_x), float32."""
        nx, ny, nz = self.grid.counts
        out = np.empty((2, nz, ny, nx), dtype=np.float32)
        tiles = list(self.tiles())
        steps = self.steps_per_tile()
        with Buffers(self.device) as buffers:
            axes = buffers.upload(self._axes())
            largest = max(_length(t.z) * _length(t.y) for t in tiles)
            volume = buffers.empty(8 * largest * self.n_x)
            for i, tile in enumerate(tiles):
                shape = (2, _length(tile.z), _length(tile.y), self.n_x)
                buffers.write(volume, np.zeros(shape, np.float32))
                for j in self.add_all(buffers, axes, volume, tile):
                    if progress is not None:
                        progress(i * steps + j, len(tiles) * steps)
                part = buffers.read(volume, shape, np.float32)
                out[:, tile.z, tile.y] = part[..., :nx]
                if progress is not None:
                    progress((i + 1) * steps, len(tiles) * steps)
        return out

    def tiles(self) -> Iterator[_Tile]:
        raise NotImplementedError

    def steps_per_tile(self) -> int:
        raise NotImplementedError

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: _Tile) -> Iterator[int]:
        """Add everything to the tile; yield the number of steps done before each step."""
        raise NotImplementedError

    def _axes(self) -> np.ndarray:
        """Return voxel centres in the layout of ``kernels/common/voxel.h``."""
        grid = self.grid
        x_m = grid.origin_m[0] + grid.spacing_m[0] * np.arange(self.n_x)
        columns = [np.stack(hi_lo(x_m), axis=0).ravel()]
        columns += [np.stack(hi_lo(axis), axis=1).ravel() for axis in (grid.y_m, grid.z_m)]
        return np.concatenate(columns)

    def _whole_within(self, n_bytes: int) -> tuple[int, int]:
        """Return how many planes along z, and rows of one plane, fit `n_bytes` of volume."""
        _, ny, nz = self.grid.counts
        rows = max(1, n_bytes // (8 * self.n_x))
        return (min(nz, rows // ny), ny) if rows >= ny else (1, min(rows, ny))

    def _cut(self, n_z: int, n_y: int) -> Iterator[_Tile]:
        _, ny, nz = self.grid.counts
        for z in range(0, nz, n_z):
            for y in range(0, ny, n_y):
                yield _Tile(slice(z, min(z + n_z, nz)), slice(y, min(y + n_y, ny)))


class _Exact(_Former):
    """The brute-force sum, a block of frequencies and antennas per call."""

    kernel_file = "backproject_exact.cl"

    def tiles(self) -> Iterator[_Tile]:
        room = min(self.device.budget_bytes // 2, self.device.max_buffer_bytes)
        yield from self._cut(*self._whole_within(room))

    def steps_per_tile(self) -> int:
        return -(-len(self.k) // CHUNK_FREQ)

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: _Tile) -> Iterator[int]:
        array = self.capture.array
        for step, n0 in enumerate(range(0, len(self.k), CHUNK_FREQ)):
            yield step
            block = slice(n0, n0 + CHUNK_FREQ)
            cube = np.ascontiguousarray(self.weighted[:, :, block].transpose(2, 0, 1))
            k_hi, k_lo = (buffers.upload(half) for half in hi_lo(self.k[block]))
            for rx0 in range(0, array.n_rx, CHUNK_RX):
                for tx0 in range(0, array.n_tx, CHUNK_TX):
                    self._add(buffers, axes, volume, tile, cube, tx0, rx0, k_hi, k_lo)
            buffers.release(k_hi)
            buffers.release(k_lo)

    def _add(
        self,
        buffers: Buffers,
        axes: Any,
        volume: Any,
        tile: _Tile,
        cube: np.ndarray,
        tx0: int,
        rx0: int,
        k_hi: Any,
        k_lo: Any,
    ) -> None:
        u = np.uint32
        part = cube[:, tx0 : tx0 + CHUNK_TX, rx0 : rx0 + CHUNK_RX]
        pad = -part.shape[1] % 4
        part = np.pad(part, ((0, 0), (0, pad), (0, 0)))
        tx_m = np.pad(
            self.capture.array.tx_m[tx0 : tx0 + CHUNK_TX], ((0, pad), (0, 0)), mode="edge"
        )
        rx_m = self.capture.array.rx_m[rx0 : rx0 + CHUNK_RX]
        held = [buffers.upload(a) for a in (part, antenna_rows(tx_m), antenna_rows(rx_m))]
        n_z, n_y = _length(tile.z), _length(tile.y)
        self.program.launch(
            "backproject_exact", (self.n_x // self.width, n_y, n_z), u(self.n_x), u(n_y), u(n_z),
            u(tile.y.start), u(tile.z.start), u(self.grid.counts[1]), u(len(tx_m)), u(len(rx_m)),
            u(len(cube)), held[0], k_hi, k_lo, held[1], held[2], axes, volume,
        )  # fmt: skip
        for buffer in held:
            buffers.release(buffer)


class _Range(_Former):
    """Range profiles first, then one interpolated read per voxel and pair."""

    kernel_file = "backproject_range.cl"

    def __init__(
        self, capture: Capture, grid: VoxelGrid, weights: np.ndarray, device: Device
    ) -> None:
        super().__init__(capture, grid, weights, device)
        waveform = capture.waveform
        span_hz = waveform.span_hz if waveform.n_freq > 1 else waveform.center_hz
        self.bins_per_m = np.float32(OVERSAMPLING * span_hz / SPEED_OF_LIGHT_M_PER_S)
        self.carrier = waveform.center_hz / SPEED_OF_LIGHT_M_PER_S

    def tiles(self) -> Iterator[_Tile]:
        room = min(self.device.budget_bytes // 3, self.device.max_buffer_bytes)
        n_z, n_y = self._whole_within(room)
        # A smaller tile has shorter profiles; one transmitter's have to fit, more are better.
        row = 8 * min(CHUNK_RX, self.capture.array.n_rx) * self.capture.array.n_tx
        while row * max(b - a for a, b in self._spans(n_z, n_y)) > room and (n_z > 1 or n_y > 1):
            if n_z > 1:
                n_z = -(-n_z // 2)
            else:
                n_y = -(-n_y // 2)
        yield from self._cut(n_z, n_y)

    def _spans(self, n_z: int, n_y: int) -> Iterator[tuple[int, int]]:
        for tile in self._cut(n_z, n_y):
            yield self._bins(tile)

    def steps_per_tile(self) -> int:
        return 16

    def _bins(self, tile: _Tile) -> tuple[int, int]:
        """Return the first and the last bin (not included) that the tile's voxels read."""
        grid, array = self.grid, self.capture.array
        last_x = grid.origin_m[0] + grid.spacing_m[0] * (self.n_x - 1)
        low = np.array([grid.origin_m[0], grid.y_m[tile.y.start], grid.z_m[tile.z.start]])
        high = np.array([last_x, grid.y_m[tile.y.stop - 1], grid.z_m[tile.z.stop - 1]])
        near = far = 0.0
        for antennas in (array.tx_m, array.rx_m):
            inside = np.clip(antennas, low, high)
            near += float(np.linalg.norm(antennas - inside, axis=1).min())
            corner = np.maximum(np.abs(antennas - low), np.abs(antennas - high))
            far += float(np.linalg.norm(corner, axis=1).max())
        first = max(0, int(near * self.bins_per_m) - 1)
        n_bins = int(far * self.bins_per_m) + 3 - first
        return first, first + -(-n_bins // self.width) * self.width

    def add_all(self, buffers: Buffers, axes: Any, volume: Any, tile: _Tile) -> Iterator[int]:
        array = self.capture.array
        first, stop = self._bins(tile)
        n_bins, n_freq = stop - first, len(self.k)
        table = buffers.upload(self._table(first, stop))
        n_rx = min(CHUNK_RX, array.n_rx)
        per_tx = 8 * n_rx * (n_bins + n_freq)
        room = min(buffers.free_bytes // 2, self.device.max_buffer_bytes)
        n_tx = int(max(1, min(array.n_tx, room // per_tx)))
        cube = buffers.empty(8 * n_tx * n_rx * n_freq)
        profiles = buffers.empty(8 * n_tx * n_rx * n_bins)
        parts = [
            (slice(rx0, min(rx0 + CHUNK_RX, array.n_rx)), slice(tx0, min(tx0 + n_tx, array.n_tx)))
            for rx0 in range(0, array.n_rx, CHUNK_RX)
            for tx0 in range(0, array.n_tx, n_tx)
        ]
        for i, (rx, tx) in enumerate(parts):
            yield i * self.steps_per_tile() // len(parts)
            buffers.write(cube, self.weighted[tx, rx])
            n_pairs = _length(tx) * _length(rx)
            u = np.uint32
            self.program.launch(
                "range_profiles", (n_bins // self.width, n_pairs), u(n_pairs), u(n_freq),
                u(n_bins), cube, table, profiles,
            )  # fmt: skip
            held = [buffers.upload(antenna_rows(a)) for a in (array.tx_m[tx], array.rx_m[rx])]
            self._add(
                axes, volume, tile, (first, n_bins), profiles, held, (_length(tx), _length(rx))
            )
            for buffer in held:
                buffers.release(buffer)
        for buffer in (table, cube, profiles):
            buffers.release(buffer)

    def _add(
        self,
        axes: Any,
        volume: Any,
        tile: _Tile,
        bins: tuple[int, int],
        profiles: Any,
        antennas: list[Any],
        n_antennas: tuple[int, int],
    ) -> None:
        u = np.uint32
        n_z, n_y = _length(tile.z), _length(tile.y)
        k_hi, k_lo = hi_lo(np.float64(self.carrier))
        self.program.launch(
            "backproject_range", (self.n_x // self.width, n_y, n_z), u(self.n_x), u(n_y), u(n_z),
            u(tile.y.start), u(tile.z.start), u(self.grid.counts[1]), u(n_antennas[0]),
            u(n_antennas[1]), u(bins[1]), np.int32(bins[0]), self.bins_per_m, k_hi, k_lo, profiles,
            *antennas, axes, volume,
        )  # fmt: skip

    def _table(self, first: int, stop: int) -> np.ndarray:
        """Return cosine and sine of 2 pi (f_n - f_c) d / c, shape (n_freq, 2, n_bins), float32."""
        d_m = np.arange(first, stop) / np.float64(self.bins_per_m)
        turns = np.outer(self.k - self.carrier, d_m)
        angle = 2 * np.pi * (turns - np.round(turns))
        return np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)


def _length(part: slice) -> int:
    return part.stop - part.start
