"""What else the image of a point shows: grating lobes, and aliases in range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clradar.arrays.instruments import qar50
from clradar.arrays.lobes import Lobe, climbed_lobe, response_over_directions, search_terms
from clradar.arrays.point_spread import response
from clradar.model import AntennaArray, Waveform
from clradar.model.range_profile import MIN_STEPS

GHOST_DB = -3.0
"""From this level on a lobe or an alias is as good as the echo itself."""

SEARCHED = 24
"""Antennas of a side, drawn, whose response tells where all of them may have a lobe."""

MOST_TERMS = 2e7
"""Antennas times directions of a search: 2 s. Larger arrays are not searched."""

FEWEST_PEAK = 0.3
"""Of the response of the drawn antennas at one frequency, on a lattice that may miss the top."""

CLIMBED = 3
"""Peaks that are climbed at all frequencies, strongest first."""

FREQUENCIES = 32

ALIAS_DB = -12.0
"""Of an alias that is worth a word: farther echoes are often stronger than what is near."""

ALIAS_CELLS, ALIAS_POINTS = 3.0, 49
"""An alias is looked for so many range cells to either side, since paths bend in the near field."""


def ghosts(
    array: AntennaArray,
    waveform: Waveform,
    at_m: np.ndarray,
    *among: Callable[[np.ndarray], np.ndarray],
) -> list[list[Lobe]]:
    """Return grating lobes of the image of a point, those from `GHOST_DB` on, strongest first.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    at_m : ndarray, shape (3,), metres
        In front of the antennas.
    *among : callable
        From positions at the distance of the point, shape (n, 3), to those that count, shape (n,).

    Returns
    -------
    list of list of Lobe
        For each of `among` the strongest of its own.
    """
    if _is_imager(array, waveform) or array.n_tx * array.n_rx == 1:
        return [[] for _ in among]
    distance_m = float(np.linalg.norm(at_m))
    few = array.part(_drawn(array.n_tx), _drawn(array.n_rx))
    if search_terms(few, waveform.center_hz, 90.0) > MOST_TERMS:
        return [[] for _ in among]
    directions, level, step = response_over_directions(few, waveform.center_hz, at_m, 90.0)
    rows = np.flatnonzero((_peaks(level) & (level > FEWEST_PEAK)).ravel())
    places_m = distance_m * directions.reshape(-1, 3)[rows]
    own = (np.abs(places_m - at_m)[:, :2] <= 2 * distance_m * step + 1e-9).all(axis=1)
    some_hz, found = _some(waveform), []
    for counts in among:
        chosen = np.flatnonzero(~own & counts(places_m))
        chosen = chosen[np.argsort(-level.ravel()[rows[chosen]])][:CLIMBED]
        climbed = [climbed_lobe(array, some_hz, at_m, places_m[i], step) for i in chosen]
        away = (lobe for lobe in climbed if _is_away(lobe, at_m, step))
        strong = (lobe for lobe in away if lobe.level_db >= GHOST_DB)
        found.append(sorted(strong, key=lambda lobe: -lobe.level_db))
    return found


def range_alias(
    array: AntennaArray, waveform: Waveform, at_m: np.ndarray, periods: int
) -> tuple[np.ndarray, float] | None:
    """Return where a point appears so many unambiguous ranges farther, and how bright.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    at_m : ndarray, shape (3,), metres
    periods : int
        Negative: nearer.

    Returns
    -------
    (ndarray, float) or None
        Position, metres, and amplitude relative to the point itself: 1 far away, and less where the
        curvature of the wavefronts tells the range. None behind the antennas, and for so few
        frequencies that they resolve no range.
    """
    if waveform.n_freq < MIN_STEPS or waveform.span_hz <= 0:
        return None
    antennas_m = np.concatenate([array.tx_m, array.rx_m])
    middle_m = antennas_m.mean(axis=0)
    range_m = float(np.linalg.norm(at_m - middle_m))
    there_m = range_m + periods * waveform.unambiguous_range_m
    cells_m = ALIAS_CELLS * waveform.range_resolution_m * np.linspace(-1, 1, ALIAS_POINTS)
    places_m = middle_m + (there_m + cells_m)[:, None] * (at_m - middle_m) / range_m
    ahead = (there_m + cells_m > 0) & (places_m[:, 2] > antennas_m[:, 2].max())
    if not ahead.any():
        return None
    level = response(array, _some(waveform), at_m, places_m[ahead])
    return places_m[ahead][level.argmax()], float(level.max())


def _is_imager(array: AntennaArray, waveform: Waveform) -> bool:
    """Whether it is the 94 x 94 imager up to its band, whose lobes are below -13 dB."""
    return array.same_positions(qar50()) and float(waveform.frequencies_hz.max()) <= 82.5e9


def _drawn(count: int) -> np.ndarray:
    if count <= SEARCHED:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, SEARCHED, replace=False))


def _some(waveform: Waveform) -> np.ndarray:
    count = min(waveform.n_freq, FREQUENCIES)
    rows = np.linspace(0, waveform.n_freq - 1, count).round().astype(int)
    return waveform.frequencies_hz[rows]


def _peaks(level: np.ndarray) -> np.ndarray:
    from scipy.ndimage import maximum_filter

    return np.asarray(level == maximum_filter(level, size=3))


def _is_away(lobe: Lobe, at_m: np.ndarray, step: np.ndarray) -> bool:
    away = np.abs(lobe.position_m / np.linalg.norm(lobe.position_m) - at_m / np.linalg.norm(at_m))
    return bool((away[:2] > 2 * step + 1e-9).any())
