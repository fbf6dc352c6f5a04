"""Voxel grids for captures of which none is given: around the echoes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import warn
from clradar.imaging.echo_location import Echo, locate, resolution_m, seen_echoes
from clradar.imaging.grid_words import box_words, length_words, lengths_words, place_words
from clradar.imaging.object_box import (
    LESS_ROUND,
    PAPER_GRID,
    box_around,
    hand_box,
    round_step,
    rounded,
    spanned,
)
from clradar.model import Capture, VoxelGrid, checks
from clradar.model.range_profile import MIN_STEPS, RangeProfile, coupling_path_m
from clradar.opencl import Device, open_device

WEAKER_DB = 20.0
"""An echo in the paper's grid (or in one that was given) is the object even where another is
stronger by up to this: a wall behind a hand."""

ALSO_DB = DYNAMIC_RANGE_DB
"""Other bodies are echoes at most this far below the strongest: what a picture shows."""

NAMED_DB = 25.0
"""Echoes at most this far below the strongest are named, or taken in where all are asked for. Range
side lobes are at -31 dB."""

MOST_BODIES = 4
MOST_TRIED = 8  # maxima of the range profile that are located in search of other bodies
FEWEST_PER_RESOLUTION = 2.0
"""Of a grid around several bodies. With more voxels than `MOST_VOXELS` it shows fewer of them."""


@dataclass(frozen=True, slots=True)
class Placement:
    """A grid that was placed."""

    grid: VoxelGrid
    shown: tuple[Echo, ...]  # that it was placed around, strongest first; or none
    left_out: tuple[Echo, ...]  # others of `NAMED_DB`, not in it


def place_grid(
    capture: Capture, *, everything: bool = False, device: Device | str | None = None
) -> VoxelGrid:
    """Return a voxel grid for the object, or the objects, in a capture (docs/conventions.md).

    It is that of the paper, x and y from -100 to 100 mm and z from 260 to 340 mm every 1 mm, if an
    echo in it is at most 20 dB below the strongest, or nothing is seen above the noise; else one
    around the strongest echo beyond the direct coupling and others up to 15 dB below it. An axis
    without aperture has one voxel.

    Parameters
    ----------
    capture : Capture
    everything : bool
        Not the paper's grid, but one around all echoes up to 25 dB below the strongest.
    device
        See `clradar.open_device`.

    Notes
    -----
    The mean range profile over pairs gives the ranges. The direction of each is that in which the
    profiles add up without their phases; a coarse image there gives the position. The paper's grid
    fits where its voxels are at most half of the resolution at its middle, and it is at least twice
    as large as the resolution, along every axis.

    Examples
    --------
    >>> array = clradar.arrays.qar50().part(slice(None, None, 3), slice(None, None, 3))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    >>> capture = clradar.room_capture(array, waveform, [], points_m=[[0, 0, 1.5]])
    >>> clradar.place_grid(capture).counts
    (41, 41, 51)
    """
    checks.instance("place_grid: capture", capture, Capture)
    return placement(capture, open_device(device), everything=everything).grid


def placement(capture: Capture, device: Device, *, everything: bool = False) -> Placement:
    """Place a grid, see `place_grid`, and say around which echoes."""
    strongest_sample = float(np.abs(capture.data).max())
    if strongest_sample > 0 and not 1e-12 < strongest_sample < 1e12:
        # Squares of such samples leave the range of float32; where echoes are has no scale.
        capture = replace(capture, data=capture.data / np.float32(strongest_sample))
    capture, profile, sure = seen_echoes(capture, device)
    if profile is None:
        _warn_of_nothing(capture)
        return Placement(PAPER_GRID, (), ())
    if not sure:
        warn(
            "the only echoes are nearer than half the distance of Tx and Rx and the resolution, "
            f"{1e3 * coupling_path_m(capture) / 2:.0f} mm, and may be direct coupling; give a grid "
            "(--z-mm) if the one that is placed is not around the object"
        )
    fits = paper_grid_fits(capture)
    if fits and not everything:
        here = weaker_within(
            profile, reach_m(capture, PAPER_GRID), capture.waveform.unambiguous_range_m
        )
        for path_m in [*here[:1], profile.path_m[0]]:
            echo = locate(capture, float(path_m), device)
            if inside(PAPER_GRID, echo.position_m):
                power = float(profile.power[profile.path_m == path_m][0])
                grid = hand_box(capture, echo, power, device)
                others = _bodies(capture, profile, [(echo, grid)], device)[1:]
                return Placement(grid, (echo,), tuple(other for other, _ in others))
    strongest = locate(capture, float(profile.path_m[0]), device)
    (x_m, y_m, z_m), paper_m = strongest.position_m, PAPER_GRID.origin_m[2]
    if fits and z_m < paper_m and inside(PAPER_GRID, np.array([x_m, y_m, paper_m])):
        box = hand_box(capture, strongest, float(profile.power[0]), device)
    else:
        box = box_around(capture, strongest, device)
    bodies = _bodies(capture, profile, [(strongest, box)], device)
    return _around_all(capture, bodies, NAMED_DB if everything else ALSO_DB)


def placement_words(capture: Capture, placed: Placement) -> str:
    """Say in one line which grid was placed around at least one echo, and why that one."""
    first, grid = placed.shown[0], placed.grid
    around = "; ".join(place_words(echo.position_m) for echo in placed.shown)
    counts = " x ".join(map(str, grid.counts))
    spacing_m, cells_m = grid.spacing_m, resolution_m(capture, first.position_m)
    hand = np.array_equal(spacing_m, PAPER_GRID.spacing_m) and inside(PAPER_GRID, first.position_m)
    extended = "" if grid is PAPER_GRID else ", extended"
    words = (
        f"that of a hand at 0.3 m{extended}, since the strongest echo in it is at {around}"
        if hand
        else f"placed around the strongest echo, at {around}"
        if len(placed.shown) == 1
        else f"placed around {len(placed.shown)} echoes, at {around}"
    )
    words += (
        f": {counts} voxels of {lengths_words(spacing_m)} ({box_words(grid)}), resolution "
        f"{lengths_words(cells_m)}, range unambiguous to "
        f"{length_words(capture.waveform.unambiguous_range_m)}"
    )
    if placed.left_out:
        levels_db = [20 * np.log10(e.amplitude / first.amplitude) for e in placed.left_out]
        words += "; not in it: " + "; ".join(
            f"{place_words(echo.position_m)} ({level_db:+.0f} dB)"
            for echo, level_db in zip(placed.left_out, levels_db, strict=True)
        )
    return words


def paper_grid_fits(capture: Capture) -> bool:
    """Whether the paper's grid is neither too coarse nor too small for a capture's resolution."""
    extent_m = PAPER_GRID.spacing_m * (np.array(PAPER_GRID.counts) - 1)
    cells_m = resolution_m(capture, PAPER_GRID.origin_m + extent_m / 2)
    return bool(((2 * PAPER_GRID.spacing_m <= cells_m) & (2 * cells_m <= extent_m)).all())


def _warn_of_nothing(capture: Capture) -> None:
    if not capture.data.any():
        return  # said of the image
    x, y, z = (1e3 * axis[[0, -1]] for axis in (PAPER_GRID.x_m, PAPER_GRID.y_m, PAPER_GRID.z_m))
    if (count := capture.waveform.n_freq) < MIN_STEPS:  # of which one has no resolution in range
        several = "frequencies are" if count > 1 else "frequency is"
        why = f"{count} {several} too few for a range profile, which {MIN_STEPS} are enough for"
    else:
        why = (
            "no echo stands out of the noise beyond the direct coupling (which may hide what is "
            f"nearer than {1e3 * coupling_path_m(capture) / 2:.0f} mm)"
        )
    warn(
        f"{why}: there is nothing to place a grid around, and the one of a hand is taken (x "
        f"{x[0]:g} to {x[1]:g}, y {y[0]:g} to {y[1]:g}, z {z[0]:g} to {z[1]:g} mm); give one "
        "(--x-mm, --y-mm, --z-mm) if you know where to look"
    )


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


def _bodies(
    capture: Capture,
    profile: RangeProfile,
    found: list[tuple[Echo, VoxelGrid]],
    device: Device,
) -> list[tuple[Echo, VoxelGrid]]:
    """The bodies found, and others at other ranges, each with a grid around it."""
    cell_m = capture.waveform.range_resolution_m
    period_m, tried = capture.waveform.unambiguous_range_m, 0
    strong = profile.power >= 10 ** (-NAMED_DB / 10) * profile.power[0]
    for path_m in profile.path_m[strong]:
        reaches = [reach_m(capture, box) for _, box in found]
        if any((path_m / 2 - near + cell_m) % period_m <= far - near + 2 * cell_m
               for near, far in reaches):  # fmt: skip
            continue
        echo = locate(capture, float(path_m), device)
        bright = echo.amplitude >= 10 ** (-NAMED_DB / 20) * max(e.amplitude for e, _ in found)
        if bright and not any(inside(box, echo.position_m) for _, box in found):
            found = [*found, (echo, box_around(capture, echo, device))]
        tried += 1
        if tried == MOST_TRIED or len(found) == MOST_BODIES:
            break
    return found


def _around_all(
    capture: Capture, bodies: list[tuple[Echo, VoxelGrid]], least_db: float
) -> Placement:
    """The grid around as many bodies as it can hold, strongest first, down to a level."""
    bodies = sorted(bodies, key=lambda body: -body[0].amplitude)
    echoes, boxes = zip(*bodies, strict=True)
    floor = 10 ** (-least_db / 20) * echoes[0].amplitude
    for count in range(sum(echo.amplitude >= floor for echo in echoes), 1, -1):
        ends = [
            (box.origin_m, box.origin_m + box.spacing_m * (np.array(box.counts) - 1))
            for box in boxes[:count]
        ]
        low_m, high_m = np.min([low for low, _ in ends], 0), np.max([high for _, high in ends], 0)
        finest_m = np.min([resolution_m(capture, e.position_m) for e in echoes[:count]], axis=0)
        grid: VoxelGrid | None = rounded(capture, low_m, high_m, finest_m)
        if grid is not None and (FEWEST_PER_RESOLUTION * grid.spacing_m > finest_m).any():
            step_m = [round_step(cell / FEWEST_PER_RESOLUTION, LESS_ROUND) for cell in finest_m]
            grid = spanned(capture, low_m, high_m, np.array(step_m))
        if grid is not None:
            return Placement(grid, echoes[:count], echoes[count:])
    return Placement(boxes[0], echoes[:1], echoes[1:])
