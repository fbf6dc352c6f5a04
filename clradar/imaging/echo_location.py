"""Where the strongest echo of a capture comes from: by range profiles, then a coarse image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.constants import FINEST_SPACING_M, PLAUSIBLE_RANGE_M, SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.range_profiles import RangeImager
from clradar.imaging.several_captures import Captures, captures_of
from clradar.model import Capture, VoxelGrid
from clradar.model.range_profile import (
    BINS_PER_CELL,
    NEAR_PATH_M,
    RangeProfile,
    antenna_subset,
    echo_profile,
    hann,
    profile_transform,
    without_coupling,
)
from clradar.model.resolution import lateral_resolution_m
from clradar.opencl import Device

VIEW_SINE = float(np.sin(np.radians(60.0)))  # directions up to this far from boresight are searched
SEARCH_PAIRS = 144  # pairs whose profiles are summed over the directions, which needs no focus
MOST_DIRECTIONS = 64  # along either sine
ALIKE, APART, MOST_DIRECTIONS_TRIED = 0.7, 0.12, 4
"""Directions with this share of the strongest sum, so far apart (radians), are imaged as well: of a
fist the strongest was 25 degrees beside it."""

VOXELS_PER_RESOLUTION = 1.5
"""Of a coarse image. A peak between two voxels loses at most 1.6 dB along either axis."""

COARSE_TERMS, COARSE_PAIRS = 1e8, 2048
"""Voxels times pairs, and pairs, of a coarse image, which is of a subset of the antennas: 0.2 s,
and side lobes of random antennas at -33 dB."""

COARSE_VOXELS = 500_000  # of a coarse image; beyond that its voxels are larger
AROUND_RESOLUTIONS = 1.33  # half of a box around a place where the image has a maximum
FOCUS = 20.0
"""The random phases of N pairs leave 1 / N of an echo's power at other places, and 10 / N at the
strongest of 20 000 (their logarithm). An image of twice that shows the echo itself: hands reach 20
times as much and more with 94 x 94 antennas at 0.3 m, and 7 to 140 times at 50 to 120 mm."""

NEAR_SHARE = 100.0
"""Where direct coupling may be, only echoes of this share of the strongest beyond count."""

MOVES = 3  # how often the coarse image is centred again on a maximum at its face


@dataclass(frozen=True, slots=True)
class Echo:
    """The brightest voxel of a coarse image: position (3,), metres, and amplitude of the echo."""

    position_m: np.ndarray
    amplitude: float


@dataclass(frozen=True, slots=True)
class CoarseImage:
    """Amplitude [z, y, x] with Hann's weights over frequency, of which an echo has its own.

    `pairs` is the number of pairs that it is the mean of.
    """

    grid: VoxelGrid
    amplitude: np.ndarray
    pairs: int

    def brightest(self) -> Echo:
        """The maximum: its place refined by the parabolas through its neighbours."""
        at = np.unravel_index(int(self.amplitude.argmax()), self.amplitude.shape)
        shift = np.zeros(3)
        for axis in range(3):
            line = self.amplitude[tuple(slice(None) if i == axis else at[i] for i in range(3))]
            if 0 < at[axis] < len(line) - 1:
                before, peak, after = (float(v) for v in line[at[axis] - 1 : at[axis] + 2])
                curvature = before - 2 * peak + after
                shift[axis] = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
        place = self.grid.origin_m + self.grid.spacing_m * (np.array(at) + shift)[::-1]
        return Echo(place, float(self.amplitude[at]))


def coarse_image(
    capture: Captures,
    low_m: np.ndarray,
    high_m: np.ndarray,
    device: Device,
    most_pairs: float = COARSE_PAIRS,
) -> CoarseImage:
    """Image a box with voxels of two thirds of the resolution, from a subset of the antennas."""
    low_m, high_m = (
        np.clip(end, -PLAUSIBLE_RANGE_M[1], PLAUSIBLE_RANGE_M[1]) for end in (low_m, high_m)
    )
    extent_m = high_m - low_m
    extent_m[extent_m < FINEST_SPACING_M] = 0.0  # ends that differ by rounding are one slice
    fine_m = resolution_m(capture, (low_m + high_m) / 2) / VOXELS_PER_RESOLUTION
    intervals = extent_m / np.maximum(fine_m, FINEST_SPACING_M)
    intervals = np.where(extent_m > 0, np.maximum(intervals, 1.0), 0.0)
    larger = np.cbrt(np.prod(intervals + 1) / COARSE_VOXELS)
    counts = np.ceil(intervals / max(1.0, larger)).astype(int) + 1
    spacing_m = np.where(extent_m > 0, extent_m, FINEST_SPACING_M) / np.maximum(counts - 1, 1)
    grid = VoxelGrid(low_m, spacing_m, (int(counts[0]), int(counts[1]), int(counts[2])))
    captures = captures_of(capture)
    pairs_each = min(most_pairs, COARSE_TERMS / np.prod(counts)) / len(captures)
    weights = hann(captures[0].waveform.n_freq)
    data, pairs = np.zeros(grid.shape, np.complex64), 0
    for one in captures:
        part = antenna_subset(one, pairs_each)
        data += RangeImager(part, grid, weights, device).run(None)
        pairs += part.array.n_tx * part.array.n_rx
    return CoarseImage(grid, np.abs(data) / np.float32(pairs * weights.sum()), pairs)


def amplitude_near(capture: Captures, at_m: np.ndarray, device: Device) -> float:
    """Of the image at the maximum next to a place."""
    antennas_m = antennas_of(capture)
    half_m = AROUND_RESOLUTIONS * resolution_m(capture, at_m)
    low_m = at_m - half_m
    low_m[2] = max(low_m[2], min(antennas_m[:, 2].max() + 1e-3, at_m[2]))
    around = coarse_image(capture, low_m, at_m + half_m, device, np.inf).brightest()
    exact = coarse_image(capture, around.position_m, around.position_m, device, np.inf)
    return max(around.amplitude, float(exact.amplitude.max()))


def antennas_of(capture: Captures) -> np.ndarray:
    """Positions of all Tx and Rx, shape (n, 3), metres."""
    return np.concatenate(
        [at for one in captures_of(capture) for at in (one.array.tx_m, one.array.rx_m)]
    )


def resolution_m(capture: Captures, at_m: np.ndarray) -> np.ndarray:
    """Distance between peak and first zero of a point's image along x, y, z, shape (3,), metres."""
    range_m = float(np.linalg.norm(at_m - antennas_of(capture).mean(axis=0)))
    cell_m = captures_of(capture)[0].waveform.range_resolution_m
    across = [lateral_resolution_m(captures_of(capture), axis, range_m) for axis in (0, 1)]
    # Without aperture along an axis its image is a stripe, whose length does not matter.
    return np.minimum(np.array([*across, cell_m]), range_m)


