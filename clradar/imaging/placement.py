"""Voxel grids for captures of which none is given: around the strongest echo."""

from __future__ import annotations

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M
from clradar.imaging.echo_location import CoarseImage, coarse_image, locate, resolution_m
from clradar.model import Capture, VoxelGrid, checks
from clradar.model.range_profile import RangeProfile, echo_profile
from clradar.opencl import Device, open_device

PAPER_GRID = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
"""The grid of the paper's experiment: a hand 0.3 m in front of the aperture."""

WEAKER_DB = 20.0
"""An echo in the paper's grid (or in one that was given) is the object even where another is
stronger by up to this: a wall behind a hand."""

BRIGHT_DB = 10.0
"""The object is what is at most this far below the strongest echo. Side lobes are at -13 dB."""

VOXELS_PER_RESOLUTION = 3.5
"""At least, as in the paper's grid across boresight: 1 mm for 3.8 mm."""

CREST = 3.0
"""Nor is what exceeds the RMS of a coarse image by less: random side lobes reach this."""

MARGIN_RESOLUTIONS = 2.0
"""Between the object and the faces of its grid."""

END_M, END_SHARE = 0.01, 0.1
"""Ends of a grid are multiples of this, which round steps up to it divide. A box is cut by a tenth
of it at most, so that errors of a millimetre in the place do not add another."""

MOST_VOXELS = 4_000_000
"""Of a grid that is placed; that of the paper has 3.3 million."""

GROWTHS = 6
"""How often the box that is searched for the object grows, by half at most."""


def place_grid(capture: Capture, *, device: Device | str | None = None) -> VoxelGrid:
    """Return a voxel grid for the object in a capture.

    Parameters
    ----------
    capture : Capture
    device : Device, str or None
        See `clradar.open_device`.

    Returns
    -------
    VoxelGrid
        That of the paper, x and y from -100 to 100 mm and z from 260 to 340 mm every 1 mm, if the
        object is in it, or if nothing is seen above the noise. Else a grid around the strongest
        echo beyond the direct coupling: of the same size or larger, so that it holds what is
        within 10 dB of that echo, every 3.5th of the resolution at least, of 4 million voxels at
        most.

    Raises
    ------
    DeviceError
        See `clradar.backproject`.

    Notes
    -----
    The mean range profile over pairs gives the range. Its direction is that in which the profiles
    add up without their phases, which depends on path lengths alone; a coarse image there gives the
    position. The object is in the paper's grid if an echo there is at most 20 dB below the
    strongest of all.

    Examples
    --------
    >>> import clradar
    >>> q = clradar.arrays.qar50()
    >>> array = clradar.AntennaArray(q.tx_m[::3], q.rx_m[::3])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    >>> for z_m in (0.3, 1.5):
    ...     capture = clradar.room_capture(array, waveform, [], points_m=[[0, 0, z_m]])
    ...     grid = clradar.place_grid(capture, device="pocl")
    ...     print(grid.counts, grid.z_m[[0, -1]])
    (201, 201, 81) [0.26 0.34]
    (41, 41, 51) [1.45 1.55]
    """
    checks.instance("place_grid: capture", capture, Capture)
    opened = open_device(device)
    profile = echo_profile(capture)
    if profile is None:
        return PAPER_GRID
    here = weaker_within(
        profile, reach_m(capture, PAPER_GRID), capture.waveform.unambiguous_range_m
    )
    for path_m in [*here[:1], profile.path_m[0]]:
        at_m = locate(capture, float(path_m), opened).position_m
        if inside(PAPER_GRID, at_m):
            return PAPER_GRID
    return _around(capture, at_m, opened)


def reach_m(capture: Capture, grid: VoxelGrid) -> tuple[float, float]:
    """Least and largest range in a grid: half path length, mean over the antennas."""
    antennas = [capture.array.tx_m, capture.array.rx_m]
    low, high = grid.origin_m, grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1)
    middle = np.mean([a.mean(axis=0) for a in antennas], axis=0)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    ends = np.vstack([np.clip(middle, low, high), corners])
    ranges_m = np.mean(
        [np.linalg.norm(ends[:, None] - a, axis=2).mean(axis=1) for a in antennas], axis=0
    )
    return float(ranges_m.min()), float(ranges_m.max())


