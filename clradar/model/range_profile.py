"""Mean range profiles of captures, and the echoes that stand out in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M, SPEED_OF_LIGHT_M_PER_S
from clradar.model.capture import Capture
from clradar.model.waveform import Waveform

MIN_STEPS = 8  # fewest frequencies for a range profile
GUARD_CELLS = 2.0  # half width of the Hann window's main lobe, in cells c / span of path length
BINS_PER_CELL = 4

LOBES = 30.0
"""Of an echo, whose parabola was taken for coupling, lobes are up to 9 dB above those of Hann's
window; this is 15 dB in power."""

NEAR_PATH_M = 1.2
"""Where the waveform is ambiguous below this path length, every alias up to it is imaged."""

DETECTION_SPREADS = 6.0
"""Detection threshold in the mean range profile, standard deviations of the noise."""

PROFILE_PAIRS = 512
"""Pairs of a mean range profile, in which an echo 5 dB below the noise of a pair is detected."""

CHUNK_PAIRS = 4096


@dataclass(frozen=True, slots=True)
class RangeProfile:
    """Mean power over pairs against path length, shape (n,) both; metres and linear."""

    path_m: np.ndarray
    power: np.ndarray


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
    part = array.part(tx, rx)
    return Capture(capture.data[np.ix_(tx, rx)], part, capture.waveform)


def _drawn(n: int, m: int) -> np.ndarray:
    place = np.arange(m) + np.random.default_rng(0).random(m)
    return (place * n / m).astype(int)


def profile_transform(waveform: Waveform, weights: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """Return the matrix from frequencies to path lengths, shape (n_freq, n), complex64.

    The carrier is that of the band's centre, and the weights sum to 1: an echo of amplitude a gives
    a profile of height a.
    """
    k = (waveform.frequencies_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    phasors = np.exp(2j * np.pi * np.outer(k, path_m))
    return ((weights / weights.sum())[:, None] * phasors).astype(np.complex64)


def hann(n_freq: int) -> np.ndarray:
    """Hann's weights, whose sidelobes fall by 18 dB per octave, against coupling.

    All 1 for few frequencies, of which Hann would leave next to nothing.
    """
    return np.hanning(n_freq) if n_freq >= MIN_STEPS else np.ones(n_freq)


def range_profile(capture: Capture) -> RangeProfile:
    """Mean power of all pairs over path length, from 0 to where it repeats."""
    waveform = capture.waveform
    cell_m = SPEED_OF_LIGHT_M_PER_S / waveform.span_hz
    period_m = 2 * waveform.unambiguous_range_m
    path_m = np.linspace(0.0, period_m, max(2, int(BINS_PER_CELL * period_m / cell_m)))
    to_path = profile_transform(waveform, hann(waveform.n_freq), path_m)
    flat = capture.data.reshape(-1, waveform.n_freq)
    power = np.zeros(len(path_m))
    for at in range(0, len(flat), CHUNK_PAIRS):
        profile = flat[at : at + CHUNK_PAIRS] @ to_path
        power += (np.abs(profile) ** 2).sum(axis=0, dtype=np.float64)
    return RangeProfile(path_m, power / len(flat))


def coupling_path_m(capture: Capture) -> float:
    """Path length up to which direct coupling from Tx to Rx reaches."""
    array = capture.array
    apart = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
    return float(apart.max()) + GUARD_CELLS * SPEED_OF_LIGHT_M_PER_S / capture.waveform.span_hz


def without_coupling(capture: Capture) -> Capture:
    """Return a capture without what goes straight from Tx to Rx, by the length of every pair.

    A phasor of that length is taken away whose amplitude is a parabola over the band, as fitted
    with Hann's weights: lengths that are off by a quarter of a cell c / span, too. Of an echo whose
    path is longer by three cells 1 % of the power goes with it.
    """
    waveform, array = capture.waveform, capture.array
    apart_m = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
    k = (waveform.frequencies_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    parabolas = np.vander(2.0 * k / np.ptp(k), 3)
    root = np.sqrt(hann(waveform.n_freq))
    fit = (parabolas @ np.linalg.pinv(root[:, None] * parabolas) * root).T.astype(np.float32)
    data = np.empty_like(capture.data)
    for out, samples, row_m in zip(data, capture.data, apart_m, strict=True):
        ahead = np.exp(2j * np.pi * np.outer(row_m, k)).astype(np.complex64)
        out[...] = samples - (samples * ahead) @ fit * ahead.conj()
    return Capture(data, array, waveform, capture.meta)


def beyond_coupling(capture: Capture, profile: RangeProfile, *, near: bool = False) -> RangeProfile:
    """One period of the profile that begins where the direct coupling ends; it may be empty.

    If `near`, it begins at 0 where the period is long enough to tell that from its end.
    """
    gate_m, period_m = coupling_path_m(capture), 2 * capture.waveform.unambiguous_range_m
    # Under a wrong sign coupling is at negative lengths, which is the end of the period.
    told = period_m > NEAR_PATH_M + 2 * gate_m
    start_m, stop_m = (0.0 if near and told else gate_m), period_m + (-gate_m if told else gate_m)
    # What is farther away than any voxel can be is not looked for.
    cell_m = SPEED_OF_LIGHT_M_PER_S / capture.waveform.span_hz
    stop_m = min(stop_m, 2 * PLAUSIBLE_RANGE_M[1] - cell_m)
    step_m = profile.path_m[1]
    bins = np.arange(int(np.ceil(start_m / step_m)), int(stop_m / step_m))
    return RangeProfile(bins * step_m, profile.power[bins % (len(profile.path_m) - 1)])


def _side_lobes(profile: RangeProfile, cell_m: float) -> RangeProfile:
    """The most that Hann's side lobes leave of the whole profile at each path length.

    Their envelope x cells off is 1 / (pi x (x^2 - 1)); an echo has 1.5 cells of its maximum.
    """
    path_m = profile.path_m[:-1]
    x = np.maximum(np.minimum(path_m, profile.path_m[-1] - path_m) / cell_m, GUARD_CELLS)
    envelope = np.where(x > GUARD_CELLS, 1 / (np.pi * x * (x**2 - 1)), 0.0) ** 2
    power = np.fft.irfft(np.fft.rfft(profile.power[:-1]) * np.fft.rfft(envelope), len(path_m))
    return RangeProfile(profile.path_m, np.append(power, power[0]) / (1.5 * BINS_PER_CELL))


def echoes(capture: Capture, beyond: RangeProfile) -> np.ndarray:
    """Indices of the echoes above the noise in what is beyond the coupling, strongest first."""
    power = beyond.power
    if len(power) < 3:
        return np.empty(0, int)
    # An echo is a local maximum, unlike the skirt of the coupling.
    peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:]))
    # For noise alone every bin is a mean of one exponential variable per pair.
    pairs = capture.array.n_tx * capture.array.n_rx
    peaks = peaks[power[peaks] > (1 + DETECTION_SPREADS / np.sqrt(pairs)) * np.median(power)]
    return peaks[np.argsort(-power[peaks], kind="stable")]


def echo_profile(capture: Capture, *, near: bool = False) -> RangeProfile | None:
    """The echoes above noise and side lobes beyond the direct coupling, strongest first.

    If `near`, those at shorter paths instead, which its removal shows, or leaves of it. None
    without any, or with fewer frequencies than a range profile needs.
    """
    if capture.waveform.n_freq < MIN_STEPS:
        return None
    part = antenna_subset(capture, PROFILE_PAIRS)
    if near:
        part = without_coupling(part)
    whole = range_profile(part)
    lobes = _side_lobes(whole, SPEED_OF_LIGHT_M_PER_S / part.waveform.span_hz)
    beyond = beyond_coupling(part, whole, near=near)
    floor = (LOBES if near else 1.0) * beyond_coupling(part, lobes, near=near).power
    found = echoes(part, beyond)
    found = found[beyond.power[found] > floor[found]]
    if near:
        found = found[beyond.path_m[found] < coupling_path_m(part)]
    return RangeProfile(beyond.path_m[found], beyond.power[found]) if len(found) else None
