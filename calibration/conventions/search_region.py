"""Search region of an unknown scene: mean range profiles, then coarse voxel grids."""

from __future__ import annotations

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, VoxelGrid, Waveform
from clradar.model.range_profile import (
    MIN_STEPS,
    NEAR_PATH_M,
    RangeProfile,
    beyond_coupling,
    echoes,
)
from clradar.model.resolution import lateral_resolution_m

SCENE_POWER_SHARE = 0.1
"""Range bins within 10 dB of the strongest belong to the scene..."""

SCENE_PATH_M = 0.2
"""... if they are no farther than this path length from it."""

VIEW = 0.4
"""Half width of the field of view over the range."""

VOXELS_PER_RESOLUTION = 1.5
"""Across boresight. A peak between two voxels loses at most 1.6 dB along either axis."""

MAX_PLANES = 24
"""Along boresight, one plane per cell c / (2 span), of which the window's main lobe has four."""


def window_of(waveform: Waveform) -> str:
    """Window over frequency: Hann, whose sidelobes fall by 18 dB per octave, against coupling.

    Rectangular for few frequencies, of which Hann would leave next to nothing.
    """
    return "hann" if waveform.n_freq >= MIN_STEPS else "rect"


def scene_paths_m(capture: Capture, profile: RangeProfile) -> np.ndarray:
    """Path lengths, metres, ascending, of the strongest echo and those near it.

    Beyond the direct coupling; empty if no echo there exceeds the noise threshold.
    """
    beyond = beyond_coupling(capture, profile)
    found = echoes(capture, beyond)
    if not len(found):
        return np.empty(0)
    near = np.abs(beyond.path_m - beyond.path_m[found[0]]) <= SCENE_PATH_M
    return beyond.path_m[near & (beyond.power >= SCENE_POWER_SHARE * beyond.power[found[0]])]


def search_grids(capture: Capture, paths_m: np.ndarray) -> list[VoxelGrid]:
    """Coarse grids for echoes of these path lengths, symmetric about x = 0.

    One grid, or one for every alias where the waveform is ambiguous below `NEAR_PATH_M`.
    """
    period_m = 2 * capture.waveform.unambiguous_range_m
    aliases = 1 + max(0, int((NEAR_PATH_M - paths_m[0]) // period_m))
    return [_grid(capture, paths_m + i * period_m) for i in range(aliases)]


def _grid(capture: Capture, paths_m: np.ndarray) -> VoxelGrid:
    array, span_hz = capture.array, capture.waveform.span_hz
    range_m = float(paths_m[0] + paths_m[-1]) / 4
    antennas = np.concatenate([array.tx_m, array.rx_m])
    half_m = max(VIEW * range_m, float(np.abs(antennas[:, :2]).max()))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz)
    # The antennas are beside the voxel: half the path length exceeds the voxel's z.
    aside_m = np.hypot(half_m, np.sqrt((antennas[:, :2] ** 2).sum(axis=1).mean()))
    nearest_m = paths_m[0] / 2
    low_m = np.sqrt(max(nearest_m**2 - aside_m**2, (nearest_m / 2) ** 2)) - cell_m / 2
    high_m = paths_m[-1] / 2 + cell_m / 2
    planes = int(np.clip(np.ceil((high_m - low_m) / cell_m) + 1, 2, MAX_PLANES))
    counts, spacing_m = [], []
    for axis in (0, 1):
        step_m = lateral_resolution_m(capture, axis, range_m) / VOXELS_PER_RESOLUTION
        n = max(1, int(np.ceil(half_m / step_m)))
        counts.append(2 * n + 1)
        spacing_m.append(half_m / n)
    return VoxelGrid(
        np.array([-half_m, -half_m, low_m]),
        np.array([*spacing_m, (high_m - low_m) / (planes - 1)]),
        (counts[0], counts[1], planes),
    )