def weaker_within(profile: RangeProfile, reach: tuple[float, float], period_m: float) -> np.ndarray:
    """Path lengths of the echoes, or their aliases, within a reach, strongest first.

    At most `WEAKER_DB` below the strongest of all.
    """
    kept = profile.power >= 10 ** (-WEAKER_DB / 10) * profile.power[0]
    ranges_m = profile.path_m[kept] / 2
    aliases = np.ceil((reach[0] - ranges_m) / period_m) * period_m
    within = ranges_m + aliases <= reach[1]
    return profile.path_m[kept][within]


def inside(grid: VoxelGrid, at_m: np.ndarray, margin_m: np.ndarray | float = 0.0) -> bool:
    """Whether a point is in the box of a grid's voxels, or at most a margin outside."""
    low = grid.origin_m - grid.spacing_m / 2 - margin_m
    high = low + grid.spacing_m * np.array(grid.counts) + 2 * np.asarray(margin_m)
    return bool(((at_m >= low) & (at_m <= high)).all())


def _around(capture: Capture, at_m: np.ndarray, device: Device) -> VoxelGrid:
    """The grid around an object whose strongest echo is at a point."""
    margin_m = MARGIN_RESOLUTIONS * resolution_m(capture, at_m)
    paper_m = PAPER_GRID.spacing_m * (np.array(PAPER_GRID.counts) - 1) / 2
    half_m = np.maximum(paper_m, margin_m)
    front_m = max(capture.array.tx_m[:, 2].max(), capture.array.rx_m[:, 2].max()) + 1e-3
    for _ in range(GROWTHS):
        low_m, high_m = at_m - half_m, at_m + half_m
        low_m[2] = max(low_m[2], min(front_m, at_m[2]))
        bright_m = _bright_box(coarse_image(capture, low_m, high_m, device))
        low_m = np.minimum(at_m - np.maximum(paper_m, margin_m), bright_m[0] - margin_m)
        high_m = np.maximum(at_m + np.maximum(paper_m, margin_m), bright_m[1] + margin_m)
        grown_m = np.maximum(at_m - low_m, high_m - at_m)
        if (grown_m <= half_m * (1 + 1e-9)).all():
            break
        half_m = np.maximum(half_m, np.minimum(grown_m, 1.5 * half_m))
    low_m[2] = max(low_m[2], min(front_m, at_m[2]))
    farthest_m = PLAUSIBLE_RANGE_M[1]
    low_m, high_m = (np.clip(end, -farthest_m, farthest_m) for end in (low_m, high_m))
    return _rounded(low_m, high_m, resolution_m(capture, at_m))


def _bright_box(image: CoarseImage) -> np.ndarray:
    """Least and largest coordinates of the bright voxels, shape (2, 3), metres."""
    highest = float(image.amplitude.max())
    floor = CREST * float(np.sqrt(np.mean(np.square(image.amplitude))))
    bright = image.amplitude >= max(10 ** (-BRIGHT_DB / 20) * highest, min(floor, highest))
    index = np.argwhere(bright)[:, ::-1]
    ends = np.stack([index.min(axis=0), index.max(axis=0)])
    return image.grid.origin_m + image.grid.spacing_m * ends


def _rounded(low_m: np.ndarray, high_m: np.ndarray, resolution: np.ndarray) -> VoxelGrid:
    """The grid of a box with round spacings, whose ends are multiples of 10 mm or more."""
    step_m = np.array([_round_step(r / VOXELS_PER_RESOLUTION) for r in resolution])
    while True:
        end_m = np.maximum(step_m, END_M)
        first = np.round(np.floor(low_m / end_m + END_SHARE) * end_m / step_m)
        last = np.round(np.ceil(high_m / end_m - END_SHARE) * end_m / step_m)
        counts = (last - first).astype(int) + 1
        if np.prod(counts.astype(float)) <= MOST_VOXELS:
            break
        finest = int(np.argmin(step_m / resolution))
        step_m[finest] = _round_step(2.5 * step_m[finest])
    return VoxelGrid(
        np.round(first * step_m, 9), step_m, (int(counts[0]), int(counts[1]), int(counts[2]))
    )


def _round_step(step_m: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is no larger."""
    decade = 10.0 ** np.floor(np.log10(step_m) + 1e-9)
    factor = max(f for f in (1, 2, 5) if f * decade <= step_m * (1 + 1e-9))
    return float(round(factor * decade, 12))