def flat_axes(capture: Capture) -> np.ndarray:
    """The axes without aperture, shape (3,), bool: there is no telling where an echo is on them.

    It is looked for in the plane of the antennas.
    """
    return np.array([*(np.isinf(lateral_resolution_m(capture, a, 1.0)) for a in (0, 1)), False])


def seen_echoes(capture: Capture, device: Device) -> tuple[Capture, RangeProfile | None, bool]:
    """The echoes of a capture (`echo_profile`), the capture to locate them in, if they are sure.

    What is where direct coupling may be counts as echoes if it focuses without that coupling, and,
    without being sure, if there is nothing beyond.
    """
    far, near = echo_profile(capture), echo_profile(capture, near=True)
    weak = near is not None and far is not None and near.power[0] < far.power[0] / NEAR_SHARE
    if near is None or weak:
        return capture, far, True
    own = without_coupling(capture)
    echo = locate(own, float(near.path_m[0]), device)
    # The place was the brightest for as many pairs as a coarse image has, by chance at least.
    pairs = capture.array.n_tx * capture.array.n_rx
    unfocused = FOCUS * min(1.0, COARSE_PAIRS / pairs) * near.power[0] / pairs
    sure = bool(amplitude_near(own, echo.position_m, device) ** 2 >= unfocused)
    if far is None:
        return own, near, sure
    if not sure:
        return capture, far, True
    path_m, power = (
        np.concatenate(v) for v in ((near.path_m, far.path_m), (near.power, far.power))
    )
    order = np.argsort(-power, kind="stable")
    return own, RangeProfile(path_m[order], power[order]), True


