"""The box of voxels around one object in a capture, of which the strongest echo is known."""

from __future__ import annotations

import numpy as np

from clradar.arrays.point_spread import response
from clradar.constants import PLAUSIBLE_RANGE_M
from clradar.imaging.echo_location import (
    FOCUS,
    CoarseImage,
    Echo,
    coarse_image,
    flat_axes,
    resolution_m,
)
from clradar.model import Capture, VoxelGrid
from clradar.opencl import Device

PAPER_GRID = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
"""The grid of the paper's experiment: a hand 0.3 m in front of the aperture."""

BRIGHT_DB = 10.0
"""The object is what is at most this far below the strongest echo. Side lobes are at -13 dB."""

VOXELS_PER_RESOLUTION = 3.5  # at least, as in the paper's grid across boresight: 1 mm for 3.8 mm
LEAST_RESOLUTIONS = 40.0
"""Half the size of a grid is at least that of the paper's, or this where that is less."""

ASIDE = 0.35  # of the range: other bodies of one range are looked for so far to the sides
ASIDE_VOXELS, LOBE_FREQUENCIES = 2000, 16
"""Bright voxels to the sides that are compared with the lobes of the strongest echo."""

COARSE_LOSS = 0.7
"""An image of which the strongest echo has less is too coarse to tell others from lobes."""

CREST = 3.0  # nor is what exceeds the RMS of a coarse image by less: random side lobes reach this
MARGIN_RESOLUTIONS = 2.0  # between the object and the faces of its grid
FURTHER_DB, FURTHER_M, FURTHER_RESOLUTIONS = 7.0, 2e-3, 4.0
"""A grid is extended for echoes at most so far below the strongest, and beyond a face by more than
the error of a coarse image's maximum up to so many resolutions."""

FRONT_M, HAND_DEPTH_M = 0.01, 0.08
"""Grids of near hands begin at least so far before the antennas, next to which every pair focuses,
and reach so far to either side of the strongest echo: a thumb is 60 mm before the palm."""

END_M, END_SHARE = 0.01, 0.1
"""Ends of a grid are multiples of this, which round steps up to it divide. A box is cut by a tenth
of it at most, so that errors of a millimetre in the place do not add another."""

