"""Host side of the phasor sum: paths to a capture, and the whole simulation streamed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clradar.expected import Expectations, ExpectedTracer
from clradar.length_blocks import MOMENTS, length_blocks
from clradar.model import AntennaArray, Capture, Paths, Scene, TraceStatistics, Waveform, checks
from clradar.normals import CREASE_DEG
from clradar.opencl import Buffers, Device, build, open_device
from clradar.packing import hi_lo
from clradar.trace import RECEPTION_RADIUS_M, Progress, Tracer, TraceSettings, resolve_settings

CALL_PATHS = 2**18
"""Paths per kernel call; a smaller device makes it smaller. No result depends on it."""

PATH_BYTES = 8 + 4
"""Of a path on the device: float64 length, float32 amplitude."""

GROUP_PAIRS = 16
"""Pairs per item of the last kernel with eight lanes. The kernel's number."""


@dataclass(frozen=True, slots=True)
class _SynthesizeOptions:
    width: int
    in_parts: bool


def synthesize(
    paths: Paths,
    array: AntennaArray,
    waveform: Waveform,
    *,
    device: Device | str | None = None,
    meta: Mapping[str, Any] | None = None,
) -> Capture:
    """Sum the phasors of all paths: s = sum_i a_i exp(-j 2 pi f d_i / c).

    Parameters
    ----------
    paths : Paths
        In any order; the sum of a pair is formed in the order of its paths.
    array : AntennaArray
    waveform : Waveform
        Any ascending list of frequencies.
    device : Device, str or None
        See `clradar.open_device`.
    meta : mapping, optional
        Becomes the capture's `meta`, with the device added.

    Returns
    -------
    Capture
        complex64, shape (n_tx, n_rx, n_freq). The phase of each path is exact to 1e-6 rad.

    Raises
    ------
    ModelError
        `paths` and `array` differ in size.
    DeviceError
        The device is missing, out of memory or fails.
    """
    checks.instance("synthesize: paths", paths, Paths)
    checks.instance("synthesize: array", array, AntennaArray)
    checks.instance("synthesize: waveform", waveform, Waveform)
    if (paths.n_tx, paths.n_rx) != (array.n_tx, array.n_rx):
        checks.fail(
            "synthesize: paths",
            f"paths of a {array.n_tx} x {array.n_rx} array",
            f"{paths.n_tx} x {paths.n_rx}",
        )
    opened = open_device(device)
    tx, rx = paths.tx.view(np.uint32), paths.rx.view(np.uint32)
    with PhasorSum(array, waveform, opened) as total:
        for at in range(0, len(paths), CALL_PATHS):
            part = slice(at, at + CALL_PATHS)
            pair = tx[part] * np.uint32(paths.n_rx) + rx[part]
            length_m, amplitude = paths.length_m[part], paths.amplitude[part]
            if (pair[1:] < pair[:-1]).any():
                order = np.argsort(pair, kind="stable")
                pair, length_m, amplitude = pair[order], length_m[order], amplitude[order]
            total.add_columns(pair, length_m, amplitude)
        data = total.result()
    return Capture(data, array, waveform, {**(meta or {}), "device": dict(opened.describe())})


