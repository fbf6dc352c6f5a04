"""Warnings about what an array and its frequencies cannot tell apart: grating lobes, aliases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clradar.arrays.lobes import ghosts, range_aliases
from clradar.errors import warn
from clradar.imaging.echo_location import amplitude_near, antennas_of, resolution_m
from clradar.imaging.grid_words import box_words, length_words, place_words
from clradar.imaging.placement import inside
from clradar.imaging.several_captures import Captures, captures_of
from clradar.model import AntennaArray, VoxelGrid
from clradar.opencl import Device

BRIGHTER_DB = 0.2
"""Of two places of one echo it came from that which is brighter by this; less may be the coarse
image's error, and nothing tells."""

PERIODS = 3  # so many unambiguous ranges beyond the grid are looked at


def warn_of_confusions(
    capture: Captures,
    arrays: Sequence[AntennaArray],
    grid: VoxelGrid,
    at_m: np.ndarray,
    device: Device,
) -> None:
    """Warn where the brightest voxel of a grid has a double, or is the double of another echo.

    `arrays` are those of the captures, with all antennas; the brightest voxel is at `at_m`, (3,).
    """
    waveform = captures_of(capture)[0].waveform

    def in_grid(places_m: np.ndarray) -> np.ndarray:
        low_m = grid.origin_m - grid.spacing_m / 2
        high_m = low_m + grid.spacing_m * np.array(grid.counts)
        return np.asarray(((places_m >= low_m) & (places_m <= high_m)).all(axis=1))

    front_m = antennas_of(capture)[:, 2].max()

    def beside(places_m: np.ndarray) -> np.ndarray:
        return ~in_grid(places_m) & (places_m[:, 2] > front_m + 1e-3)

    lobes_inside, lobes_beside = ghosts(arrays, waveform, at_m, in_grid, beside)
    for lobe in lobes_inside[:1]:
        if inside(grid, lobe.position_m, resolution_m(capture, lobe.position_m)):
            warn(
                f"the array has a grating lobe in the grid: the echo at {place_words(at_m)} "
                f"appears at {place_words(lobe.position_m)}, too ({lobe.level_db:.1f} dB), and so "
                "do others; choose a grid without the lobes (clradar array lists them), or space "
                "the antennas more closely"
            )
            return
    doubles = [(lobe.position_m, "grating lobe") for lobe in lobes_beside]
    aliases = range_aliases(arrays, waveform, at_m, range(1, PERIODS + 1))
    doubles += [(place_m, "alias") for place_m, _ in aliases]
    if not doubles:
        return
    own = amplitude_near(capture, at_m, device)
    found = [(amplitude_near(capture, place_m, device), place_m, kind) for place_m, kind in doubles]
    amplitude, place_m, kind = max(found, key=lambda double: double[0])
    brighter_db = 20 * np.log10(amplitude / max(own, 1e-15 * amplitude)) if amplitude > 0 else 0.0
    sure = brighter_db >= BRIGHTER_DB
    if not sure and (kind == "alias" or brighter_db < -BRIGHTER_DB):
        return  # far away every echo has aliases as bright as itself
    if kind == "alias":
        why = f"the unambiguous range c / (2 df) is {length_words(waveform.unambiguous_range_m)}"
        remedy = "measure with smaller frequency steps, or image where the echo is"
    else:
        why = "the array has grating lobes"
        remedy = "space the antennas more closely, or image where the echo is"
    level = f"{brighter_db:.1f} dB brighter" if sure else f"as bright ({brighter_db:+.1f} dB)"
    warn(
        f"the brightest place of the grid ({box_words(grid)}), {place_words(at_m)}, "
        f"{'is' if sure else 'may be'} the {kind} of an echo at {place_words(place_m)}, where the "
        f"image is {level}: {why}; {remedy}"
    )
