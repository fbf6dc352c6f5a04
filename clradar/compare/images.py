"""Two images on the same pixels: their depth maps, where these disagree, objects of one alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks

SAME_PIXEL_TOLERANCE_M = 1e-7  # between centres of one pixel, as in `VoxelGrid.same_voxels`

NEAR_M = 6e-3
"""Distance across boresight within which an object of the other image is the same one, metres:
simulated hands that were moved by up to 5 mm are displaced, not missing."""

NEAR_DEPTH_M = 10e-3  # the same along z: closer than the resolution of 13.5 mm they are one

WEAKER_DB = 12.0
"""A bright pixel is unmatched where the other image is this much weaker everywhere near it.

In the worst hundredth of an image's energy noise of 20 dB, another seed, alpha 0.3 against 0.6 and
shifts of up to 5 mm reach 8.3 dB; a missing ball leaves 17 dB and more.
"""

LEAST_SHARE = 0.01  # unmatched pixels with less of their image's energy than this are no object
BACKGROUND_DB = 8.0
"""An object is this much stronger than the median amplitude of its image's maximum projection: of
the maxima of 81 layers of noise no pixel in a million is, of a single layer one in 80."""

MOST_DB = 60.0  # differences are cut here: an amplitude of 0 has no level
RINGS = 6  # pixels are tried at up to this many distances to each side, however fine the pixels are


@dataclass(frozen=True, slots=True)
class UnmatchedObject:
    """A bright part of one image that is missing from another.

    `position_m` is that of its brightest point, `share` its part of the energy of its image within
    the dynamic range, `level_db` its maximum relative to that of its image, and `weaker_db` how
    much weaker the other image is near the brightest point, at most 60.
    """

    position_m: tuple[float, float, float]
    share: float
    level_db: float
    weaker_db: float

    def __str__(self) -> str:
        place = ", ".join(f"{round(1e3 * value)}" for value in self.position_m)
        kind = "the brightest object" if self.level_db == 0 else "an object"
        return f"{kind}, at ({place}) mm with {100 * self.share:.0f} % of the energy"


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """Where a measured and a simulated image disagree.

    `level_db`, shape (n_y, n_x), is above 0 where the measurement is stronger than all of the
    simulation near the pixel, below 0 the other way round, in [-60, 60]; NaN where neither is
    within the dynamic range. `gain_db` is what the simulation is raised by before levels are
    compared. `missing` and `surplus` are the bright objects of one image alone, the largest share
    first.
    """

    level_db: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    gain_db: float
    missing: tuple[UnmatchedObject, ...]
    surplus: tuple[UnmatchedObject, ...]


def depth_map_of(image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthMap:
    """Return the depth map of an image, cut (again) at `dynamic_range_db`; errors name `label`."""
    if isinstance(image, Volume):
        image = image.depth_map(dynamic_range_db)
    elif not isinstance(image, DepthMap):
        raise CompareError(f"{label}: expected a Volume or a DepthMap, got {type(image).__name__}")
    peak = image.amplitude.max()
    if peak <= 0:
        raise CompareError(f"{label}: expected an amplitude above 0 somewhere, got 0 everywhere")
    if image.dynamic_range_db < dynamic_range_db:
        raise CompareError(
            f"{label}: expected depths down to {dynamic_range_db:g} dB below the maximum, got a "
            f"depth map that was cut at {image.dynamic_range_db:g} dB"
        )
    # The same expression as in Volume.depth_map, so that both cuts agree to the pixel.
    threshold = peak * 10.0 ** (-dynamic_range_db / 20.0)
    kept = image.mask & (image.amplitude >= threshold) & (image.amplitude > 0)
    if not kept.any():
        raise CompareError(
            f"{label}: expected a depth somewhere within {dynamic_range_db:g} dB of the maximum, "
            "got none"
        )
    depth_m = np.where(kept, image.depth_m, np.nan)
    return DepthMap(depth_m, image.amplitude, image.x_m, image.y_m, dynamic_range_db)


def clipped_db(image: DepthMap) -> np.ndarray:
    """Return the amplitude in dB relative to its maximum (above 0), clipped at the range."""
    amplitude = image.amplitude.astype(np.float64)
    floor = 10.0 ** (-image.dynamic_range_db / 20.0)
    # Clipped before the logarithm, which has no value at 0, and after it, because of its rounding.
    level_db = 20.0 * np.log10(np.maximum(amplitude / amplitude.max(), floor))
    return np.clip(level_db, -image.dynamic_range_db, 0.0)


def cut_pair(
    name: str,
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    dynamic_range_db: float,
) -> tuple[DepthMap, DepthMap]:
    """Return the depth maps of two images on the same pixels; errors of the range have `name`."""
    dynamic_range_db = checks.dynamic_range(f"{name}: dynamic_range_db", dynamic_range_db)
    first = depth_map_of(measured, dynamic_range_db, "measured image")
    second = depth_map_of(simulated, dynamic_range_db, "simulated image")
    check_same_pixels(first, second)
    return first, second


def check_same_pixels(measured: DepthMap, simulated: DepthMap) -> None:
    pairs = ((measured.x_m, simulated.x_m), (measured.y_m, simulated.y_m))
    if all(len(a) == len(b) and np.abs(a - b).max() <= SAME_PIXEL_TOLERANCE_M for a, b in pairs):
        return
    got = []
    for image in (measured, simulated):
        axes = zip("xy", (image.x_m, image.y_m), strict=True)
        # Nine digits show any difference beyond the tolerance.
        texts = (f"{n} = {1e3 * m[0]:.9g} to {1e3 * m[-1]:.9g} mm in {len(m)}" for n, m in axes)
        got.append(", ".join(texts))
    raise CompareError(
        "compare: expected both images on the same pixels along x and y, got "
        f"({got[0]}) measured and ({got[1]}) simulated; form both on one grid"
    )


def disagreement(measured: DepthMap, simulated: DepthMap) -> Disagreement:
    """Return where two depth maps of `cut_pair` disagree, pixel by pixel and by objects.

    Near a pixel are those within 6 mm of it across boresight whose depth differs by at most 10 mm
    or is unknown. With A the amplitude of a pixel and B the largest of the other image near it, the
    difference is 20 log10(A / B), not below 0.

    Both images are relative to their own maximum, so the level of the simulation is off by that of
    its brightest object, which the measurement may lack. The gain that corrects it is the median of
    M / B over the measured pixels, weighted with B^2: M and B are the largest amplitudes near the
    pixel in the measurement and in the simulation, B within the simulation's dynamic range. An
    object that is missing has no weight there, and one that is surplus is not a measured pixel.
    """
    check_same_pixels(measured, simulated)
    first, second = (
        image.amplitude.astype(np.float64) / float(image.amplitude.max())
        for image in (measured, simulated)
    )
    seen = np.where(simulated.mask, second, 0.0)
    near, seen_near, simulated_near = _strongest_near(
        measured, [(first, measured), (seen, simulated), (second, simulated)]
    )
    common = seen_near > 0
    ratios, weights = near[common] / seen_near[common], seen_near[common] ** 2
    gain = weighted_quantile(ratios, weights, 0.5) if common.any() else 1.0
    ours = _excess_db(first[measured.mask], gain * simulated_near)
    (measured_near,) = _strongest_near(simulated, [(first, measured)])
    theirs = _excess_db(gain * second[simulated.mask], measured_near)
    level_db = np.full(first.shape, np.nan)
    level_db[measured.mask | simulated.mask] = 0.0
    level_db[measured.mask] += ours
    level_db[simulated.mask] -= theirs
    missing, surplus = _objects(measured, first, ours), _objects(simulated, second, theirs)
    gain_db = 20.0 * math.log10(gain)
    return Disagreement(level_db, measured.x_m, measured.y_m, gain_db, missing, surplus)


def weighted_quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return the value up to which this share of the weights lies."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, share * below[-1])]])


def _excess_db(own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return 20 log10(own / other) in [0, MOST_DB]; `own` is above 0."""
    floor = own * 10.0 ** (-MOST_DB / 20.0)
    return np.maximum(20.0 * np.log10(own / np.maximum(other, floor)), 0.0)


