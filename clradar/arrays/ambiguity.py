"""What else the image of a point shows: grating lobes, and aliases in range."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from clradar.arrays.instruments import qar50
from clradar.arrays.lobes import (
    Lobe,
    are_one,
    climbed_lobes,
    maxima,
    response_over_directions,
    search_terms,
)
from clradar.arrays.point_spread import Clusters, clusters_of, response, thinned
from clradar.model import AntennaArray, Waveform
from clradar.model.range_profile import MIN_STEPS

GHOST_DB = -3.0
"""From this level on a lobe or an alias is as good as the echo itself."""

SEARCHED = 24
"""Antennas of a side, drawn, whose response tells where all of them may have a lobe."""

MOST_TERMS = 6e7
"""Antennas times directions of a search: 1 s. Larger arrays are not searched."""

FEWEST_PEAK = 0.3
"""Of the response of the drawn antennas at one frequency, on a lattice that may miss the top."""

CLIMBED = 3
"""Peaks that are climbed at all frequencies, strongest first."""

ALIAS_DB = -12.0
"""Of an alias that is worth a word: farther echoes are often stronger than what is near."""

ALIAS_CELLS, ALIAS_POINTS = 3.0, 49
"""An alias is looked for so many range cells to either side, since paths bend in the near field."""


def ghosts(
    array: Clusters,
    waveform: Waveform,
    at_m: np.ndarray,
    *among: Callable[[np.ndarray], np.ndarray],
) -> list[list[Lobe]]:
    """Return grating lobes of the image of a point from `GHOST_DB` on, strongest first: a list for
    each of `among`, which say of positions (n, 3), metres, at that distance, which count.
    """
    clusters = clusters_of(array)
    if len(clusters) == 1 and _needs_no_search(clusters[0], waveform):
        return [[] for _ in among]
    places_m, level, step = _candidates(clusters, waveform.center_hz, at_m)
    found = []
    for counts in among:
        rows = np.flatnonzero(~are_one(places_m, at_m, step) & counts(places_m))
        places = places_m[rows[np.argsort(-level[rows], kind="stable")]][:CLIMBED]
        found.append(climbed_lobes(clusters, thinned(waveform), at_m, places, step, GHOST_DB))
    return found


def _candidates(
    clusters: Sequence[AntennaArray], hz: float, at_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places where the response at one frequency has a maximum, their levels, step of the sines.

    Of few of the antennas. Nothing where even they would take long.
    """
    most = max(1, SEARCHED // len(clusters))
    few = [one.part(_drawn(one.n_tx, most), _drawn(one.n_rx, most)) for one in clusters]
    if search_terms(few, hz, 90.0) > MOST_TERMS:
        return np.empty((0, 3)), np.empty(0), np.zeros(2)
    directions, level, step = response_over_directions(few, hz, at_m, 90.0)
    peaks = maxima(level, FEWEST_PEAK)
    return float(np.linalg.norm(at_m)) * directions[peaks], level[peaks], step


def range_aliases(
    array: Clusters, waveform: Waveform, at_m: np.ndarray, periods: Sequence[int]
) -> list[tuple[np.ndarray, float]]:
    """Return where a point appears some unambiguous ranges farther (negative: nearer), and how
    bright.

    Positions, metres, and amplitudes relative to the point itself, `ALIAS_DB` or more: 1 far away,
    and less where the curvature of the wavefronts tells the range. Nothing behind the antennas, and
    for so few frequencies that they resolve no range.
    """
    if waveform.n_freq < MIN_STEPS or waveform.span_hz <= 0 or not len(periods):
        return []
    antennas_m = np.concatenate([side.antennas_m for a in clusters_of(array) for side in a.sides])
    middle_m = antennas_m.mean(axis=0)
    range_m = float(np.linalg.norm(at_m - middle_m))
    cells_m = ALIAS_CELLS * waveform.range_resolution_m * np.linspace(-1, 1, ALIAS_POINTS)
    there_m = range_m + np.array(periods)[:, None] * waveform.unambiguous_range_m + cells_m
    places_m = middle_m + there_m[:, :, None] * (at_m - middle_m) / range_m
    ahead = (there_m > 0) & (places_m[:, :, 2] > antennas_m[:, 2].max())
    level: np.ndarray = np.zeros(there_m.shape)
    level[ahead] = response(array, thinned(waveform), at_m, places_m[ahead])
    highest = level.argmax(axis=1)
    found = [
        (p[i], float(values[i])) for p, values, i in zip(places_m, level, highest, strict=True)
    ]
    return [alias for alias in found if alias[1] >= 10 ** (ALIAS_DB / 20)]


def _needs_no_search(array: AntennaArray, waveform: Waveform) -> bool:
    """Whether it is one pair, or the 94 x 94 imager up to its band: all lobes below -13 dB."""
    imager = float(waveform.frequencies_hz.max()) <= 82.5e9 and array.same_positions(qar50())
    return imager or array.n_tx * array.n_rx == 1


def _drawn(count: int, most: int) -> np.ndarray:
    return np.sort(np.random.default_rng(0).choice(count, min(count, most), replace=False))
