"""Response of a focused array: the normalised back-projection of one point's echoes.

The image of a point at p, at v: the sum over all pairs and frequencies of
exp(j k (d(v) - d(p))), d = |. - tx| + |. - rx|, divided by their number. Over the pairs of an array
it is the product of the sum over Tx and the sum over Rx; of several arrays (clusters, whose Tx are
measured with their own Rx only) it is the sum of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.antenna_side import AntennaSide

Clusters: TypeAlias = AntennaArray | Sequence[AntennaArray]
"""One array, or several of which one image is formed."""

FREQUENCIES = 32  # of a band, at most; the range that they leave unambiguous covers the lobes
TERMS_AT_ONCE = 100_000  # antennas times points: what a core's cache holds


def clusters_of(array: Clusters) -> tuple[AntennaArray, ...]:
    """The arrays whose pairs an image is the sum over."""
    if isinstance(array, AntennaArray):
        return (array,)
    return tuple(checks.several("array", array))


def thinned(waveform: Waveform) -> np.ndarray:
    """At most `FREQUENCIES` of a band, over all of it."""
    count = min(waveform.n_freq, FREQUENCIES)
    rows = np.linspace(0, waveform.n_freq - 1, count).round().astype(int)
    return waveform.frequencies_hz[rows]


def response(
    array: Clusters, frequencies_hz: np.ndarray, focus_m: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """Magnitude of the response at points (n, 3), shape (n,): 1 at the focus.

    To 1e-5, as phasors are complex64. Patterns and gains weigh the antennas towards each point, as
    echoes from there would be.
    """
    total = np.zeros((len(points_m), len(frequencies_hz)), dtype=np.complex128)
    top = 0.0j
    for one in clusters_of(array):
        own, own_top = np.ones_like(total), 1.0 + 0.0j
        for side in one.sides:
            at_focus_m, weight = side.towards(focus_m[None])
            own_top *= complex(weight.sum())
            step = max(1, TERMS_AT_ONCE // len(side.antennas_m))
            for first in range(0, len(points_m), step):
                rows = slice(first, first + step)
                own[rows] *= _side_sums(side, frequencies_hz, at_focus_m, points_m[rows])
        total += own
        top += own_top
    return np.abs((total / top).mean(axis=1))


def _side_sums(
    side: AntennaSide, frequencies_hz: np.ndarray, at_focus_m: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """Sum over the antennas of one side, shape (n, n_freq): from frequency to frequency each
    phasor is turned, as few steps have few different phasors."""
    away_m, weight = side.towards(points_m)
    away_m -= at_focus_m
    turned = _phasors(away_m, frequencies_hz[0])
    if side.pattern is not None or side.gain is not None:
        turned *= weight.astype(np.complex64)
    sums = [turned.sum(axis=1)]
    by_step: dict[int, np.ndarray] = {}
    for step_hz in np.diff(frequencies_hz):
        key = round(step_hz / (1e-9 * frequencies_hz[-1]))  # steps that differ by less are one
        if key not in by_step:
            by_step[key] = _phasors(away_m, step_hz)
        turned *= by_step[key]
        sums.append(turned.sum(axis=1))
    return np.stack(sums, axis=1)


def _phasors(length_m: np.ndarray, frequency_hz: float) -> np.ndarray:
    """exp(j 2 pi f l / c), complex64."""
    turns = length_m * (frequency_hz / SPEED_OF_LIGHT_M_PER_S)
    turns -= np.rint(turns)
    angle = (2 * np.pi * turns).astype(np.float32)
    phasors = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=phasors.real)
    np.sin(angle, out=phasors.imag)
    return phasors


def width_m(
    array: Clusters,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    axis: np.ndarray,
    longest_m: float,
) -> float:
    """Full width of the main lobe at -3 dB along a unit vector, metres; infinite beyond twice
    `longest_m`.
    """
    from scipy.optimize import brentq

    def above(steps_m: Any) -> np.ndarray:
        line_m = focus_m + np.reshape(steps_m, (-1, 1)) * axis
        return response(array, frequencies_hz, focus_m, line_m) - np.sqrt(0.5)

    total_m = 0.0
    for end_m in (-longest_m, longest_m):
        steps_m = end_m * np.concatenate([[0.0], np.geomspace(1e-5, 1.0, 60)])
        below = np.flatnonzero(above(steps_m) < 0)
        if not len(below):
            return float("inf")
        total_m += abs(brentq(lambda step_m: above(step_m)[0], *steps_m[below[0] - 1 :][:2]))
    return total_m
