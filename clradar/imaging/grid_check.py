"""Warnings about a grid that does not fit its capture: beside the echo, too small, ambiguous."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB, SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.imaging.confusions import warn_of_confusions
from clradar.imaging.echo_location import (
    FOCUS,
    Echo,
    amplitude_near,
    antennas_of,
    coarse_image,
    locate,
    resolution_m,
    seen_echoes,
)
from clradar.imaging.grid_words import box_words, length_words, place_words
from clradar.imaging.placement import inside, reach_m, weaker_within
from clradar.imaging.several_captures import Captures, KeptCaptures, captures_of
from clradar.model import Capture, VoxelGrid
from clradar.model.range_profile import RangeProfile, coupling_path_m, hann
from clradar.model.volume import Planes
from clradar.opencl import Device

OUTSIDE_DB = DYNAMIC_RANGE_DB
"""An echo outside is worth a warning if an image with it would show nothing of this grid."""

FACE_DB, BEYOND_DB = 6.0, 6.0
"""A face at most this far below the maximum is bright, and the object goes on where it is that
bright beyond the face. Side lobes are at -13 dB, shot noise of a simulation at alpha 1 at -8."""

FLOOR_DB, FLOOR_SHARE = 12.0, 0.2
"""What goes on beyond a face is this far above the darkest fifth of what is there: 15 dB and more
for halved hands of alpha 0 to 0.5, up to 10 dB for noise, which is everywhere."""

BEYOND_RESOLUTIONS = (1.0, 4.0)
"""Beyond a face, where the object would go on: past the main lobe of what is on the face."""

ALIAS_DB, ALIAS_RESOLUTIONS = 3.0, 1.33
"""An alias is as bright within this, and in the middle of a box of this half width, which a coarse
image has a voxel at."""

THIN_RESOLUTIONS = 2.0
"""An axis that is no longer than this is a slice through the object, and meant to be one."""

PLANES = 16  # of a volume whose amplitude is taken at a time


@dataclass(frozen=True, slots=True)
class Peaks:
    """Maximum of the amplitude over each plane of a volume: one array each for x, y and z."""

    along: tuple[np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def of(cls, data: Planes) -> Peaks:
        x, y = np.zeros(data.shape[2], np.float32), np.zeros(data.shape[1], np.float32)
        z = np.zeros(data.shape[0], np.float32)
        for at in range(0, len(data), PLANES):
            amplitude = np.abs(data[at : at + PLANES])
            over_z = amplitude.max(axis=0)
            z[at : at + PLANES] = amplitude.max(axis=(1, 2))
            np.maximum(x, over_z.max(axis=0), out=x)
            np.maximum(y, over_z.max(axis=1), out=y)
        return cls((x, y, z))

    @property
    def highest(self) -> float:
        return float(self.along[2].max())

    def place_m(self, grid: VoxelGrid) -> np.ndarray:
        """The brightest voxel, metres."""
        return grid.origin_m + grid.spacing_m * [int(peaks.argmax()) for peaks in self.along]


def warn_of_grid(
    capture: Capture | KeptCaptures,
    grid: VoxelGrid,
    data: Planes,
    weights: np.ndarray,
    device: Device,
) -> None:
    """Warn where an image on a grid does not show what the capture holds.

    That is: the grid reaches beyond the unambiguous range c / (2 df), and no focus tells its echoes
    from their aliases; the strongest echo lies outside, more than 15 dB above all that is in the
    grid; the object goes on beyond a face of the grid. Captures of different frequencies are not
    checked. `data` is the image as `clradar.backproject` returns it, or planes that are read;
    `weights`, (n_freq,), are those of the image.
    """
    captures = (capture,) if isinstance(capture, Capture) else tuple(capture.captures)
    arrays = [capture.array] if isinstance(capture, Capture) else capture.arrays
    waveform = captures[0].waveform
    if not all(waveform.same_frequencies(one.waveform) for one in captures):
        return
    seen = [seen_echoes(one, device) for one in captures]
    captures = tuple(one for one, _, _ in seen)
    found = [(one, profile) for one, profile, _ in seen if profile is not None]
    if not found or not weights.sum() > 0:
        return
    loudest, profile = max(found, key=lambda own: float(own[1].power[0]))
    peaks = Peaks.of(data)
    level = peaks.highest / float(weights.mean())
    faces = _faces(captures, grid, peaks)
    pairs = sum(one.array.n_tx * one.array.n_rx for one in captures)
    power = float(profile.power[0])
    unfocused = float(np.sqrt(FOCUS / pairs * power))
    reaches = np.array([reach_m(one, grid) for one in captures])
    reach = float(reaches[:, 0].min()), float(reaches[:, 1].max())
    outside = None
    cuts = [
        (face, beyond)
        for face in faces
        if face.level_db >= -FACE_DB
        and (beyond := _echo_beyond(captures, grid, face, peaks, level, power, device))
    ]
    if level < unfocused or cuts:  # what seems cut off may be the side lobes of an echo outside
        # Where the image goes on beyond the grid, less is enough, but farther off.
        away = (BEYOND_DB, BEYOND_RESOLUTIONS[1]) if cuts else (OUTSIDE_DB, 1.0)
        outside = _echo_outside(captures, grid, loudest, profile, level, away, device)
    alias = outside
    if alias is None and level >= unfocused and reach[0] > waveform.unambiguous_range_m:
        alias = _equal_alias(captures, peaks.place_m(grid), level, device)
    _warn_of_aliases(waveform.unambiguous_range_m, reach, alias)
    if outside is not None:
        _warn_of_echo(grid, outside, level)
        return
    if level >= unfocused:
        warn_of_confusions(captures, arrays, grid, peaks.place_m(grid), device)
    for face, beyond in cuts:
        _warn_of_cut(face, beyond, level)


def _echo_outside(
    captures: Sequence[Capture],
    grid: VoxelGrid,
    loudest: Capture,
    profile: RangeProfile,
    level: float,
    away: tuple[float, float],
    device: Device,
) -> Echo | None:
    """The strongest echo, if it is beside the grid and the grid has none that comes close.

    `away` is how far beside: decibel above the level in the grid, and resolutions from it. Of
    several captures the one with the strongest echo tells where it is, whose range `profile` is.
    """
    reach = reach_m(loudest, grid)
    here = weaker_within(profile, reach, loudest.waveform.unambiguous_range_m)
    if len(here) and here[0] != profile.path_m[0]:
        return None
    echo = locate(loudest, float(profile.path_m[0]), device)
    if len(captures) > 1:
        echo = Echo(echo.position_m, amplitude_near(captures, echo.position_m, device))
    louder = echo.amplitude > 10 ** (away[0] / 20) * level
    margin_m = away[1] * resolution_m(loudest, echo.position_m)
    return echo if louder and not inside(grid, echo.position_m, margin_m) else None


@dataclass(frozen=True, slots=True)
class Face:
    """One face of a grid: its axis, position, outward direction, and maximum below the volume's."""

    axis: int
    at_m: float
    outward: float
    level_db: float