MOST_VOXELS = 4_000_000  # of a grid that is placed; that of the paper has 3.3 million
ROUND, LESS_ROUND = (1, 2, 5), (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
"""Spacings times a power of ten; the second of grids that would otherwise be too large."""

GROWTHS = 6  # how often the box that is searched for the object grows, by half at most


def box_around(capture: Capture, echo: Echo, device: Device) -> VoxelGrid:
    """The grid around an object whose strongest echo is given."""
    at_m, flat = echo.position_m, flat_axes(capture)
    cells_m = resolution_m(capture, at_m)
    margin_m = np.where(flat, 0.0, MARGIN_RESOLUTIONS * cells_m)
    paper_m = PAPER_GRID.spacing_m * (np.array(PAPER_GRID.counts) - 1) / 2
    least_m = np.maximum(np.minimum(paper_m, LEAST_RESOLUTIONS * cells_m), margin_m)
    least_m[flat] = 0.0
    front_m = _front_m(capture) + 1e-3
    half_m = _half_of_others(capture, at_m, echo.amplitude, least_m, front_m, device)
    for _ in range(GROWTHS):
        low_m, high_m = at_m - half_m, at_m + half_m
        low_m[2] = max(low_m[2], min(front_m, at_m[2]))
        bright_m = _bright_box(coarse_image(capture, low_m, high_m, device))
        low_m = np.minimum(at_m - least_m, bright_m[0] - margin_m)
        high_m = np.maximum(at_m + least_m, bright_m[1] + margin_m)
        grown_m = np.maximum(at_m - low_m, high_m - at_m)
        if (grown_m <= half_m * (1 + 1e-9)).all():
            break
        half_m = np.maximum(half_m, np.minimum(grown_m, 1.5 * half_m))
    low_m[2] = max(low_m[2], min(front_m, at_m[2]))
    low_m, high_m = _within_reach(capture, low_m, high_m, at_m, least_m, bright_m)
    farthest_m = PLAUSIBLE_RANGE_M[1]
    low_m, high_m = (np.clip(end, -farthest_m, farthest_m) for end in (low_m, high_m))
    return rounded(capture, low_m, high_m, cells_m)


def hand_box(capture: Capture, echo: Echo, power: float, device: Device) -> VoxelGrid:
    """The paper's grid, or one as wide about a nearer echo, extended to where the object reaches.

    `power` is that of the echo in the mean range profile.
    """
    low_m = PAPER_GRID.origin_m.copy()
    high_m = low_m + PAPER_GRID.spacing_m * (np.array(PAPER_GRID.counts) - 1)
    near = echo.position_m[2] < low_m[2] - PAPER_GRID.spacing_m[2]
    if near:
        low_m[2], high_m[2] = echo.position_m[2] + np.array([-HAND_DEPTH_M, HAND_DEPTH_M])
        low_m[2] = max(low_m[2], min(_front_m(capture) + FRONT_M, echo.position_m[2]))
    wide_m = _extended(capture, np.stack([low_m, high_m]), echo, power, device)
    if not near and (wide_m == [low_m, high_m]).all():
        return PAPER_GRID
    step_m = PAPER_GRID.spacing_m * [1, 1, 2 if near else 1]
    grid = spanned(capture, wide_m[0], wide_m[1], step_m, 2 * MOST_VOXELS)
    return grid or rounded(capture, wide_m[0], wide_m[1], resolution_m(capture, echo.position_m))


def _front_m(capture: Capture) -> float:
    return float(max(capture.array.tx_m[:, 2].max(), capture.array.rx_m[:, 2].max()))


def _extended(
    capture: Capture, box_m: np.ndarray, echo: Echo, power: float, device: Device
) -> np.ndarray:
    """A box, shape (2, 3), whose faces are moved outwards as long as there are echoes beyond."""
    ends_m = box_m.copy()
    nearest_m = min(_front_m(capture) + FRONT_M, ends_m[0, 2])
    axes = [axis for axis in (2, 1, 0) if not flat_axes(capture)[axis]]
    for axis, end, outward in [(axis, end, 2 * end - 1) for axis in axes for end in (0, 1)]:
        for _ in range(GROWTHS):
            cell_m = resolution_m(capture, ends_m.mean(axis=0))[axis]
            slab_m = ends_m.copy()
            slab_m[1 - end, axis] = ends_m[end, axis] - outward * cell_m
            slab_m[end, axis] += outward * FURTHER_RESOLUTIONS * cell_m
            slab_m[0, 2] = max(slab_m[0, 2], nearest_m)
            image = coarse_image(capture, slab_m[0], slab_m[1], device, np.inf)
            unfocused = float(np.sqrt(FOCUS * power / image.pairs))
            level = max(10 ** (-FURTHER_DB / 20) * echo.amplitude, unfocused)
            beyond_m = outward * (_peaks_m(image, axis, level) - ends_m[end, axis])
            if beyond_m.max(initial=0.0) <= FURTHER_M:
                break
            ends_m[end, axis] += outward * (beyond_m.max() + cell_m)
            ends_m[0, 2] = max(ends_m[0, 2], nearest_m)
    return ends_m


def _peaks_m(image: CoarseImage, axis: int, level: float) -> np.ndarray:
    """Coordinates of the local maxima from a level on, along one axis.

    Parabolas of the logarithm refine them.
    """
    from scipy.ndimage import maximum_filter

    peaks = (image.amplitude >= level) & (image.amplitude == maximum_filter(image.amplitude, 3))
    index = np.argwhere(peaks)
    along = np.log(np.maximum(np.moveaxis(image.amplitude, 2 - axis, -1), 1e-30))
    at = index[:, 2 - axis]
    inner = (at > 0) & (at < along.shape[-1] - 1)
    lines = along[tuple(np.delete(index, 2 - axis, axis=1)[inner].T)]
    before, peak, after = (
        np.take_along_axis(lines, at[inner, None] + step, axis=1)[:, 0] for step in (-1, 0, 1)
    )
    shift = np.zeros(len(at))
    shift[inner] = 0.5 * (before - after) / np.minimum(before - 2 * peak + after, -1e-30)
    return np.asarray(image.grid.origin_m[axis] + image.grid.spacing_m[axis] * (at + shift))


def _within_reach(
    capture: Capture,
    low_m: np.ndarray,
    high_m: np.ndarray,
    at_m: np.ndarray,
    least_m: np.ndarray,
    bright_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Cut what is to the sides of a box and farther away than its echo and its far face.

    A margin of resolutions reaches there where a small aperture resolves next to nothing.
    """
    antennas_m = np.concatenate([capture.array.tx_m, capture.array.rx_m]).mean(axis=0)
    far_m = max(high_m[2] - antennas_m[2], float(np.linalg.norm(at_m - antennas_m)))
    near_m = max(low_m[2] - antennas_m[2], 0.0)
    side_m = np.array([*2 * [np.sqrt(max(far_m**2 - near_m**2, 0.0))], np.inf])
    inner_low_m = np.minimum(at_m - np.minimum(least_m, side_m), bright_m[0])
    inner_high_m = np.maximum(at_m + np.minimum(least_m, side_m), bright_m[1])
    return (
        np.maximum(low_m, np.minimum(antennas_m - side_m, inner_low_m)),
        np.minimum(high_m, np.maximum(antennas_m + side_m, inner_high_m)),
    )


def _half_of_others(
    capture: Capture,
    at_m: np.ndarray,
    level: float,
    least_m: np.ndarray,
    front_m: float,
    device: Device,
) -> np.ndarray:
    """Half the size of a box that holds what else is bright at the range of an echo.

    What is there of the echo itself, as lobes of the array, does not count.
    """
    antennas_m = np.concatenate([capture.array.tx_m, capture.array.rx_m])
    away_m = at_m - antennas_m.mean(axis=0)
    range_m = float(np.linalg.norm(away_m))
    wide_m = np.where(least_m > 0, np.maximum(least_m, ASIDE * range_m), 0.0)
    slope = float(np.linalg.norm(away_m[:2])) / max(away_m[2], 0.1 * range_m)
    deep_m = range_m * (1 - np.sqrt(1 - ASIDE**2)) + min(slope, 1.0) * ASIDE * range_m
    wide_m[2] = max(least_m[2], deep_m)
    low_m = at_m - wide_m
    low_m[2] = max(low_m[2], min(front_m, at_m[2]))
    image = coarse_image(capture, low_m, at_m + wide_m, device)
    index = np.argwhere(_is_bright(image))[:, ::-1]
    places_m = image.grid.origin_m + image.grid.spacing_m * index
    aside = (np.abs(places_m - at_m) > least_m + 1e-9).any(axis=1)
    too_coarse = image.amplitude.max() < COARSE_LOSS * level
    if too_coarse or not 0 < aside.sum() <= ASIDE_VOXELS:
        return least_m
    index, places_m = index[aside], places_m[aside]
    amplitude = image.amplitude[index[:, 2], index[:, 1], index[:, 0]]
    hz = capture.waveform.frequencies_hz
    some_hz = hz[np.linspace(0, len(hz) - 1, min(len(hz), LOBE_FREQUENCIES)).round().astype(int)]
    own = level * response(capture.array, some_hz, at_m, places_m)
    kept = amplitude - own >= 10 ** (-BRIGHT_DB / 20) * level
    if not kept.any():
        return least_m
    return np.maximum(least_m, np.abs(places_m[kept] - at_m).max(axis=0))


def _is_bright(image: CoarseImage) -> np.ndarray:
    highest = float(image.amplitude.max())
    floor = CREST * float(np.sqrt(np.mean(np.square(image.amplitude))))
    return np.asarray(
        image.amplitude >= max(10 ** (-BRIGHT_DB / 20) * highest, min(floor, highest))
    )


def _bright_box(image: CoarseImage) -> np.ndarray:
    """Least and largest coordinates of the bright voxels, shape (2, 3), metres."""
    index = np.argwhere(_is_bright(image))[:, ::-1]
    ends = np.stack([index.min(axis=0), index.max(axis=0)])
    return image.grid.origin_m + image.grid.spacing_m * ends


def rounded(
    capture: Capture, low_m: np.ndarray, high_m: np.ndarray, resolution: np.ndarray
) -> VoxelGrid:
    """The grid of a box with round spacings, as fine as the number of voxels allows."""
    step_m = np.array([round_step(r / VOXELS_PER_RESOLUTION) for r in resolution])
    while (grid := spanned(capture, low_m, high_m, step_m)) is None:
        finest = int(np.argmin(np.where(flat_axes(capture), np.inf, step_m / resolution)))
        step_m[finest] = round_step(2.5 * step_m[finest])
    return grid


def spanned(
    capture: Capture,
    low_m: np.ndarray,
    high_m: np.ndarray,
    step_m: np.ndarray,
    most_voxels: int = MOST_VOXELS,
) -> VoxelGrid | None:
    """The grid of a box, whose ends are multiples of 10 mm or more; None if it is too large."""
    flat = flat_axes(capture)
    end_m = np.maximum(step_m, END_M)
    first = np.round(np.floor(low_m / end_m + END_SHARE) * end_m / step_m)
    last = np.round(np.ceil(high_m / end_m - END_SHARE) * end_m / step_m)
    counts = np.where(flat, 1, (last - first).astype(int) + 1)
    if np.prod(counts.astype(float)) > most_voxels:
        return None
    origin_m = np.where(flat, (low_m + high_m) / 2, np.round(first * step_m, 9))
    return VoxelGrid(origin_m, step_m, (int(counts[0]), int(counts[1]), int(counts[2])))


def round_step(step_m: float, factors: tuple[float, ...] = ROUND) -> float:
    """The largest of some factors times a power of ten that is no larger."""
    decade = 10.0 ** np.floor(np.log10(step_m) + 1e-9)
    factor = max(f for f in factors if f * decade <= step_m * (1 + 1e-9))
    return float(round(factor * decade, 12))