def simulate(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    *,
    samples_per_mm2: float | None = None,
    rays_per_face: int | None = None,
    rays_per_sample: int | None = None,
    reception_radius_m: float = RECEPTION_RADIUS_M,
    max_bounces: int = 1,
    normals: str = "smooth",
    crease_deg: float = CREASE_DEG,
    amplitude: str = "unit",
    pattern_exponent: float = 0.0,
    seed: int = 0,
    estimator: str = "stochastic",
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Trace and synthesize tile by tile; the paths are never held whole.

    The other arguments are those of `clradar.trace` and `clradar.synthesize`. The memory needed
    depends on neither the number of samples nor that of paths.

    Parameters
    ----------
    estimator : "stochastic" or "expected"
        With "stochastic" the result has the bits of ``synthesize(trace(...))``. "expected" is its
        mean over the random outgoing directions, for the same samples: each of them, Tx and Rx
        adds one path whose amplitude is `rays_per_sample` times the probability that the outgoing
        ray enters the Rx sphere. There is no shot noise, so fewer samples do: unless a density or
        `rays_per_face` is given it takes 1 per mm^2 and ten times the rays per sample, which keeps
        the scale. It stops at the first bounce, and an Rx counts as hidden if the centre of its
        sphere is. See ``docs/estimators.md``.

    Returns
    -------
    Capture
        With the resolved settings, the scene's digest, the counts of rays and the device in `meta`.
    """
    checks.instance("simulate: scene", scene, Scene)
    checks.instance("simulate: array", array, AntennaArray)
    checks.instance("simulate: waveform", waveform, Waveform)
    settings = resolve_settings(
        samples_per_mm2=samples_per_mm2,
        rays_per_face=rays_per_face,
        rays_per_sample=rays_per_sample,
        reception_radius_m=reception_radius_m,
        max_bounces=max_bounces,
        normals=normals,
        crease_deg=crease_deg,
        amplitude=amplitude,
        pattern_exponent=pattern_exponent,
        seed=seed,
        estimator=estimator,
    )
    opened = open_device(device)
    statistics = TraceStatistics(0, 0, 0, 0)
    n_paths = 0
    tracer_type = ExpectedTracer if settings.estimator == "expected" else Tracer
    with (
        # The sum, which may be using the tracer's memory, ends first.
        tracer_type(scene, array, settings, opened) as tracer,
        PhasorSum(array, waveform, opened, settings.estimator == "expected") as total,
    ):
        for tile in tracer.tiles(progress):
            if isinstance(tile, Expectations):
                total.add_on_device(tile.start, tile.length, tile.amplitude, tile.longest_m)
                n_paths += int(tile.start[-1])
            else:
                total.add(tile.pair, tile.path)
                n_paths += len(tile.pair)
            statistics = statistics + tile.statistics
        data = total.result()
    meta = simulated_meta(scene, settings, statistics, n_paths, opened)
    return Capture(data, array, waveform, meta)


def simulated_meta(
    scene: Scene, settings: TraceSettings, statistics: TraceStatistics, n_paths: int, device: Device
) -> dict[str, Any]:
    """Return what a simulated capture carries about how it came to be."""
    return {
        "kind": "simulated",
        "settings": asdict(settings),
        "scene": {
            "sha256": scene.digest(),
            "faces": scene.n_faces,
            "parts": list(scene.part_names),
            "alpha_min": float(np.min(scene.alpha)),
            "alpha_max": float(np.max(scene.alpha)),
        },
        "rays": {
            **asdict(statistics),
            "absorbed_share": statistics.absorbed_share,
            "paths": n_paths,
        },
        "device": dict(device.describe()),
    }


@dataclass(slots=True, eq=False)
class _Slice:
    """A range of pairs whose state is on the device at a time, with the state while it is not."""

    first: int
    stop: int
    state: list[np.ndarray] | None


class PhasorSum:
    """The running sum of one capture on a device.

    A context manager. Where the state of all pairs exceeds the device's memory, that of a part of
    them is there at a time, and the parts stay on the host between calls. `on_device`: whether
    paths come from a kernel (`add_on_device`) or from the host (`add`, `add_columns`).
    """

    def __init__(
        self, array: AntennaArray, waveform: Waveform, device: Device, on_device: bool = False
    ) -> None:
        self._array, self._device, self._waveform = array, device, waveform
        self._n_pairs = array.n_tx * array.n_rx
        self._width = device.width
        self._n_columns = -(-waveform.n_freq // self._width) * self._width
        self._blocks = length_blocks(waveform)
        self._buffers = Buffers(device)
        self._program = build(device, "synthesize.cl", _SynthesizeOptions(self._width, on_device))
        self._running: list[Any] = []

    def __enter__(self) -> PhasorSum:
        try:
            self._prepare()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        try:
            self._finish_call()
        finally:
            self._buffers.__exit__(None, None, None)

    def _prepare(self) -> None:
        n_slots, n_columns = self._blocks.n_slots, self._n_columns
        moments, total, out = 16 * MOMENTS * n_slots, 16 * n_columns, 8 * n_columns
        per_pair = 4 * (n_slots + 1) + moments + total + out
        room = min(
            self._device.budget_bytes // 3 // per_pair,
            self._device.max_buffer_bytes // max(moments, total),
        )
        count = max(1, min(self._n_pairs, room))
        firsts = range(0, self._n_pairs, count)
        self._slices = [_Slice(at, min(at + count, self._n_pairs), None) for at in firsts]
        fill = ((0, 0), (0, n_columns - self._waveform.n_freq))
        self._table = self._buffers.upload(np.pad(self._blocks.table, fill, mode="edge"))
        self._tag = self._buffers.zeros(4 * (n_slots + 1) * count)
        self._moments = self._buffers.empty(moments * count)
        self._sum = self._buffers.empty(total * count)
        self._out = self._buffers.empty(out * count)
        # A call's columns come while those of the call before are in use.
        left = min(self._buffers.free_bytes - 8 * (count + 1), self._device.max_buffer_bytes)
        self._call_paths = int(max(1, min(CALL_PATHS, left // 2 // PATH_BYTES)))

    def add(self, pair: np.ndarray, rows: np.ndarray) -> None:
        """Add paths as the tracer has them.

        Parameters
        ----------
        pair : ndarray, shape (n,), integer, ascending
        rows : ndarray, shape (n, 4), float32
            Length as hi + lo, metres; amplitude; unused.
        """
        length_m = rows[:, 0].astype(np.float64) + rows[:, 1]
        self.add_columns(pair, length_m, np.ascontiguousarray(rows[:, 2]))

    def add_columns(self, pair: np.ndarray, length_m: np.ndarray, amplitude: np.ndarray) -> None:
        """Add paths.

        Parameters
        ----------
        pair : ndarray, shape (n,), integer, ascending
        length_m : ndarray, shape (n,), float64, metres
        amplitude : ndarray, shape (n,), float32

        Raises
        ------
        ModelError
            A path of more than 2^21 wavelengths.
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
        if len(pair) < self._width:  # the kernel reads as many as it has lanes
            fill = (0, self._width - len(pair))
            length_m, amplitude = np.pad(length_m, fill), np.pad(amplitude, fill)
        columns = [self._buffers.borrow(length_m), self._buffers.borrow(amplitude)]
        first, stop = int(pair[0]), int(pair[-1]) + 1
        starts = np.searchsorted(pair, np.arange(first, stop + 1, dtype=pair.dtype))
        self._start(starts.astype(np.uint32), first, len(length_m), columns, columns)

    def add_on_device(
        self, start: np.ndarray, length: Any, amplitude: Any, longest_m: float
    ) -> None:
        """Add paths that a kernel wrote; the commands that follow may overwrite them.

        Parameters
        ----------
        start : ndarray, shape (n_pairs + 1,), uint32
            The first path of each pair, and how many there are.
        length : Buffer
            float (n, 2): hi + lo, metres; like `amplitude` of no fewer than eight paths.
        amplitude : Buffer
            float (n)
        longest_m : float, metres
            No path is longer.

        Raises
        ------
        ModelError
            More than 2^21 wavelengths.
        """
        self._check_length(longest_m)
        total = max(int(start[-1]), self._width)
        self._start(start, 0, total, [length, amplitude], [])

    def _start(
        self, starts: np.ndarray, at: int, total: int, columns: list[Any], borrowed: list[Any]
    ) -> None:
        """Add paths of successive pairs from `at` on; `borrowed` is let go of when that is done."""
        for part in self._slices:
            first, stop = max(part.first, at), min(part.stop, at + len(starts) - 1)
            if first >= stop:
                continue
            start = self._buffers.borrow(starts[first - at : stop - at + 1])
            self._fetch(part)
            wait = self._program.start(
                "add_paths",
                (stop - first,),
                np.uint32(part.stop - part.first),
                np.uint32(first - part.first),
                np.uint32(total),
                np.uint32(self._n_columns),
                np.uint32(self._blocks.n_slots),
                np.float32(self._blocks.block_m),
                np.float32(self._blocks.per_half_block),
                *hi_lo(self._blocks.wavenumber),
                start,
                *columns,
                self._table,
                self._tag,
                self._moments,
                self._sum,
            )
            if len(self._slices) == 1:
                # While it runs the host can prepare the next call.
                self._finish_call()
                self._running = [wait, *borrowed, start]
                return
            wait()
            self._store(part)
            self._buffers.release(start)
        for column in borrowed:
            self._buffers.release(column)

    def _finish_call(self) -> None:
        """Wait for the call that is running, if any, and let go of what it borrowed."""
        if self._running:
            wait, *borrowed = self._running
            self._running = []
            wait()
            for buffer in borrowed:
                self._buffers.release(buffer)

    def _state(self, n_pairs: int) -> list[tuple[Any, tuple[int, ...], Any]]:
        """Return what is kept between calls: buffers with shapes and dtypes."""
        n_slots = self._blocks.n_slots
        return [
            (self._tag, (n_slots + 1, n_pairs), np.int32),
            (self._moments, (n_slots, n_pairs, 4, MOMENTS), np.float32),
            (self._sum, (n_pairs, 4, self._n_columns), np.float32),
        ]

    def _fetch(self, part: _Slice) -> None:
        """Bring a slice's state to the device; with one slice only it stays there."""
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

    def result(self) -> np.ndarray:
        """Return the sum, shape (n_tx, n_rx, n_freq), complex64, read-only."""
        n_freq, parts = self._waveform.n_freq, []
        self._finish_call()
        columns, pairs = (1, 1) if self._width == 1 else (self._n_columns, GROUP_PAIRS)
        for part in self._slices:
            count = part.stop - part.first
            self._fetch(part)
            self._program.launch(
                "finish",
                (self._n_columns // columns, -(-count // pairs)),
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
            )
            out = self._buffers.read(self._out, (count, self._n_columns), np.complex64)
            parts.append(np.ascontiguousarray(out[:, :n_freq]) if n_freq < self._n_columns else out)
        data = parts[0] if len(parts) == 1 else np.concatenate(parts)
        data.flags.writeable = False
        return data.reshape(self._array.n_tx, self._array.n_rx, n_freq)
