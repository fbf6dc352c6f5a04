"""Lobes of a focused array: other directions whose echoes look as if they came from the focus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.arrays.point_spread import pair_sums, response, wavenumbers
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, checks

GRATING_DB = -6.0
"""Lobes from this level on can be taken for the target: they are called grating lobes."""

MOST_LOBES = 20
MOST_TERMS = 500_000_000
"""Antennas times directions: some 20 s."""

COARSEST = 0.02
"""Step of the sines of directions at most."""

CELLS = 4.0
"""Range cells to either side of the focus in which the echoes of a lobe may be brightest."""

SHIFTS = 256
"""Ranges at which the echoes of a direction are added up over the band."""


@dataclass(frozen=True, slots=True, eq=False)
class DirectionMap:
    """The response at one frequency over directions, at the distance of the focus.

    Attributes
    ----------
    directions : ndarray, shape (n_y, n_x, 3)
        Unit vectors, on a lattice of sines.
    level : ndarray, shape (n_y, n_x)
        Relative to the focus.
    frequency_hz : float
    """

    directions: np.ndarray
    level: np.ndarray
    frequency_hz: float


@dataclass(frozen=True, slots=True)
class Lobe:
    """A direction whose echoes the focused array takes for those of its focus.

    Examples
    --------
    Four receivers a wavelength apart: the grating lobes of a focus at broadside are at the horizon.

    >>> import numpy as np
    >>> import clradar
    >>> band = clradar.Waveform.sfcw(60e9, 60e9, 1)
    >>> rx_m = (np.arange(4)[:, None] - 1.5) * [299_792_458 / 60e9, 0, 0]
    >>> array = clradar.AntennaArray([[0, 0, 0]], rx_m)
    >>> found = clradar.arrays.array_figures(array, band, (0, 0, 5), level_db=-6)
    >>> [(lobe.azimuth_deg, round(lobe.level_db, 1) + 0.0, lobe.grating) for lobe in found.lobes]
    [(-90.0, 0.0, True), (90.0, 0.0, True)]
    """

    position_m: np.ndarray
    """Of its maximum, shape (3,)."""
    azimuth_deg: float
    """Angle to +z in the x-z plane, positive towards +x."""
    elevation_deg: float
    """Angle above the x-z plane, positive towards +y."""
    level_db: float
    """Relative to the focus, over the whole band."""

    @property
    def grating(self) -> bool:
        """Whether it is so strong that it can be taken for the target."""
        return self.level_db >= GRATING_DB


def lobes(
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    within_deg: float,
    least_db: float,
) -> tuple[tuple[Lobe, ...], DirectionMap]:
    """Maxima of the response over direction and range but for the main lobe, strongest first.

    The response at the middle frequency tells where to look; there the echoes of the whole band
    are added up at the range that suits them, and the maximum is climbed. That response is
    returned, too.
    """
    from scipy.ndimage import maximum_filter

    distance_m = float(np.linalg.norm(focus_m))
    middle_hz = float(frequencies_hz[len(frequencies_hz) // 2])
    directions, level, step = response_over_directions(array, middle_hz, focus_m, within_deg)
    # A maximum may be between directions, and another frequency's higher: half the level will do.
    peaks = (level == maximum_filter(level, size=3)) & (level > 10 ** (least_db / 20) / 2)
    order = np.argsort(-level[peaks])[: 5 * MOST_LOBES]
    found: list[Lobe] = []
    taken = [focus_m / distance_m]
    for start in directions[peaks][order]:
        position_m, height = _climbed(array, frequencies_hz, focus_m, distance_m * start, step)
        direction = position_m / np.linalg.norm(position_m)
        known = any(np.all(np.abs(direction - other)[:2] <= 2 * step + 1e-9) for other in taken)
        beyond = np.hypot(*direction[:2]) > np.sin(np.deg2rad(within_deg)) + 1e-9
        if known or beyond or height < 10 ** (least_db / 20):
            continue
        taken.append(direction)
        found.append(_lobe(position_m, height))

    def strongest_first(lobe: Lobe) -> tuple[float, ...]:
        # Levels of symmetric lobes differ in their last digits.
        return -round(lobe.level_db, 2), round(lobe.elevation_deg, 2), round(lobe.azimuth_deg, 2)

    strongest = tuple(sorted(found, key=strongest_first)[:MOST_LOBES])
    return strongest, DirectionMap(directions, level, middle_hz)


def _lobe(position_m: np.ndarray, height: float) -> Lobe:
    direction = position_m / np.linalg.norm(position_m)
    angles = np.arctan2(direction[0], direction[2]), np.arcsin(direction[1])
    azimuth_deg, elevation_deg = (round(float(np.rad2deg(a)), 6) + 0.0 for a in angles)  # no -0
    return Lobe(position_m, azimuth_deg, elevation_deg, 20 * float(np.log10(height)))


def search_terms(array: AntennaArray, frequency_hz: float, within_deg: float) -> float:
    """Antennas times directions of `response_over_directions`."""
    n_x, n_y = (2 * count + 1 for count in _counts(array, frequency_hz, within_deg))
    return (array.n_tx + array.n_rx) * float(n_x * n_y)


def _counts(array: AntennaArray, frequency_hz: float, within_deg: float) -> list[int]:
    """Steps of sines to either side along x and y; 0 without aperture."""
    spans_m = np.ptp(array.tx_m, axis=0)[:2] + np.ptp(array.rx_m, axis=0)[:2]
    most = np.sin(np.deg2rad(within_deg))
    finest = [0.5 * SPEED_OF_LIGHT_M_PER_S / (frequency_hz * max(span, 1e-9)) for span in spans_m]
    return [
        int(np.ceil(most / min(step, COARSEST))) if span > 0 else 0
        for span, step in zip(spans_m, finest, strict=True)
    ]


def climbed_lobe(
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    start_m: np.ndarray,
    step: np.ndarray,
) -> Lobe:
    """The lobe next to a point; `step` of sines as `response_over_directions` returns it."""
    return _lobe(*_climbed(array, frequencies_hz, focus_m, start_m, step))


def response_over_directions(
    array: AntennaArray, frequency_hz: float, focus_m: np.ndarray, within_deg: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Magnitude of the response at one frequency, at the distance of the focus.

    Returns
    -------
    directions : ndarray, shape (n_y, n_x, 3)
        Unit vectors on a lattice of sines, twice as fine as the array resolves; along an axis
        without aperture only that of the focus.
    level : ndarray, shape (n_y, n_x)
        Relative to the focus; 0 beyond the angle.
    step : ndarray, shape (2,)
        Of the sines along x and y; 0 without aperture.

    Raises
    ------
    ModelError
        More than `MOST_TERMS` antennas times directions.
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


def _climbed(
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    focus_m: np.ndarray,
    start_m: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, float]:
    """The maximum of the response next to a point, at the range that suits it, and its height."""
    from scipy.optimize import minimize

    distance_m = float(np.linalg.norm(start_m))
    span_hz = float(np.ptp(frequencies_hz))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else 0.0
    shifts_m = np.linspace(-CELLS, CELLS, SHIFTS) * min(cell_m, distance_m / (CELLS + 1))
    sums = pair_sums(array, frequencies_hz, focus_m, start_m[None])[0]
    profile = np.abs(np.exp(2j * np.outer(shifts_m, wavenumbers(frequencies_hz))) @ sums)
    at = np.array([*start_m[:2] / distance_m, distance_m + shifts_m[profile.argmax()]])

    def position_m(place: np.ndarray) -> np.ndarray:
        upwards = np.sqrt(max(0.0, 1.0 - place[0] ** 2 - place[1] ** 2))
        within_m = np.clip(place[2], *(distance_m + shifts_m[[0, -1]]))
        return within_m * np.array([place[0], place[1], upwards])

    corners = np.vstack([np.zeros(3), np.diag([*step, cell_m / 4])])
    best = minimize(
        lambda place: -response(array, frequencies_hz, focus_m, position_m(place)[None])[0],
        at,
        method="Nelder-Mead",
        options={"initial_simplex": at + corners, "xatol": 1e-5, "fatol": 1e-4},
    )
    return position_m(best.x), -float(best.fun)