def locate(capture: Capture, path_m: float, device: Device) -> Echo:
    """Locate the echo of a path length in the mean range profile, or of its aliases up to 1.2 m."""
    period_m = 2 * capture.waveform.unambiguous_range_m
    aliases = 1 + max(0, int((NEAR_PATH_M - path_m) // period_m))
    found = [_located(capture, (path_m + i * period_m) / 2, device) for i in range(aliases)]
    return max(found, key=lambda echo: echo.amplitude)


def _located(capture: Capture, range_m: float, device: Device) -> Echo:
    places_m, step = _directions(capture, range_m)
    found = [_located_about(capture, at_m, step, range_m, device) for at_m in places_m]
    return max(found, key=lambda echo: echo.amplitude)


def _located_about(
    capture: Capture, centre_m: np.ndarray, step: float, range_m: float, device: Device
) -> Echo:
    cell_m = capture.waveform.range_resolution_m
    antennas = np.concatenate([capture.array.tx_m, capture.array.rx_m])
    forward_m = centre_m - antennas.mean(axis=0)
    aside_m = np.maximum(1.5 * step * range_m, 3 * resolution_m(capture, centre_m)[:2])
    # Off boresight the shell of one range is tilted against the planes of the image.
    slope = np.linalg.norm(forward_m[:2]) / forward_m[2]
    deep_m = 2 * cell_m + min(slope * float(aside_m.max()), range_m / 2)
    half_m = np.where(flat_axes(capture), 0.0, [*aside_m, deep_m])
    nearest_m = antennas[:, 2].max() + 1e-3
    for _ in range(MOVES + 1):
        low_m, high_m = centre_m - half_m, centre_m + half_m
        low_m[2] = max(low_m[2], min(nearest_m, centre_m[2]))
        found = coarse_image(capture, low_m, high_m, device).brightest()
        inner = np.abs(found.position_m - centre_m) <= 0.9 * half_m
        if inner.all():
            break
        centre_m = found.position_m
    return found


def _directions(capture: Capture, range_m: float) -> tuple[list[np.ndarray], float]:
    """The points of the strongest incoherent sums of profiles, and the step of the sines tried.

    The path lengths of the pairs alone tell the direction, so no focus can be missed.
    """
    part = antenna_subset(capture, SEARCH_PAIRS)
    array, waveform = part.array, part.waveform
    antennas = np.concatenate([array.tx_m, array.rx_m])
    sides_m = [np.ptp(a[:, :2], axis=0).max() for a in (array.tx_m, array.rx_m)]
    cell_m = 2 * waveform.range_resolution_m
    half_step = 0.5 * cell_m / max(sum(sides_m), 1e-9)
    count = min(int(VIEW_SINE / half_step), MOST_DIRECTIONS // 2)
    step = VIEW_SINE / max(count, 1)
    sines = step * np.arange(-count, count + 1)
    sx, sy = (
        s.ravel()
        for s in np.meshgrid(*(np.zeros(1) if flat else sines for flat in flat_axes(part)[:2]))
    )
    seen = sx**2 + sy**2 <= VIEW_SINE**2 + 1e-9
    sx, sy = sx[seen], sy[seen]
    unit = np.stack([sx, sy, np.sqrt(1 - sx**2 - sy**2)], axis=1)
    middle_m = antennas.mean(axis=0)
    # Off boresight one path length is the mean of none of the pairs: it may be that of any.
    spread_m = sum(sides_m) / 2 * VIEW_SINE
    shifts_m = np.arange(-np.ceil(2 * spread_m / cell_m), np.ceil(2 * spread_m / cell_m) + 1)
    shifts_m = shifts_m * cell_m / 2
    power, bins_per_m = _profiles(part)
    scores, places_m = [], []
    for shift_m in shifts_m[range_m + shifts_m > range_m / 2]:
        points_m = middle_m + unit * (range_m + shift_m)
        to_tx, to_rx = (
            np.linalg.norm(points_m[:, None] - a, axis=2) for a in (array.tx_m, array.rx_m)
        )
        at = ((to_tx[:, :, None] + to_rx[:, None]) * bins_per_m + 0.5).astype(np.int64)
        at %= power.shape[1]
        scores.append(np.take_along_axis(power, at.reshape(len(at), -1).T, axis=1).sum(axis=0))
        places_m.append(points_m)
    score, at_m = np.concatenate(scores), np.concatenate(places_m)
    order = np.argsort(-score, kind="stable")
    left = at_m[order[score[order] >= ALIKE * score[order[0]]]]
    found: list[np.ndarray] = []
    while len(left) and len(found) < MOST_DIRECTIONS_TRIED:
        found.append(left[0])
        left = left[np.linalg.norm(left - left[0], axis=1) > APART * range_m]
    return found, step


def _profiles(capture: Capture) -> tuple[np.ndarray, float]:
    """Power over path length of every pair, one period, shape (pairs, n), and bins per metre."""
    waveform = capture.waveform
    period_m = 2 * waveform.unambiguous_range_m
    count = max(2, round(BINS_PER_CELL * period_m * waveform.span_hz / SPEED_OF_LIGHT_M_PER_S))
    path_m = np.arange(count) * period_m / count
    to_path = profile_transform(waveform, hann(waveform.n_freq), path_m)
    profiles = capture.data.reshape(-1, waveform.n_freq) @ to_path
    return np.abs(profiles) ** 2, count / period_m
