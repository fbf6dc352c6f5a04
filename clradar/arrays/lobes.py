"""What an array resolves and what it confuses: widths, lobes, aliases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.arrays.instruments import qar50
from clradar.arrays.point_spread import (
    Clusters,
    clusters_of,
    response,
    thinned,
    width_m,
)
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.checks import MAX_DYNAMIC_RANGE_DB
from clradar.model.plausible import doubtful_place
from clradar.model.range_profile import MIN_STEPS

LEVEL_DB, MOST_LOBES = -20.0, 20  # of `array_figures`, the strongest

GRATING_DB = -6.0  # from this level on lobes can be taken for the target: they are grating lobes
MOST_TERMS = 500_000_000  # antennas times directions of a search: some 10 s
CLIMBED = (1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.008)
"""Steps of a climb to the highest of 15 places, as shares of those of the lattice and of a quarter
of a range cell; before it to the highest of four cells of range to either side."""

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
        """Return the map up to an angle."""
        counts, _ = search(array, frequency_hz, within_deg)
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

    @classmethod
    def at(cls, position_m: np.ndarray, height: float) -> Lobe:
        """Return the lobe of a maximum with a height relative to the focus."""
        x, y, z = position_m / np.linalg.norm(position_m)
        # Next to the y axis the azimuth is that of rounding.
        azimuth = np.arctan2(x, z) if np.hypot(x, z) > 1e-3 else 0.0
        angles = azimuth, np.arcsin(np.clip(y, -1.0, 1.0))
        azimuth_deg, elevation_deg = (round(float(np.rad2deg(a)), 6) + 0.0 for a in angles)  # no -0
        return cls(position_m, azimuth_deg, elevation_deg, 20 * float(np.log10(height)))

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
    that suit them. `step` is that of a `DirectionMap`.
    """
    distance_m = float(np.linalg.norm(focus_m))
    span_hz = float(np.ptp(frequencies_hz))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else 0.0
    reach = np.array([*step, min(cell_m / 4, distance_m / 24)])

    def places_m(at: np.ndarray) -> np.ndarray:
        """Positions (..., 3), metres, of sines along x and y, to the horizon, and a range."""
        sines = at[..., :2] / np.maximum(1.0, np.hypot(at[..., :1], at[..., 1:2]))
        upwards = np.sqrt(np.clip(1.0 - (sines**2).sum(axis=-1, keepdims=True), 0.0, None))
        return np.asarray(at[..., 2:] * np.concatenate([sines, upwards], axis=-1))

    at = np.column_stack([starts_m[:, :2] / distance_m, np.full(len(starts_m), distance_m)])
    around = np.stack(np.meshgrid(*3 * [[0.0, -1.0, 1.0]]), axis=-1).reshape(-1, 3)
    around = around[np.abs(around).sum(axis=1) != 2]  # the middle, along axes, and corners
    rows, height = np.arange(len(at)), np.zeros(len(at))
    for offsets in (np.arange(-16, 17)[:, None] * [0, 0, 1], *np.multiply.outer(CLIMBED, around)):
        tried = at[:, None] + offsets * reach
        level = response(array, frequencies_hz, focus_m, places_m(tried).reshape(-1, 3))
        level = level.reshape(tried.shape[:2])
        at, height = tried[rows, level.argmax(axis=1)], level.max(axis=1)
    found: list[Lobe] = []
    for position_m, peak in zip(places_m(at), height.tolist(), strict=True):
        known_m = np.array([focus_m, *(lobe.position_m for lobe in found)])
        if peak >= 10 ** (least_db / 20) and not are_one(known_m, position_m, step).any():
            found.append(Lobe.at(position_m, peak))

    def rank(lobe: Lobe) -> tuple[float, ...]:
        # Levels of symmetric lobes differ in their last digits.
        return -round(lobe.level_db, 2), round(lobe.elevation_deg, 2), round(lobe.azimuth_deg, 2)

    return sorted(found, key=rank)


