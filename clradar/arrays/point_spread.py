"""Response of a focused array: the normalised back-projection of one point's echoes.

The image of a point at p, at v: the sum over all pairs and frequencies of
exp(j k (d(v) - d(p))), d = |. - tx| + |. - rx|, divided by their number. Over pairs it is the
product of the sum over Tx and the sum over Rx.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray

TERMS_AT_ONCE = 4_000_000


def wavenumbers(frequencies_hz: np.ndarray) -> np.ndarray:
    """k = 2 pi f / c, radians per metre."""
    return 2 * np.pi * np.asarray(frequencies_hz) / SPEED_OF_LIGHT_M_PER_S


def pair_sums(
    array: AntennaArray, frequencies_hz: np.ndarray, focus_m: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """The response per frequency, before the sum over frequencies.

    Parameters
    ----------
    array : AntennaArray
        Its patterns and gains weigh the antennas towards each point, as echoes from there would
        be.
    frequencies_hz : ndarray, shape (n_freq,)
    focus_m : ndarray, shape (3,), metres
        Where the point is, whose response is 1.
    points_m : ndarray, shape (n, 3), metres

    Returns
    -------
    ndarray, shape (n, n_freq), complex128
    """
    k = wavenumbers(frequencies_hz)
    found = np.ones((len(points_m), len(k)), dtype=np.complex128)
    for side in array.sides:
        at_focus_m, weight = side.towards(focus_m[None])
        top = weight.sum()
        for rows in _chunks(len(points_m), len(side.antennas_m) * len(k)):
            away_m, weight = side.towards(points_m[rows])
            phase = (away_m - at_focus_m)[:, :, None] * k
            found[rows] *= (weight[:, :, None] * np.exp(1j * phase)).sum(axis=1) / top
    return found


def response(
    array: AntennaArray, frequencies_hz: np.ndarray, focus_m: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """Magnitude of the response at points, shape (n,); 1 at the focus."""
    return np.abs(pair_sums(array, frequencies_hz, focus_m, points_m).mean(axis=1))


def width_m(
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    axis: np.ndarray,
    longest_m: float,
) -> float:
    """Full width of the main lobe at -3 dB along a direction, metres; infinite beyond `longest_m`.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Of length 1.
    longest_m : float, metres
        Half of the longest width that is looked for.
    """
    ends = []
    steps_m = longest_m * np.geomspace(1e-5, 1.0, 400)
    for sign in (-1.0, 1.0):
        line_m = focus_m + sign * steps_m[:, None] * axis
        level = response(array, frequencies_hz, focus_m, line_m)
        below = np.flatnonzero(level < np.sqrt(0.5))
        if not len(below):
            return float("inf")
        first = below[0]
        before = (0.0, 1.0) if first == 0 else (steps_m[first - 1], level[first - 1])
        share = (before[1] - np.sqrt(0.5)) / (before[1] - level[first])
        ends.append(before[0] + share * (steps_m[first] - before[0]))
    return float(sum(ends))


def _chunks(n: int, terms_each: int) -> Iterator[slice]:
    step = max(1, TERMS_AT_ONCE // terms_each)
    yield from (slice(first, first + step) for first in range(0, n, step))