def _faces(capture: Captures, grid: VoxelGrid, peaks: Peaks) -> list[Face]:
    """The faces of a grid across the axes that are not thin."""
    length_m = grid.spacing_m * (np.array(grid.counts) - 1)
    cells_m = resolution_m(capture, grid.origin_m + length_m / 2)
    found = []
    for axis in np.flatnonzero(length_m > THIN_RESOLUTIONS * cells_m).tolist():
        for end, outward in ((0, -1.0), (-1, 1.0)):
            share = float(peaks.along[axis][end]) / max(peaks.highest, 1e-30)
            at_m = float(grid.origin_m[axis] + (length_m[axis] if end else 0.0))
            found.append(Face(axis, at_m, outward, 20 * np.log10(max(share, 1e-15))))
    return found


def _warn_of_aliases(period_m: float, reach: tuple[float, float], alias: Echo | None) -> None:
    """Warn of a grid across the unambiguous range, or beyond it with an equal alias elsewhere."""
    near_m, far_m = reach
    across = near_m < period_m or far_m - near_m > period_m
    if far_m > period_m and (across or alias is not None):
        where = f", such as {place_words(alias.position_m)}" if alias is not None else ""
        warn(
            f"the grid reaches from a range of {length_words(near_m)} to {length_words(far_m)}, "
            f"beyond the unambiguous range c / (2 df) of {length_words(period_m)}: what it shows "
            f"may be aliases of echoes that are nearer or farther by multiples of that{where}; "
            "choose a grid that ends before it, or measure with smaller frequency steps"
        )


