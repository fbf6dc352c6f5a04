"""Phasor sum and whole simulation: the public functions `synthesize` and `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clradar.model import AntennaArray, Capture, Paths, Scene, TraceStatistics, Waveform, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device
from clradar.phasors.phasor_sum import CALL_PATHS, PhasorSum
from clradar.tracing.expected import Expectations, ExpectedTracer
from clradar.tracing.settings import (
    SimulationSettings,
    resolve_settings,
    simulated_meta,
    takes_settings,
)
from clradar.tracing.stochastic import Tracer


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


@takes_settings
def simulate(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    *,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Capture:
    """Trace and synthesize tile by tile; the paths are never held whole.

    The memory needed depends on neither the number of samples nor that of paths.

    Parameters
    ----------
    scene : Scene
    array : AntennaArray
    waveform : Waveform
    settings : SimulationSettings, optional
        The defaults if not given. With the stochastic estimator the result has the bits of
        ``synthesize(trace(...))``.
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) samples.
    **fields
        Fields of `SimulationSettings`, in place of those of `settings`.

    Returns
    -------
    Capture
        With the resolved settings, the scene's digest, the counts of rays and the device in `meta`.

    Raises
    ------
    ModelError
        An argument or setting is invalid.
    MeshError
        The scene has no face with area, or more samples than 2^31.
    DeviceError
        The device is missing, out of memory or fails.
    """
    checks.instance("simulate: scene", scene, Scene)
    checks.instance("simulate: array", array, AntennaArray)
    checks.instance("simulate: waveform", waveform, Waveform)
    resolved = resolve_settings(settings, **fields)
    opened = open_device(device)
    statistics = TraceStatistics(0, 0, 0, 0)
    n_paths = 0
    tracer_type = ExpectedTracer if resolved.estimator == "expected" else Tracer
    with (
        # The sum, which may be using the tracer's memory, ends first.
        tracer_type(scene, array, resolved, opened) as tracer,
        PhasorSum(array, waveform, opened, resolved.estimator == "expected") as total,
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
    meta = simulated_meta(scene, resolved, statistics, n_paths, opened)
    return Capture(data, array, waveform, meta)
