"""Where to look for a scene of which nothing is known: range profile first, then coarse grids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.backproject import frequency_weights
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform

WINDOW = "hann"
"""Falls by 18 dB per octave, so that direct coupling does not reach into the scene."""

GUARD_CELLS = 2.0
"""Half width of the window's main lobe, in cells c / span of path length."""

BINS_PER_CELL = 4

NEAR_PATH_M = 1.2
"""Where the waveform is ambiguous below this path length, every alias up to it is looked at."""

BRIGHT = 0.1
"""Range bins within 10 dB of the strongest belong to the scene..."""

SCENE_PATH_M = 0.2
"""... if they are no farther than this path length from it."""

VIEW = 0.5
"""Half width of the field of view over the range."""

SAMPLES_PER_RESOLUTION = 2.0

MAX_PLANES = 40


@dataclass(frozen=True, slots=True)
class RangeProfile:
    """Mean power over pairs against path length, shape (n,) both; metres and linear."""

    path_m: np.ndarray
    power: np.ndarray


def thinned(capture: Capture, most_pairs: int) -> Capture:
    """Return the capture of some of the antennas, at most about `most_pairs` pairs.

    One antenna is drawn from each of equal stretches of either list, always the same ones: an even
    comb would have grating lobes. Both lists are thinned alike where they are equally long, so that
    swapped axes give the same samples.
    """
    array = capture.array
    share = min(1.0, float(np.sqrt(most_pairs / (array.n_tx * array.n_rx))))
    tx, rx = (_drawn(n, max(1, int(n * share))) for n in (array.n_tx, array.n_rx))
    if len(tx) == array.n_tx and len(rx) == array.n_rx:
        return capture
    part = AntennaArray(array.tx_m[tx], array.rx_m[rx], array.name)
    return Capture(capture.data[np.ix_(tx, rx)], part, capture.waveform)


def _drawn(n: int, m: int) -> np.ndarray:
    place = np.arange(m) + (np.random.default_rng(0).random(m) if m < n else 0.0)
    return (place * n / m).astype(int)


def range_profile(capture: Capture) -> RangeProfile:
    """Return the mean power of all pairs over path length, from 0 up to one ambiguity."""
    waveform = capture.waveform
    cell_m = SPEED_OF_LIGHT_M_PER_S / waveform.span_hz
    period_m = ambiguous_path_m(waveform)
    path_m = np.linspace(0.0, period_m, max(2, int(BINS_PER_CELL * period_m / cell_m)))
    weights = frequency_weights(WINDOW, waveform.n_freq)
    k = (waveform.frequencies_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    to_path = (weights / weights.sum())[:, None] * np.exp(2j * np.pi * np.outer(k, path_m))
    flat = capture.data.reshape(-1, waveform.n_freq)
    power = np.zeros(len(path_m))
    for at in range(0, len(flat), 4096):
        profile = flat[at : at + 4096] @ to_path.astype(np.complex64)
        power += (np.abs(profile) ** 2).sum(axis=0, dtype=np.float64)
    return RangeProfile(path_m, power / len(flat))


def ambiguous_path_m(waveform: Waveform) -> float:
    """Return the path length after which the range profile repeats."""
    return SPEED_OF_LIGHT_M_PER_S / float(np.median(np.diff(waveform.frequencies_hz)))


def coupling_path_m(capture: Capture) -> float:
    """Return the path length up to which direct coupling from Tx to Rx can be seen."""
    array = capture.array
    apart = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
    return float(apart.max()) + GUARD_CELLS * SPEED_OF_LIGHT_M_PER_S / capture.waveform.span_hz


def search_grids(capture: Capture) -> list[VoxelGrid]:
    """Return coarse grids around the strongest echo beyond the direct coupling.

    Grids are symmetric about x = 0, with two voxels per resolution cell. One grid, or several where
    the waveform is ambiguous in range; none where no path length is beyond the coupling.
    """
    profile = range_profile(capture)
    gate_m, period_m = coupling_path_m(capture), ambiguous_path_m(capture.waveform)
    # Under a wrong sign coupling shows at negative lengths, which is at the end of the period.
    stop_m = period_m - gate_m if period_m > NEAR_PATH_M + 2 * gate_m else gate_m + period_m
    bins = np.arange(
        int(np.ceil(gate_m / profile.path_m[1])), int(stop_m / profile.path_m[1])
    )
    if not len(bins):
        return []
    power = profile.power[bins % (len(profile.path_m) - 1)]
    path_m = bins * profile.path_m[1]
    top = int(power.argmax())
    near = np.abs(path_m - path_m[top]) <= SCENE_PATH_M
    bright = path_m[near & (power >= BRIGHT * power[top])]
    grids = []
    for alias in range(1 + max(0, int((NEAR_PATH_M - path_m[top]) // period_m))):
        shift = alias * period_m
        grids.append(_grid(capture, path_m[top] + shift, bright[0] + shift, bright[-1] + shift))
    return grids


def _grid(capture: Capture, middle_m: float, first_m: float, last_m: float) -> VoxelGrid:
    """Return the grid for echoes of path lengths `first_m` to `last_m`, brightest at `middle_m`."""
    array, waveform = capture.array, capture.waveform
    range_m = middle_m / 2
    antennas = np.concatenate([array.tx_m, array.rx_m])
    half_m = max(VIEW * range_m, float(np.abs(antennas[:, :2]).max()))
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * waveform.span_hz)
    # A path goes out to antennas beside the voxel: half its length is more than the voxel's z.
    aside_m = np.hypot(half_m, np.sqrt((antennas[:, :2] ** 2).sum(axis=1).mean()))
    low_m = np.sqrt(max((first_m / 2) ** 2 - aside_m**2, (first_m / 4) ** 2)) - cell_m / 2
    high_m = last_m / 2 + cell_m / 2
    planes = int(np.clip(np.ceil((high_m - low_m) / (cell_m / SAMPLES_PER_RESOLUTION)), 2, MAX_PLANES))
    counts, spacing = [], []
    for axis in (0, 1):
        step_m = min(lateral_resolution_m(capture, axis, range_m) / SAMPLES_PER_RESOLUTION, half_m)
        n = int(np.ceil(half_m / step_m))
        counts.append(2 * n + 1)
        spacing.append(half_m / n)
    origin = np.array([-half_m, -half_m, low_m])
    return VoxelGrid(
        origin,
        np.array([*spacing, (high_m - low_m) / (planes - 1)]),
        (counts[0], counts[1], planes),
    )


def lateral_resolution_m(capture: Capture, axis: int, range_m: float) -> float:
    """Return wavelength over the angles that both apertures span; infinite without aperture."""
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.center_hz
    spanned = 0.0
    for antennas in (capture.array.tx_m, capture.array.rx_m):
        ends = antennas[:, axis].min(), antennas[:, axis].max()
        spanned += float(np.diff([e / np.hypot(e, range_m) for e in ends])[0])
    return wavelength_m / spanned if spanned > 0 else float("inf")
