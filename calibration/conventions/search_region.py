"""Search region of an unknown scene: mean range profiles, then coarse voxel grids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.backproject import frequency_weights
from clradar.constants import PLAUSIBLE_RANGE_M, SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform

MIN_STEPS = 8
"""Fewest frequencies for a range profile."""

GUARD_CELLS = 2.0
"""Half width of the window's main lobe, in cells c / span of path length."""

BINS_PER_CELL = 4

NEAR_PATH_M = 1.2
"""Where the waveform is ambiguous below this path length, every alias up to it is imaged."""

SCENE_POWER_SHARE = 0.1
"""Range bins within 10 dB of the strongest belong to the scene..."""

SCENE_PATH_M = 0.2
"""... if they are no farther than this path length from it."""

DETECTION_SPREADS = 6.0
"""Detection threshold in the mean range profile, standard deviations of the noise."""

VIEW = 0.4
"""Half width of the field of view over the range."""

VOXELS_PER_RESOLUTION = 1.5
"""Across boresight. A peak between two voxels loses at most 1.6 dB along either axis."""

MAX_PLANES = 24
"""Along boresight, one plane per cell c / (2 span), of which the window's main lobe has four."""

CHUNK_PAIRS = 4096


@dataclass(frozen=True, slots=True)
class RangeProfile:
    """Mean power over pairs against path length, shape (n,) both; metres and linear."""

    path_m: np.ndarray
    power: np.ndarray


def window_of(waveform: Waveform) -> str:
    """Window over frequency: Hann, whose sidelobes fall by 18 dB per octave, against coupling.

    Rectangular for few frequencies, of which Hann would leave next to nothing.
    """
    return "hann" if waveform.n_freq >= MIN_STEPS else "rect"


def antenna_subset(capture: Capture, most_pairs: float) -> Capture:
    """Keep some of the antennas, about `most_pairs` pairs at most.

    One antenna is drawn from each of equal stretches of either list, always the same ones: regular
    decimation would have grating lobes. Lists of equal length get the same indices, so that swapped
    axes keep the same samples.
    """
    array = capture.array
    share = float(np.sqrt(most_pairs / (array.n_tx * array.n_rx)))
    if share >= 1:
        return capture
    tx, rx = (_drawn(n, max(1, int(n * share))) for n in (array.n_tx, array.n_rx))
    part = AntennaArray(array.tx_m[tx], array.rx_m[rx], array.name)
    return Capture(capture.data[np.ix_(tx, rx)], part, capture.waveform)


def _drawn(n: int, m: int) -> np.ndarray:
    place = np.arange(m) + np.random.default_rng(0).random(m)
    return (place * n / m).astype(int)


def range_profile(capture: Capture) -> RangeProfile:
    """Mean power of all pairs over path length, from 0 to the ambiguous path length."""
    waveform = capture.waveform
    cell_m = SPEED_OF_LIGHT_M_PER_S / waveform.span_hz
    period_m = ambiguous_path_m(waveform)
    path_m = np.linspace(0.0, period_m, max(2, int(BINS_PER_CELL * period_m / cell_m)))
    weights = frequency_weights(window_of(waveform), waveform.n_freq)
    k = (waveform.frequencies_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    to_path = (weights / weights.sum())[:, None] * np.exp(2j * np.pi * np.outer(k, path_m))
    flat = capture.data.reshape(-1, waveform.n_freq)
    power = np.zeros(len(path_m))
    for at in range(0, len(flat), CHUNK_PAIRS):
        profile = flat[at : at + CHUNK_PAIRS] @ to_path.astype(np.complex64)
        power += (np.abs(profile) ** 2).sum(axis=0, dtype=np.float64)
    return RangeProfile(path_m, power / len(flat))


def ambiguous_path_m(waveform: Waveform) -> float:
    """Path length after which the range profile repeats.

    For uneven steps, which do not repeat: that of the median step, or of a quarter of the mean.
    """
    mean_hz = waveform.span_hz / (waveform.n_freq - 1)
    median_hz = float(np.median(np.diff(waveform.frequencies_hz)))
    return SPEED_OF_LIGHT_M_PER_S / max(median_hz, mean_hz / 4)


def coupling_path_m(capture: Capture) -> float:
    """Path length up to which direct coupling from Tx to Rx reaches."""
    array = capture.array
    apart = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
    return float(apart.max()) + GUARD_CELLS * SPEED_OF_LIGHT_M_PER_S / capture.waveform.span_hz


def scene_paths_m(capture: Capture, profile: RangeProfile) -> np.ndarray:
    """Path lengths, metres, ascending, of the strongest echo and those near it.

    Beyond the direct coupling; empty if no echo there exceeds the noise threshold.
    """
    gate_m, period_m = coupling_path_m(capture), ambiguous_path_m(capture.waveform)
    # Under a wrong sign coupling is at negative lengths, which is the end of the period.
    stop_m = period_m - gate_m if period_m > NEAR_PATH_M + 2 * gate_m else gate_m + period_m
    # What is farther away than any voxel can be is not looked for.
    cell_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.span_hz
    stop_m = min(stop_m, 2 * PLAUSIBLE_RANGE_M[1] - cell_m)
    step_m = profile.path_m[1]
    bins = np.arange(int(np.ceil(gate_m / step_m)), int(stop_m / step_m))
    if len(bins) < 3:
        return np.empty(0)
    power = profile.power[bins % (len(profile.path_m) - 1)]
    # An echo is a local maximum, unlike the skirt of the coupling.
    peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:]))
    if not len(peaks):
        return np.empty(0)
    top = peaks[power[peaks].argmax()]
    # For noise alone every bin is a mean of one exponential variable per pair.
    pairs = capture.array.n_tx * capture.array.n_rx
    if power[top] <= (1 + DETECTION_SPREADS / np.sqrt(pairs)) * np.median(power):
        return np.empty(0)
    near = np.abs(bins - bins[top]) * step_m <= SCENE_PATH_M
    return bins[near & (power >= SCENE_POWER_SHARE * power[top])] * step_m


def search_grids(capture: Capture, paths_m: np.ndarray) -> list[VoxelGrid]:
    """Coarse grids for echoes of these path lengths, symmetric about x = 0.

    One grid, or one for every alias where the waveform is ambiguous below `NEAR_PATH_M`.
    """
    period_m = ambiguous_path_m(capture.waveform)
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


def lateral_resolution_m(capture: Capture, axis: int, range_m: float) -> float:
    """Wavelength over the sines that both apertures span, metres; infinite without aperture."""
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.center_hz
    spanned = 0.0
    for antennas in (capture.array.tx_m, capture.array.rx_m):
        ends = antennas[:, axis].min(), antennas[:, axis].max()
        spanned += float(
            ends[1] / np.hypot(ends[1], range_m) - ends[0] / np.hypot(ends[0], range_m)
        )
    return wavelength_m / spanned if spanned > 0 else float("inf")
