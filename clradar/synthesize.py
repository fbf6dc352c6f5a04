"""Host side of the phasor sum: paths to a capture, and the whole simulation streamed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.expected import ExpectedTracer
from clradar.model import AntennaArray, Capture, Paths, Scene, TraceStatistics, Waveform, checks
from clradar.normals import CREASE_DEG
from clradar.opencl import Buffers, Device, build, open_device
from clradar.packing import hi_lo
from clradar.trace import RECEPTION_RADIUS_M, Progress, Tracer, TraceSettings, resolve_settings

CALL_PATHS = 2**20
"""Paths per kernel call; a smaller device makes it smaller. No result depends on it."""


@dataclass(frozen=True, slots=True)
class _SynthesizeOptions:
    width: int


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
        In any order; a stable sort by pair comes first.
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
    pair = paths.pair
    if len(pair) and (np.diff(pair) < 0).any():
        order = np.argsort(pair, kind="stable")
    else:
        order = np.arange(len(pair))
    rows = np.zeros((len(pair), 4), dtype=np.float32)
    rows[:, 0], rows[:, 1] = hi_lo(paths.length_m[order])
    rows[:, 2] = paths.amplitude[order]
    with PhasorSum(array, waveform, opened) as total:
        total.add(pair[order], rows)
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
        PhasorSum(array, waveform, opened) as total,
        tracer_type(scene, array, settings, opened) as tracer,
    ):
        for tile in tracer.tiles(progress):
            total.add(tile.pair, tile.path)
            statistics = statistics + tile.statistics
            n_paths += len(tile.pair)
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


class PhasorSum:
    """The running sum of one capture on a device.

    A context manager. Where the whole sum exceeds the device's memory, it is formed for a part of
    the frequencies at a time, and the parts stay on the host between calls.
    """

    def __init__(self, array: AntennaArray, waveform: Waveform, device: Device) -> None:
        self._array, self._device = array, device
        self._n_pairs = array.n_tx * array.n_rx
        self._n_freq = waveform.n_freq
        self._width = device.width
        k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        padded = -(-len(k) // self._width) * self._width
        self._k = np.pad(k, (0, padded - len(k)), mode="edge")
        self._buffers = Buffers(device)
        self._program = build(device, "synthesize.cl", _SynthesizeOptions(self._width))

    def __enter__(self) -> PhasorSum:
        column = 16 * self._n_pairs  # state of one frequency, bytes
        room = min(self._device.budget_bytes // 3, self._device.max_buffer_bytes)
        per_slice = max(1, room // (column * self._width)) * self._width
        self._slices = [
            slice(at, min(at + per_slice, len(self._k))) for at in range(0, len(self._k), per_slice)
        ]
        try:
            self._starts = self._buffers.empty(4 * (self._n_pairs + 1))
            self._k_parts = []
            for part in self._slices:
                self._k_parts.append([self._buffers.upload(half) for half in hi_lo(self._k[part])])
            widest = self._slices[0].stop
            self._state = self._buffers.zeros(column * widest)
            self._host = None
            if len(self._slices) > 1:
                self._host = [
                    np.zeros((4, self._n_pairs, s.stop - s.start), np.float32) for s in self._slices
                ]
            left = min(self._buffers.free_bytes // 4, self._device.max_buffer_bytes)
            self._call_paths = int(max(1, min(CALL_PATHS, left // 16)))
            self._rows = self._buffers.empty(16 * self._call_paths)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        self._buffers.__exit__(None, None, None)

    def add(self, pair: np.ndarray, rows: np.ndarray) -> None:
        """Add paths.

        Parameters
        ----------
        pair : ndarray, shape (n,), integer, ascending
        rows : ndarray, shape (n, 4), float32
            Length as hi + lo, metres; amplitude; unused.
        """
        for at in range(0, len(pair), self._call_paths):
            part = slice(at, at + self._call_paths)
            edges = np.searchsorted(pair[part], np.arange(self._n_pairs + 1))
            self._buffers.write(self._starts, edges.astype(np.uint32))
            self._buffers.write(self._rows, rows[part])
            for i, columns in enumerate(self._slices):
                self._add_to_slice(i, columns.stop - columns.start)

    def _add_to_slice(self, i: int, n_columns: int) -> None:
        if self._host is not None:
            self._buffers.write(self._state, self._host[i])
        self._program.launch(
            "sum_phasors",
            (n_columns // self._width, self._n_pairs),
            np.uint32(self._n_pairs),
            np.uint32(n_columns),
            self._starts,
            self._rows,
            *self._k_parts[i],
            self._state,
        )
        if self._host is not None:
            self._host[i] = self._buffers.read(self._state, self._host[i].shape, np.float32)

    def result(self) -> np.ndarray:
        """Return the sum, shape (n_tx, n_rx, n_freq), complex64, read-only."""
        states = self._host
        if states is None:
            states = [self._buffers.read(self._state, (4, self._n_pairs, len(self._k)), np.float32)]
        data = np.empty((self._n_pairs, len(self._k)), dtype=np.complex64)
        for columns, (re, im, re_lost, im_lost) in zip(self._slices, states, strict=True):
            data.real[:, columns] = re + re_lost
            data.imag[:, columns] = im + im_lost
        shape = (self._array.n_tx, self._array.n_rx, self._n_freq)
        out = np.ascontiguousarray(data[:, : self._n_freq]).reshape(shape)
        out.flags.writeable = False
        return out
