"""What an array resolves and what it confuses: widths, lobes, unambiguous range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.arrays.lobes import MOST_TERMS, DirectionMap, Lobe, climbed_lobes, search
from clradar.arrays.point_spread import Clusters, clusters_of, thinned, width_m
from clradar.errors import warn
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.checks import MAX_DYNAMIC_RANGE_DB
from clradar.model.plausible import doubtful_place

LEVEL_DB, MOST_LOBES = -20.0, 20


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
    within_deg: float | None = None,
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
    within_deg : float, optional
        Lobes are looked for in directions up to this angle to +z, at the distance of the focus.
        Default: 90, less where the search would take minutes.
    level_db : float
        Lobes below this level are left out; the strongest 20 are kept.

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
    own = clusters_of(array)
    for one in own or [None]:
        checks.instance("array_figures: array", one, AntennaArray)
    checks.instance("array_figures: waveform", waveform, Waveform)
    focus = checks.read_only("array_figures: focus_m", focus_m, np.float64, (3,))
    frequencies_hz = thinned(waveform)
    middle_hz = float(frequencies_hz[len(frequencies_hz) // 2])
    if within_deg is None:
        within_deg = 90.0
        while search(array, middle_hz, within_deg)[1] > MOST_TERMS and within_deg > 0.1:
            within_deg = float(f"{0.8 * within_deg:.2g}")
    within = checks.within("array_figures: within_deg", within_deg, 0.0, 90.0)
    level = checks.within("array_figures: level_db", level_db, -MAX_DYNAMIC_RANGE_DB, 0.0, " dB")
    antennas_m = np.concatenate([side.antennas_m for one in own for side in one.sides])
    foremost_m = antennas_m[:, 2].max()
    if focus[2] <= foremost_m:
        checks.fail("array_figures: focus_m", f"z above {foremost_m:g} m, in front", focus[2])
    if (doubt := doubtful_place(0.0, focus, antennas_m)) is not None:
        warn(f"the focus is {doubt}")
    # The response at one frequency tells where to climb that of the whole band. Another frequency's
    # maximum may be higher: half the level will do.
    over = DirectionMap.of(array, middle_hz, focus, within)
    strongest = over.maxima(10 ** (level / 20) / 2)[: 5 * MOST_LOBES]
    starts_m = np.linalg.norm(focus) * strongest
    most = np.sin(np.deg2rad(within)) + 1e-9
    found = [
        lobe
        for lobe in climbed_lobes(array, frequencies_hz, focus, starts_m, over.step, level)
        if np.hypot(*lobe.position_m[:2]) <= most * np.linalg.norm(lobe.position_m)
    ]
    across_m, along_m = 2 * float(np.linalg.norm(focus)), 0.99 * float(focus[2] - foremost_m)
    widths_m = tuple(
        width_m(array, frequencies_hz, focus, axis, longest_m)
        for axis, longest_m in zip(np.eye(3), (across_m, across_m, along_m), strict=True)
    )
    ranges_m = waveform.range_resolution_m, waveform.unambiguous_range_m
    return ArrayFigures(focus, widths_m, *ranges_m, tuple(found[:MOST_LOBES]), within, over)
