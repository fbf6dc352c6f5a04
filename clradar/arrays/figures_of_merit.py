"""What an array resolves and what it confuses: widths, lobes, unambiguous range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.arrays.lobes import DirectionMap, Lobe, lobes, widest_search_deg
from clradar.arrays.point_spread import Clusters, clusters_of, thinned, width_m
from clradar.errors import warn
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.plausible import doubtful_place

LEVEL_DB = -20.0


@dataclass(frozen=True, slots=True)
class ArrayFigures:
    """What `array_figures` found."""

    focus_m: np.ndarray
    """Shape (3,), metres."""
    widths_m: tuple[float, float, float]
    """Full widths of the response at -3 dB along x, y and z; infinite where there is no aperture
    (or, along z, neither aperture nor bandwidth)."""
    range_cell_m: float
    """c / (2 B), the resolution in range."""
    unambiguous_range_m: float
    """c / (2 df): echoes from so much farther away appear at the same range."""
    lobes: tuple[Lobe, ...]
    """Strongest first."""
    within_deg: float
    """Directions up to this angle to +z were searched."""
    over_directions: DirectionMap
    """What was searched: the response at the middle frequency."""


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
        Several, as `read_clusters` returns them: figures are those of one image of all.
    waveform : Waveform
    focus_m : sequence of 3 float, metres
        In the antenna frame, in front of the antennas.
    within_deg : float, optional, degrees
        Lobes are looked for in directions up to this angle to +z, at the distance of the focus.
        Default: 90, and less for so many antennas and directions that the search would take
        minutes; `ArrayFigures.within_deg` has it.
    level_db : float, decibel
        Lobes below this level are left out; the strongest 20 are kept.

    Returns
    -------
    ArrayFigures

    Warns
    -----
    ClradarWarning
        A focus that is so near to the antennas that it is most likely in another unit.

    Notes
    -----
    For lines with spacings d the lobes of one frequency are at sin(angle) = sin(focus) + m c/(f d)
    (Balanis, Antenna Theory, 6.3). Bandwidth smears those that the aperture does not: the level is
    that of the whole band, at the range where it is highest.

    Examples
    --------
    Sixteen receivers 2.5 mm apart at 60 GHz, half a wavelength: no lobe within 60 degrees.

    >>> import numpy as np
    >>> import clradar
    >>> rx_m = np.arange(16)[:, None] * [2.5e-3, 0, 0]
    >>> array = clradar.AntennaArray([[0, 0, 0]], rx_m - rx_m.mean(axis=0))
    >>> band = clradar.Waveform.sfcw(59e9, 61e9, 32)
    >>> found = clradar.arrays.array_figures(array, band, (0, 0, 1), within_deg=60, level_db=-6)
    >>> found.lobes, f"{1e3 * found.unambiguous_range_m:.0f} mm"
    ((), '2323 mm')
    """
    if not isinstance(array, Sequence) or not array:
        checks.instance("array_figures: array", array, AntennaArray)
    for one in clusters_of(array):
        checks.instance("array_figures: array", one, AntennaArray)
    checks.instance("array_figures: waveform", waveform, Waveform)
    focus = checks.read_only("array_figures: focus_m", focus_m, np.float64, (3,))
    frequencies_hz = thinned(waveform)
    if within_deg is None:
        within_deg = widest_search_deg(array, float(frequencies_hz[len(frequencies_hz) // 2]))
    within = checks.positive("array_figures: within_deg", within_deg)
    level = checks.real("array_figures: level_db", level_db)
    foremost_m = max(side.antennas_m[:, 2].max() for a in clusters_of(array) for side in a.sides)
    if focus[2] <= foremost_m:
        checks.fail("array_figures: focus_m", f"z above {foremost_m:g} m, in front", focus[2])
    antennas_m = np.concatenate([s.antennas_m for a in clusters_of(array) for s in a.sides])
    doubt = doubtful_place(0.0, focus, antennas_m)
    if doubt is not None:
        warn(f"the focus is {doubt}")
    if within > 90 or level >= 0:
        checks.fail("array_figures", "within_deg up to 90, level_db below 0", (within, level))
    found, over_directions = lobes(array, frequencies_hz, focus, within, level)
    across_m = 2 * float(np.linalg.norm(focus))
    along_m = 0.99 * float(focus[2] - foremost_m)
    width_x, width_y, width_z = (
        width_m(array, frequencies_hz, focus, axis, longest_m)
        for axis, longest_m in zip(np.eye(3), (across_m, across_m, along_m), strict=True)
    )
    return ArrayFigures(
        focus,
        (width_x, width_y, width_z),
        waveform.range_resolution_m,
        waveform.unambiguous_range_m,
        found,
        within,
        over_directions,
    )
