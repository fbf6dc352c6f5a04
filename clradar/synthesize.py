"""From path lengths to frequency samples: the public function `synthesize`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clradar.model import AntennaArray, Capture, Paths, Waveform, checks
from clradar.opencl import Device, open_device
from clradar.phasors.phasor_sum import CALL_PATHS, PhasorSum


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
        Without patterns.
    waveform : Waveform
    device
        See `clradar.open_device`.
    meta : mapping, optional
        Becomes the capture's `meta`, with the device added.

    Returns
    -------
    Capture
        The phase of each path is exact to 1e-6 rad.

    Examples
    --------
    Over 1 GHz the phase of a path of 75 mm falls by a quarter of a cycle.

    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.003, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 73e9, 2)
    >>> paths = clradar.Paths([0], [0], [0.075], [1.0], [1], n_tx=1, n_rx=1)
    >>> first, last = clradar.synthesize(paths, array, waveform).data[0, 0]
    >>> print(f"{np.degrees(np.angle(last / first)):.0f} degrees")
    -90 degrees
    """
    checks.instance("synthesize: paths", paths, Paths)
    checks.instance("synthesize: array", array, AntennaArray)
    checks.instance("synthesize: waveform", waveform, Waveform)
    array.refuse_patterns("synthesize")
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
            total.add(pair, length_m, amplitude)
        data = total.result()
    return Capture(
        array.with_gains(data), array, waveform, {**(meta or {}), "device": opened.describe()}
    )
