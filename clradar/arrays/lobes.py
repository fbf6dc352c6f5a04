"""Lobes of a focused array: other directions whose echoes look as if they came from the focus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clradar.arrays.point_spread import (
    Clusters,
    clusters_of,
    pair_sums,
    response,
    spans_m,
    wavenumbers,
)
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import checks

GRATING_DB = -6.0
"""Lobes from this level on can be taken for the target: they are called grating lobes."""

MOST_LOBES = 20
MOST_TERMS = 500_000_000
"""Antennas times directions of a search: some 10 s."""

NARROWER_DEG = 0.8
"""Factor between angles that are tried until a search is small enough."""

COARSEST = 0.02
"""Step of the sines of directions at most."""

CELLS = 4.0
"""Range cells to either side of the focus in which the echoes of a lobe may be brightest."""

SHIFTS = 256
"""Ranges at which the echoes of a direction are added up over the band."""

CLIMBED = (0.5, 0.5, 0.5, 0.5, 0.5, 0.2, 0.05, 0.01)
"""Steps of a climb, of those of the lattice."""

FLAT = 1e-4
"""Of the strongest curvature: less is none, as levels are exact to 1e-5."""

AT_POLE = 1e-3
"""Distance of a unit vector from the y axis within which its azimuth is that of rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class DirectionMap:
    """The response at one frequency over directions, at the distance of the focus.

    Unit vectors (n_y, n_x, 3) on a lattice of sines, and levels relative to the focus.
    """

    directions: np.ndarray
    level: np.ndarray
    frequency_hz: float


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


