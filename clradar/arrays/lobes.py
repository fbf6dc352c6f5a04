"""Lobes and aliases: what else a focused array shows of a point, or takes for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.arrays.instruments import qar50
from clradar.arrays.point_spread import Clusters, clusters_of, pair_sums, response, thinned
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Waveform, checks
from clradar.model.range_profile import MIN_STEPS

GRATING_DB = -6.0  # from this level on lobes can be taken for the target: they are grating lobes
MOST_TERMS = 500_000_000  # antennas times directions of a search: some 10 s
CELLS, SHIFTS = 4.0, 256
"""Range cells to either side of the focus in which the echoes of a lobe may be brightest, and the
number of ranges there at which they are added up over the band."""

CLIMBED = (0.5, 0.5, 0.5, 0.5, 0.5, 0.2, 0.05, 0.01)  # steps of a climb, of those of the lattice
GHOST_DB = -3.0  # from this level on a lobe or an alias is as good as the echo itself
SEARCHED = 24  # antennas of a side, drawn, whose response tells where all of them may have a lobe
MOST_GHOST_TERMS = 6e7  # antennas times directions: 1 s; larger arrays are not searched
FEWEST_PEAK = 0.3  # of the response of drawn antennas, on a lattice that may miss the top
MOST_GHOSTS = 3  # peaks that are climbed at all frequencies, strongest first
ALIAS_DB = -12.0  # of an alias that is worth a word: farther echoes are often stronger
ALIAS_CELLS, ALIAS_POINTS = 3.0, 49
"""An alias is looked for so many range cells to either side, since paths bend in the near field."""


@dataclass(frozen=True, slots=True, eq=False)
class DirectionMap:
    """The response at one frequency over directions, at the distance of the focus.

    Unit vectors (n_y, n_x, 3) on a lattice of sines, twice as fine as the array resolves (along an
    axis without aperture only that of the focus); levels relative to the focus, 0 beyond the angle
    of the search; and steps (2,) of the sines along x and y, 0 without aperture.
    """

    directions: np.ndarray
    level: np.ndarray
    frequency_hz: float
    step: np.ndarray

    @classmethod
    def of(
        cls, array: Clusters, frequency_hz: float, focus_m: np.ndarray, within_deg: float
    ) -> DirectionMap:
        """Return the map up to an angle; more than `MOST_TERMS` are an error."""
        counts, terms = search(array, frequency_hz, within_deg)
        if terms > MOST_TERMS:
            checks.fail(
                "array_figures: within_deg",
                f"a search of at most {MOST_TERMS:.0e} antennas times directions",
                f"{terms:.1e} within {within_deg:g} degrees",
            )
        most = np.sin(np.deg2rad(within_deg))
        distance_m = float(np.linalg.norm(focus_m))
        axes = [
            most * np.linspace(-1, 1, 2 * count + 1) if count else np.array([at_m / distance_m])
            for count, at_m in zip(counts, focus_m, strict=False)
        ]
        sines = np.stack(np.meshgrid(*axes), axis=2)
        square = (sines**2).sum(axis=2)
        directions = np.dstack([sines, np.sqrt(np.clip(1 - square, 0, None))])
        level, seen = np.zeros(square.shape), square <= most**2
        points_m = distance_m * directions[seen]
        level[seen] = response(array, np.array([frequency_hz]), focus_m, points_m)
        step = np.array([axis[1] - axis[0] if len(axis) > 1 else 0.0 for axis in axes])
        return cls(directions, level, frequency_hz, step)

    def maxima(self, least: float) -> np.ndarray:
        """Directions (n, 3) above a level that none beside them exceeds, strongest first."""
        from scipy.ndimage import maximum_filter

        peaks = (self.level == maximum_filter(self.level, size=3)) & (self.level > least)
        return self.directions[peaks][np.argsort(-self.level[peaks], kind="stable")]


@dataclass(frozen=True, slots=True)
class Lobe:
    """A direction whose echoes the focused array takes for those of its focus."""

    position_m: np.ndarray
    """Of its maximum, shape (3,)."""
    azimuth_deg: float
    """Angle to +z in the x-z plane, positive towards +x; 0 for the directions of y."""
    elevation_deg: float
    """Angle above the x-z plane, positive towards +y."""
    level_db: float
    """Relative to the focus, over the whole band."""

    @property
    def grating(self) -> bool:
        """Whether it is so strong that it can be taken for the target."""
        return self.level_db >= GRATING_DB


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

    def drawn(count: int) -> np.ndarray:
        some = min(count, max(1, SEARCHED // len(clusters)))
        return np.sort(np.random.default_rng(0).choice(count, some, replace=False))

    few = [one.part(drawn(one.n_tx), drawn(one.n_rx)) for one in clusters]
    # Of the 94 x 94 imager up to its band all lobes are below -13 dB.
    known = waveform.frequencies_hz[-1] <= 82.5e9 and clusters[0].same_positions(qar50())
    terms = search(few, waveform.center_hz, 90.0)[1]
    if (known and len(clusters) == 1) or terms > MOST_GHOST_TERMS:
        return [[] for _ in among]
    over = DirectionMap.of(few, waveform.center_hz, at_m, 90.0)
    places_m = float(np.linalg.norm(at_m)) * over.maxima(FEWEST_PEAK)
    places_m = places_m[~are_one(places_m, at_m, over.step)]
    band_hz = thinned(waveform)
    starts_m = (places_m[counts(places_m)][:MOST_GHOSTS] for counts in among)
    return [climbed_lobes(array, band_hz, at_m, own, over.step, GHOST_DB) for own in starts_m]


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
    highest = zip(places_m, level, level.argmax(axis=1), strict=True)
    found = [(places[i], float(values[i])) for places, values, i in highest]
    return [alias for alias in found if alias[1] >= 10 ** (ALIAS_DB / 20)]


def are_one(places_m: np.ndarray, place_m: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Whether places (..., 3) are within two steps of the sines of another: one main lobe."""
    sines = places_m / np.linalg.norm(places_m, axis=-1, keepdims=True)
    off = np.abs(sines - place_m / np.linalg.norm(place_m))[..., :2]
    return np.asarray((off <= 2 * step + 1e-9).all(axis=-1))