def _equal_alias(capture: Captures, at_m: np.ndarray, level: float, device: Device) -> Echo | None:
    """The alias of an image point, by one period nearer or farther, if it is as bright.

    In the near field the curvature of the wavefronts focuses the point itself alone, so that few
    frequencies are enough.
    """
    antennas_m = antennas_of(capture)
    middle_m, front_m = antennas_m.mean(axis=0), antennas_m[:, 2].max()
    range_m = float(np.linalg.norm(at_m - middle_m))
    for shift_m in captures_of(capture)[0].waveform.unambiguous_range_m * np.array([-1.0, 1.0]):
        alias_m = middle_m + (at_m - middle_m) * (range_m + shift_m) / range_m
        if alias_m[2] <= front_m:
            continue
        half_m = ALIAS_RESOLUTIONS * resolution_m(capture, alias_m)
        low_m = alias_m - half_m
        low_m[2] = max(low_m[2], front_m)
        found = coarse_image(capture, low_m, alias_m + half_m, device, np.inf).brightest()
        if found.amplitude >= 10 ** (-ALIAS_DB / 20) * level:
            return found
    return None


def _warn_of_echo(grid: VoxelGrid, echo: Echo, level: float) -> None:
    difference_db = 20 * np.log10(echo.amplitude / max(level, 1e-15 * echo.amplitude))
    warn(
        f"the strongest echo, at {place_words(echo.position_m)}, is outside the grid "
        f"({box_words(grid)}), {difference_db:.0f} dB above all that is in it; clradar.place_grid "
        "places a grid around it, as the command line does without --x-mm, --y-mm, --z-mm"
    )


def _echo_beyond(
    captures: Sequence[Capture],
    grid: VoxelGrid,
    face: Face,
    peaks: Peaks,
    level: float,
    power: float,
    device: Device,
) -> Echo | None:
    """Where the object goes on beyond a bright face; None if it does not."""
    low_m = grid.origin_m.copy()
    high_m = low_m + grid.spacing_m * (np.array(grid.counts) - 1)
    cell_m = resolution_m(captures, (low_m + high_m) / 2)[face.axis]
    beyond_m = face.at_m + face.outward * cell_m * np.array(BEYOND_RESOLUTIONS)
    low_m[face.axis], high_m[face.axis] = beyond_m.min(), beyond_m.max()
    low_m[2] = max(low_m[2], min(antennas_of(captures)[:, 2].max(), high_m[2]))
    image = coarse_image(captures, low_m, high_m, device, most_pairs=np.inf)
    found = image.brightest()
    own = found.amplitude - level * point_response(captures, peaks.place_m(grid), found.position_m)
    unfocused = float(np.sqrt(FOCUS / image.pairs * power))
    floor = np.quantile(image.amplitude.max(axis=0), FLOOR_SHARE)
    goes_on = (
        own >= max(unfocused, 10 ** (-BEYOND_DB / 20) * level)
        and found.amplitude >= 10 ** (FLOOR_DB / 20) * floor
        and all(_mean_path_m(one, found.position_m) > coupling_path_m(one) for one in captures)
    )
    return found if goes_on else None


def _warn_of_cut(face: Face, beyond: Echo, level: float) -> None:
    difference_db = 20 * np.log10(beyond.amplitude / level)
    warn(
        f"the grid cuts the object off at {'xyz'[face.axis]} = {length_words(face.at_m)}: it "
        f"goes on beyond, at {place_words(beyond.position_m)}, {difference_db:+.0f} dB against the "
        "maximum in the grid; extend the grid there"
    )


def _mean_path_m(capture: Capture, at_m: np.ndarray) -> float:
    """Length from the Tx over a place to the Rx, mean over the pairs."""
    sides = (capture.array.tx_m, capture.array.rx_m)
    return sum(float(np.linalg.norm(at_m - a, axis=1).mean()) for a in sides)


def point_response(captures: Sequence[Capture], point_m: np.ndarray, at_m: np.ndarray) -> float:
    """Amplitude at one place of the image of a point of amplitude 1 at another."""
    waveform = captures[0].waveform
    weights = hann(waveform.n_freq)
    k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    total, pairs = np.zeros(waveform.n_freq, np.complex128), 0
    for one in captures:
        sides = [
            np.linalg.norm(at_m - a, axis=1) - np.linalg.norm(point_m - a, axis=1)
            for a in (one.array.tx_m, one.array.rx_m)
        ]
        tx, rx = (np.exp(2j * np.pi * np.outer(k, side_m)).mean(axis=1) for side_m in sides)
        total += one.array.n_tx * one.array.n_rx * tx * rx
        pairs += one.array.n_tx * one.array.n_rx
    return float(abs((weights * total).sum()) / weights.sum() / pairs)