def lobes(
    array: Clusters,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    within_deg: float,
    least_db: float,
) -> tuple[tuple[Lobe, ...], DirectionMap]:
    """Maxima of the response over direction and range but for the main lobe, strongest first.

    The response at the middle frequency, which is returned, too, tells where to look; there the
    maximum over the whole band is climbed.
    """
    middle_hz = float(frequencies_hz[len(frequencies_hz) // 2])
    directions, level, step = response_over_directions(array, middle_hz, focus_m, within_deg)
    # Another frequency's maximum may be higher: half the level will do.
    peaks = maxima(level, 10 ** (least_db / 20) / 2)
    strongest = np.argsort(-level[peaks])[: 5 * MOST_LOBES]
    starts_m = np.linalg.norm(focus_m) * directions[peaks][strongest]
    most = np.sin(np.deg2rad(within_deg)) + 1e-9
    found = [
        lobe
        for lobe in climbed_lobes(array, frequencies_hz, focus_m, starts_m, step, least_db)
        if np.hypot(*lobe.position_m[:2]) <= most * np.linalg.norm(lobe.position_m)
    ]
    return tuple(found[:MOST_LOBES]), DirectionMap(directions, level, middle_hz)


def maxima(level: np.ndarray, least: float) -> np.ndarray:
    """Whether each place of a lattice is above `least`, and none next to it is higher."""
    from scipy.ndimage import maximum_filter

    return np.asarray((level == maximum_filter(level, size=3)) & (level > least))


def are_one(places_m: np.ndarray, place_m: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Whether places (..., 3) are within two steps of the sines of another: one main lobe."""
    sines = places_m / np.linalg.norm(places_m, axis=-1, keepdims=True)
    off = np.abs(sines - place_m / np.linalg.norm(place_m))[..., :2]
    return np.asarray((off <= 2 * step + 1e-9).all(axis=-1))


def _lobe(position_m: np.ndarray, height: float) -> Lobe:
    direction = position_m / np.linalg.norm(position_m)
    aside = np.hypot(direction[0], direction[2])
    azimuth = np.arctan2(direction[0], direction[2]) if aside > AT_POLE else 0.0
    angles = azimuth, np.arcsin(np.clip(direction[1], -1.0, 1.0))
    azimuth_deg, elevation_deg = (round(float(np.rad2deg(a)), 6) + 0.0 for a in angles)  # no -0
    return Lobe(position_m, azimuth_deg, elevation_deg, 20 * float(np.log10(height)))


def search_terms(array: Clusters, frequency_hz: float, within_deg: float) -> float:
    """Antennas times directions of `response_over_directions`."""
    n_x, n_y = (2 * count + 1 for count in _counts(array, frequency_hz, within_deg))
    return sum(one.n_tx + one.n_rx for one in clusters_of(array)) * float(n_x * n_y)


def widest_search_deg(array: Clusters, frequency_hz: float) -> float:
    """The largest angle of some, 90 degrees at first, whose search has at most `MOST_TERMS`."""
    within_deg = 90.0
    while search_terms(array, frequency_hz, within_deg) > MOST_TERMS and within_deg > 0.1:
        within_deg = float(f"{NARROWER_DEG * within_deg:.2g}")
    return within_deg


def _counts(array: Clusters, frequency_hz: float, within_deg: float) -> list[int]:
    """Steps of sines to either side along x and y; 0 without aperture."""
    most = np.sin(np.deg2rad(within_deg))
    spans = spans_m(array)[:2]
    finest = [0.5 * SPEED_OF_LIGHT_M_PER_S / (frequency_hz * max(span, 1e-9)) for span in spans]
    return [
        int(np.ceil(most / min(step, COARSEST))) if span > 0 else 0
        for span, step in zip(spans, finest, strict=True)
    ]


def response_over_directions(
    array: Clusters, frequency_hz: float, focus_m: np.ndarray, within_deg: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Magnitude of the response at one frequency, at the distance of the focus.

    Returns directions (n_y, n_x, 3), unit vectors on a lattice of sines, twice as fine as the array
    resolves (along an axis without aperture only that of the focus); levels relative to the focus,
    0 beyond the angle; and steps (2,) of the sines along x and y, 0 without aperture. More than
    `MOST_TERMS` antennas times directions are an error.
    """
    most = np.sin(np.deg2rad(within_deg))
    distance_m = float(np.linalg.norm(focus_m))
    counts = _counts(array, frequency_hz, within_deg)
    axes = [
        most * np.linspace(-1, 1, 2 * count + 1) if count else np.array([at_focus_m / distance_m])
        for count, at_focus_m in zip(counts, focus_m, strict=False)
    ]
    terms = search_terms(array, frequency_hz, within_deg)
    if terms > MOST_TERMS:
        checks.fail(
            "array_figures: within_deg",
            f"a search of at most {MOST_TERMS:.0e} antennas times directions",
            f"{terms:.1e} within {within_deg:g} degrees",
        )
    sines = np.stack(np.meshgrid(*axes), axis=2)
    square = (sines**2).sum(axis=2)
    directions = np.dstack([sines, np.sqrt(np.clip(1 - square, 0, None))])
    level, seen = np.zeros(square.shape), square <= most**2
    points_m = distance_m * directions[seen]
    sums = pair_sums(array, np.array([frequency_hz]), focus_m, points_m)
    level[seen] = np.abs(sums[:, 0])
    step = np.array([axis[1] - axis[0] if len(axis) > 1 else 0.0 for axis in axes])
    return directions, level, step


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
    that suit them. `step` is that of `response_over_directions`: half a step beside a maximum there
    is 0.8 of it, so points with less than half of `least_db` are left out.
    """
    distance_m = float(np.linalg.norm(focus_m))
    span_hz = float(np.ptp(frequencies_hz))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else 0.0
    shifts_m = np.linspace(-CELLS, CELLS, SHIFTS) * min(cell_m, distance_m / (CELLS + 1))
    sums = pair_sums(array, frequencies_hz, focus_m, starts_m)
    profiles = np.abs(sums @ np.exp(2j * np.outer(wavenumbers(frequencies_hz), shifts_m)))
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
        # Along an axis without aperture or bandwidth nothing changes.
        top = -np.linalg.pinv(curve, FLAT, hermitian=True) @ fit[:, 1:4, None]
        top = at[:, None] + step * np.clip(top.swapaxes(1, 2), -1.0, 1.0)
        places = np.concatenate([places, top], axis=1)
        level = np.hstack([level, heights(top)])
        at, height = places[np.arange(len(at)), level.argmax(axis=1)], level.max(axis=1)
    return at, height