def search(array: Clusters, frequency_hz: float, within_deg: float) -> tuple[list[int], float]:
    """Steps of sines, of at most 0.02, to either side along x and y, 0 without aperture; antennas
    times directions. The extent of Tx + Rx over all pairs is twice that of their middles.
    """
    own = clusters_of(array)
    last_m = np.max([one.tx_m.max(axis=0) + one.rx_m.max(axis=0) for one in own], axis=0)
    first_m = np.min([one.tx_m.min(axis=0) + one.rx_m.min(axis=0) for one in own], axis=0)
    counts = [0, 0]
    for axis, span_m in enumerate((last_m - first_m)[:2]):
        if span_m > 0:
            finest = 0.5 * SPEED_OF_LIGHT_M_PER_S / (frequency_hz * max(span_m, 1e-9))
            counts[axis] = int(np.ceil(np.sin(np.deg2rad(within_deg)) / min(finest, 0.02)))
    directions = float(np.prod([2.0 * count + 1 for count in counts]))
    return counts, sum(one.n_tx + one.n_rx for one in own) * directions


def _lobe(position_m: np.ndarray, height: float) -> Lobe:
    direction = position_m / np.linalg.norm(position_m)
    aside = np.hypot(direction[0], direction[2])
    # Next to the y axis the azimuth is that of rounding.
    azimuth = np.arctan2(direction[0], direction[2]) if aside > 1e-3 else 0.0
    angles = azimuth, np.arcsin(np.clip(direction[1], -1.0, 1.0))
    azimuth_deg, elevation_deg = (round(float(np.rad2deg(a)), 6) + 0.0 for a in angles)  # no -0
    return Lobe(position_m, azimuth_deg, elevation_deg, 20 * float(np.log10(height)))