@dataclass(frozen=True, slots=True)
class ArrayFigures:
    """What `array_figures` found."""

    focus_m: np.ndarray
    widths_m: tuple[float, ...]
    """At -3 dB along x, y and z; infinite without an aperture (along z and bandwidth)."""
    range_cell_m: float
    """c / (2 B), the resolution in range."""
    unambiguous_range_m: float
    """c / (2 df), after which ranges repeat."""
    lobes: tuple[Lobe, ...]
    """Strongest first."""
    within_deg: float
    """Angle to +z that was searched."""
    over_directions: DirectionMap
    """The response at the middle frequency."""


def array_figures(
    array: Clusters,
    waveform: Waveform,
    focus_m: Sequence[float],
    *,
    level_db: float = LEVEL_DB,
) -> ArrayFigures:
    """Widths at -3 dB, lobes and unambiguous range of an array that is focused on a point.

    Parameters
    ----------
    array : AntennaArray, or sequence of AntennaArray
        Several, as of `read_clusters`: figures are those of one image of all.
    waveform : Waveform
    focus_m : sequence of 3 float
        In the antenna frame, in front of the antennas.
    level_db : float
        Lobes below this level are left out; the strongest 20 are kept. They are looked for in
        front, at the distance of the focus: less far aside where that would take minutes.

    Notes
    -----
    For lines with spacings d the lobes of one frequency are at sin(angle) = sin(focus) + m c/(f d)
    (Balanis, Antenna Theory, 6.3). Levels are of the whole band, at the range where it is highest.

    Examples
    --------
    Four receivers a wavelength apart: the grating lobes of a focus at broadside are at the horizon.

    >>> band = clradar.Waveform.sfcw(60e9, 60e9, 1)
    >>> rx_m = (np.arange(4)[:, None] - 1.5) * [299_792_458 / 60e9, 0, 0]
    >>> array = clradar.AntennaArray([[0, 0, 0]], rx_m)
    >>> found = clradar.arrays.array_figures(array, band, (0, 0, 5), level_db=-6)
    >>> [(lobe.azimuth_deg, round(lobe.level_db, 1) + 0.0, lobe.grating) for lobe in found.lobes]
    [(-90.0, 0.0, True), (90.0, 0.0, True)]
    """
    array = clusters_of(array)
    for one in array or [None]:
        checks.instance("array_figures: array", one, AntennaArray)
    checks.instance("array_figures: waveform", waveform, Waveform)
    focus = checks.read_only("array_figures: focus_m", focus_m, np.float64, (3,))
    frequencies_hz = thinned(waveform)
    middle_hz = float(frequencies_hz[len(frequencies_hz) // 2])
    within_deg = 90.0
    while search(array, middle_hz, within_deg)[1] > MOST_TERMS and within_deg > 0.1:
        within_deg = float(f"{0.8 * within_deg:.2g}")
    level = checks.within("array_figures: level_db", level_db, -MAX_DYNAMIC_RANGE_DB, 0.0, " dB")
    antennas_m = np.concatenate([side.antennas_m for one in array for side in one.sides])
    foremost_m = antennas_m[:, 2].max()
    if focus[2] <= foremost_m:
        checks.fail("array_figures: focus_m", f"z above {foremost_m:g} m, in front", focus[2])
    if (doubt := doubtful_place(0.0, focus, antennas_m)) is not None:
        warn(f"the focus is {doubt}")
    # The response at one frequency tells where to climb that of the whole band. Another frequency's
    # maximum may be higher: half the level will do.
    over = DirectionMap.of(array, middle_hz, focus, within_deg)
    strongest = over.maxima(10 ** (level / 20) / 2)[: 5 * MOST_LOBES]
    starts_m = np.linalg.norm(focus) * strongest
    found = climbed_lobes(array, frequencies_hz, focus, starts_m, over.step, level)
    across_m, along_m = 2 * float(np.linalg.norm(focus)), 0.99 * float(focus[2] - foremost_m)
    widths_m = tuple(
        width_m(array, frequencies_hz, focus, axis, longest_m)
        for axis, longest_m in zip(np.eye(3), (across_m, across_m, along_m), strict=True)
    )
    ranges_m = waveform.range_resolution_m, waveform.unambiguous_range_m
    return ArrayFigures(focus, widths_m, *ranges_m, tuple(found[:MOST_LOBES]), within_deg, over)
