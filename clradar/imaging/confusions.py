"""Warnings about what an array and its frequencies cannot tell apart: grating lobes, aliases."""

from __future__ import annotations

import numpy as np

from clradar.arrays.ambiguity import ghosts, range_aliases
from clradar.errors import warn
from clradar.imaging.echo_location import coarse_image, resolution_m
from clradar.imaging.grid_words import box_words as _box
from clradar.imaging.grid_words import length_words as _length
from clradar.imaging.grid_words import place_words as _place
from clradar.imaging.placement import inside
from clradar.model import Capture, VoxelGrid
from clradar.opencl import Device

BRIGHTER_DB = 0.2
"""Of two places of one echo it came from that which is brighter by this; less may be the coarse
image's error, or one that nothing can tell."""

PERIODS = 3
"""So many unambiguous ranges beyond the grid are looked at."""

AROUND_RESOLUTIONS = 1.33


def warn_of_confusions(capture: Capture, grid: VoxelGrid, at_m: np.ndarray, device: Device) -> None:
    """Warn where the brightest voxel of a grid has a double, or is the double of another echo.

    Parameters
    ----------
    capture : Capture
    grid : VoxelGrid
    at_m : ndarray, shape (3,), metres
        The brightest voxel.
    device : Device
    """
    array, waveform = capture.array, capture.waveform

    def in_grid(places_m: np.ndarray) -> np.ndarray:
        low_m = grid.origin_m - grid.spacing_m / 2
        high_m = low_m + grid.spacing_m * np.array(grid.counts)
        return np.asarray(((places_m >= low_m) & (places_m <= high_m)).all(axis=1))

    front_m = max(array.tx_m[:, 2].max(), array.rx_m[:, 2].max())

    def beside(places_m: np.ndarray) -> np.ndarray:
        return ~in_grid(places_m) & (places_m[:, 2] > front_m + 1e-3)

    lobes_inside, lobes_beside = ghosts(array, waveform, at_m, in_grid, beside)
    for lobe in lobes_inside[:1]:
        if inside(grid, lobe.position_m, resolution_m(capture, lobe.position_m)):
            warn(
                f"the array has a grating lobe in the grid: the echo at {_place(at_m)} "
                f"appears at {_place(lobe.position_m)}, too ({lobe.level_db:.1f} dB), and so "
                "do others; choose a grid without the lobes (clradar array lists them), or space "
                "the antennas more closely"
            )
            return
    doubles = [(lobe.position_m, "grating lobe") for lobe in lobes_beside]
    aliases = range_aliases(array, waveform, at_m, range(1, PERIODS + 1))
    doubles += [(place_m, "alias") for place_m, _ in aliases]
    if not doubles:
        return
    own = _amplitude(capture, at_m, device)
    found = [(_amplitude(capture, place_m, device), place_m, kind) for place_m, kind in doubles]
    amplitude, place_m, kind = max(found, key=lambda double: double[0])
    brighter_db = 20 * np.log10(amplitude / max(own, 1e-15 * amplitude)) if amplitude > 0 else 0.0
    if brighter_db < BRIGHTER_DB:
        return
    if kind == "alias":
        why = f"the unambiguous range c / (2 df) is {_length(waveform.unambiguous_range_m)}"
        remedy = "measure with smaller frequency steps, or image where the echo is"
    else:
        why = "the array has grating lobes"
        remedy = "space the antennas more closely, or image where the echo is"
    warn(
        f"the brightest place of the grid ({_box(grid)}), {_place(at_m)}, is the {kind} "
        f"of an echo at {_place(place_m)}, where the image is {brighter_db:.1f} dB brighter: "
        f"{why}; {remedy}"
    )


def _amplitude(capture: Capture, at_m: np.ndarray, device: Device) -> float:
    """Of the image at the maximum next to a place."""
    antennas_m = np.concatenate([capture.array.tx_m, capture.array.rx_m])
    half_m = AROUND_RESOLUTIONS * resolution_m(capture, at_m)
    low_m = at_m - half_m
    low_m[2] = max(low_m[2], min(antennas_m[:, 2].max() + 1e-3, at_m[2]))
    around = coarse_image(capture, low_m, at_m + half_m, device, np.inf).brightest()
    exact = coarse_image(capture, around.position_m, around.position_m, device, np.inf)
    return max(around.amplitude, float(exact.amplitude.max()))