def climbed_lobes(
    array: Clusters,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    starts_m: np.ndarray,
    step: np.ndarray,
    least_db: float,
) -> list[Lobe]:
    """The maxima of the response next to points (n, 3) at the distance of the focus, metres.

    Each once, strongest first, without the main lobe and what is below `least_db`; at the ranges
    that suit them. `step` is that of a `DirectionMap`: half a step beside a maximum there is 0.8 of
    it, so points with less than half of `least_db` are left out.
    """
    distance_m = float(np.linalg.norm(focus_m))
    span_hz = float(np.ptp(frequencies_hz))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else 0.0
    shifts_m = np.linspace(-CELLS, CELLS, SHIFTS) * min(cell_m, distance_m / (CELLS + 1))
    sums = pair_sums(array, frequencies_hz, focus_m, starts_m)
    wavenumbers = 2 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    profiles = np.abs(sums @ np.exp(2j * np.outer(wavenumbers, shifts_m)))
    high = profiles.max(axis=1) > len(frequencies_hz) * 10 ** (least_db / 20) / 2

    def places_m(at: np.ndarray) -> np.ndarray:
        """Positions (..., 3), metres, of sines along x and y and a range."""
        # Beyond the horizon as much before it, so that a maximum there is one of the climb, too.
        beyond = np.maximum(1.0, np.hypot(at[..., :1], at[..., 1:2]))
        sines = at[..., :2] * (2.0 - beyond) / beyond
        upwards = np.sqrt(np.clip(1.0 - (sines**2).sum(axis=-1, keepdims=True), 0.0, None))
        range_m = np.clip(at[..., 2:], distance_m + shifts_m[0], distance_m + shifts_m[-1])
        return np.asarray(range_m * np.concatenate([sines, upwards], axis=-1))

    def heights(at: np.ndarray) -> np.ndarray:
        points_m = places_m(at).reshape(-1, 3)
        return response(array, frequencies_hz, focus_m, points_m).reshape(at.shape[:-1])

    ranges_m = distance_m + shifts_m[profiles[high].argmax(axis=1)]
    at = np.column_stack([starts_m[high][:, :2] / distance_m, ranges_m])
    at, height = climbed(heights, at, np.array([*step, cell_m / 4]))
    found: list[Lobe] = []
    for position_m, level in zip(places_m(at), height.tolist(), strict=True):
        known_m = np.array([focus_m, *(lobe.position_m for lobe in found)])
        if level >= 10 ** (least_db / 20) and not are_one(known_m, position_m, step).any():
            found.append(_lobe(position_m, level))

    def rank(lobe: Lobe) -> tuple[float, ...]:
        # Levels of symmetric lobes differ in their last digits.
        return -round(lobe.level_db, 2), round(lobe.elevation_deg, 2), round(lobe.azimuth_deg, 2)

    return sorted(found, key=rank)


def climbed(
    heights: Callable[[np.ndarray], np.ndarray], at: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The maxima next to points (n, 3), and their heights (n,): each point goes to the highest of
    27 around it and of the top of a parabola through these, step by step of `CLIMBED`.
    """
    i, j = np.triu_indices(3)
    around = np.stack(np.meshgrid(*3 * [[0.0, -1.0, 1.0]]), axis=-1).reshape(-1, 3)
    parabola = np.linalg.pinv(np.column_stack([np.ones(27), around, around[:, i] * around[:, j]]))
    curve, height = np.zeros((len(at), 3, 3)), np.zeros(len(at))
    for step in np.multiply.outer(CLIMBED, reach):
        places = at[:, None] + step * around
        level = heights(places)
        fit = level @ parabola.T
        curve[:, i, j] = curve[:, j, i] = fit[:, 4:] * np.where(i == j, 2.0, 1.0)
        # Levels are exact to 1e-5. Along an axis without aperture or bandwidth nothing changes.
        top = -np.linalg.pinv(curve, 1e-4, hermitian=True) @ fit[:, 1:4, None]
        top = at[:, None] + step * np.clip(top.swapaxes(1, 2), -1.0, 1.0)
        places = np.concatenate([places, top], axis=1)
        level = np.hstack([level, heights(top)])
        at, height = places[np.arange(len(at)), level.argmax(axis=1)], level.max(axis=1)
    return at, height