def _strongest_near(
    at: DepthMap, others: Sequence[tuple[np.ndarray, DepthMap]]
) -> list[np.ndarray]:
    """Return the largest amplitude of each image near every pixel of `at` that has a depth."""
    z_m = at.depth_m[at.mask]
    largest = [np.zeros(len(z_m)) for _ in others]
    for inside, row, column in _neighbours(at, at.mask, NEAR_M):
        for best, (amplitude, image) in zip(largest, others, strict=True):
            away_m = np.abs(image.depth_m[row, column] - z_m[inside])
            # An unknown depth is not far away: NaN compares as False.
            value = np.where(away_m > NEAR_DEPTH_M, 0.0, amplitude[row, column])
            best[inside] = np.maximum(best[inside], value)
    return largest


def _neighbours(
    image: DepthMap, mask: np.ndarray, reach_m: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (which of the pixels of `mask`, row, column) for every offset to pixels near them."""
    rows, columns = np.nonzero(mask)
    n_y, n_x = mask.shape
    for down in _offsets(image.y_m, reach_m):
        for right in _offsets(image.x_m, reach_m):
            row, column = rows + down, columns + right
            inside = np.flatnonzero((row >= 0) & (row < n_y) & (column >= 0) & (column < n_x))
            row, column = row[inside], column[inside]
            y_m = image.y_m[row] - image.y_m[rows[inside]]
            x_m = image.x_m[column] - image.x_m[columns[inside]]
            near = x_m**2 + y_m**2 <= (reach_m + 1e-9) ** 2
            yield inside[near], row[near], column[near]


def _offsets(axis_m: np.ndarray, reach_m: float) -> list[int]:
    """Return the steps along an axis, by index, that stay within `reach_m` somewhere."""
    last = np.searchsorted(axis_m, axis_m + reach_m + 1e-9, side="right") - 1
    most = int((last - np.arange(len(axis_m))).max())
    steps = np.linspace(-most, most, 2 * min(most, RINGS) + 1)
    return [int(step) for step in np.unique(np.round(steps))]


def _objects(
    image: DepthMap, amplitude: np.ndarray, excess_db: np.ndarray
) -> tuple[UnmatchedObject, ...]:
    """Return the objects among the pixels of an image whose excess is `WEAKER_DB` or more."""
    from scipy import ndimage

    excess = np.zeros(image.mask.shape)
    excess[image.mask] = excess_db
    unmatched = image.mask & (excess >= WEAKER_DB)
    unmatched &= amplitude >= 10.0 ** (BACKGROUND_DB / 20.0) * np.median(amplitude)
    joined = unmatched.copy()
    for _, row, column in _neighbours(image, unmatched, NEAR_M / 2):
        joined[row, column] = True
    labels, count = ndimage.label(joined, structure=np.ones((3, 3)))
    energy = np.where(image.mask, amplitude**2, 0.0)
    labels[~unmatched] = 0
    numbers = np.arange(1, count + 1)
    shares = ndimage.sum_labels(energy, labels, numbers) / energy.sum()
    brightest = ndimage.maximum_position(amplitude, labels, numbers) if count else []
    objects = [
        UnmatchedObject(
            (float(image.x_m[column]), float(image.y_m[row]), float(image.depth_m[row, column])),
            float(share),
            20.0 * math.log10(amplitude[row, column]),
            float(excess[row, column]),
        )
        for share, (row, column) in zip(shares, brightest, strict=True)
        if share >= LEAST_SHARE
    ]
    return tuple(sorted(objects, key=lambda one: -one.share))
