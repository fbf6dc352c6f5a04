"""Blocks of voxels within blocks, and which antennas and frequencies stand for all there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, VoxelGrid, Waveform
from clradar.skeleton import Skeleton, skeleton

MIN_SAMPLES = 400
SAMPLES_PER_POINT = 4
"""Sampled functions per antenna or frequency; as many complex numbers count twice."""

MARGIN = 0.6
"""Room for what samples do not show: they see some voxels, and are checked to `skeleton.SLACK`."""

ROUNDS = 4
"""How often the levels are chosen again with smaller errors before the last choice stands."""

EXTREME = 0.5
"""Share of the samples' coordinates at the ends of their range, where the errors are largest."""

LEAF_WAVELENGTHS = (1.0, 1.0, 2.0)
"""Size of the smallest blocks along x, y, z, in wavelengths: smaller ones cost more on the way down
the tree, larger ones in the last sum. Measured for 1 mm voxels at 77 GHz: 4 x 4 x 8 is the quickest
of 4x4x4, 4x2x8, 2x2x8, 8x4x8 and 4x4x16, which take 1.1 to 1.7 times as long."""

LEAST_LEAF = 8
"""Voxels of a smallest block, where the grid has as many: the lanes of a work-item."""

Triple = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Blocks of one size.

    Attributes
    ----------
    voxels : tuple of 3 ints
        Size of a block along x, y, z.
    counts : tuple of 3 ints
        Number of blocks along x, y, z.
    tx, rx, frequency : ndarray of int
        Indices of those that stand for all.
    tx_weights, rx_weights, frequency_weights : ndarray, float64
        Shape (how many of the level above, how many of this one).
    """

    voxels: Triple
    counts: Triple
    tx: np.ndarray
    rx: np.ndarray
    frequency: np.ndarray
    tx_weights: np.ndarray
    rx_weights: np.ndarray
    frequency_weights: np.ndarray


def leaf_voxels(grid: VoxelGrid, wavelength_m: float) -> Triple:
    """Return the size of the smallest blocks in voxels, powers of two, as the grid allows."""
    limits = [1 << (n - 1).bit_length() for n in grid.counts]
    size = []
    for wanted, step, limit in zip(LEAF_WAVELENGTHS, grid.spacing_m, limits, strict=True):
        exponent = int(np.floor(np.log2(wanted * wavelength_m / step) + 0.5))
        size.append(min(1 << max(0, exponent), limit))
    while np.prod(size) < LEAST_LEAF:
        room = [i for i in range(3) if size[i] < limits[i]]
        if not room:
            break
        shortest = min(room, key=lambda i: size[i] * grid.spacing_m[i])
        size[shortest] *= 2
    return size[0], size[1], size[2]


def block_sizes(grid: VoxelGrid, leaf: Triple) -> list[Triple]:
    """Return the sizes of blocks in voxels, from one that holds the whole grid down to `leaf`."""
    sizes = [leaf]
    while any(s < n for s, n in zip(sizes[0], grid.counts, strict=True)):
        x, y, z = (s if s >= n else 2 * s for s, n in zip(sizes[0], grid.counts, strict=True))
        sizes.insert(0, (x, y, z))
    return sizes


@lru_cache(maxsize=1)
def levels(
    array: AntennaArray, waveform: Waveform, grid: VoxelGrid, tolerance: float
) -> tuple[Level, ...]:
    """Return the levels of the tree, from the whole grid down to the smallest blocks.

    They do not depend on what was recorded and take most of the time of a small image, so those of
    the last call are kept: images of one array, waveform and grid (the same objects) share them.

    Parameters
    ----------
    tolerance : float
        Error of the image, relative to its RMS, that the tree may cause. Each of the three kinds of
        interpolation (Tx, Rx, frequency) is given the same share of its square, and each level the
        same share of that; where the levels together still err more, each is given less.
    """
    k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    sizes = block_sizes(grid, leaf_voxels(grid, SPEED_OF_LIGHT_M_PER_S / waveform.center_hz))
    places = _Places(grid, sizes, np.random.Generator(np.random.Philox(0)))
    share = MARGIN * tolerance / np.sqrt(3)
    tx = _chain(_Antennas(array.tx_m, k, places), share)
    rx = _chain(_Antennas(array.rx_m, k, places), share)
    frequency = _chain(_Frequencies(array, k, places), share)
    found = []
    for voxels, *parts in zip(sizes, tx, rx, frequency, strict=True):
        x, y, z = (-(-n // s) for n, s in zip(grid.counts, voxels, strict=True))
        indices, weights = [p.index for p in parts], [p.weights for p in parts]
        found.append(Level(voxels, (x, y, z), *indices, *weights))
    return tuple(found)


class _Places:
    """Draws voxels, and the centres of the blocks of every level that they are in."""

    def __init__(self, grid: VoxelGrid, sizes: list[Triple], rng: np.random.Generator) -> None:
        self.grid, self.sizes, self.rng = grid, sizes, rng

    def draw(self, n: int, level: int, centres: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return voxels that are spread over the blocks of a level and over each of these blocks.

        Returns
        -------
        voxel_m : ndarray, shape (n, 3), metres
        centre_m : ndarray, shape (n_centres, n, 3), metres
            Of the blocks, at the levels `centres`, that they are in.
        """
        counts, size = np.array(self.grid.counts), np.array(self.sizes[level])
        first = size * np.round(self._fraction(n) * (-(-counts // size) - 1))
        last = np.minimum(first + size, counts) - 1
        voxel = np.round(first + self._fraction(n) * (last - first))
        sizes = np.array(self.sizes[centres])[:, None]
        centre = voxel // sizes * sizes + 0.5 * (sizes - 1)
        return self._metres(voxel), self._metres(centre)

    def _fraction(self, n: int) -> np.ndarray:
        value = self.rng.random((n, 3))
        return np.where(self.rng.random((n, 3)) < EXTREME, np.round(value), value)

    def _metres(self, at: np.ndarray) -> np.ndarray:
        return self.grid.origin_m + self.grid.spacing_m * at


class _Antennas:
    """Phases over the antennas of one side, in cycles."""

    def __init__(self, antennas_m: np.ndarray, k: np.ndarray, places: _Places) -> None:
        self.antennas_m, self.k, self.places = antennas_m, k, places
        self.n_points, self.n_levels = len(antennas_m), len(places.sizes)

    def draw(
        self, n: int, level: int, points: np.ndarray, centres: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the cycles to n voxels, (n, n_points), and to their centres of some levels."""
        voxel_m, centre_m = self.places.draw(n, level, centres)
        k = self.places.rng.choice(self.k, n)[:, None]
        return k * self._lengths(voxel_m, points), k * self._lengths(centre_m, points)

    def _lengths(self, at_m: np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(at_m[..., None, :] - self.antennas_m[points], axis=-1)


class _Frequencies:
    """Phases over the frequencies, in cycles from the centre of the band."""

    def __init__(self, array: AntennaArray, k: np.ndarray, places: _Places) -> None:
        # Conjugates count as typical, which they are about the centre of the band.
        self.array, self.offset, self.places = array, k - 0.5 * (k[0] + k[-1]), places
        self.n_points, self.n_levels = len(k), len(places.sizes)

    def draw(
        self, n: int, level: int, points: np.ndarray, centres: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the cycles to n voxels, (n, n_points), and to their centres of some levels."""
        voxel_m, centre_m = self.places.draw(n, level, centres)
        to_voxel, to_centre = np.zeros(n), np.zeros(centre_m.shape[:2])
        for antennas_m in (self.array.tx_m, self.array.rx_m):
            chosen = antennas_m[self.places.rng.integers(0, len(antennas_m), n)]
            to_voxel += np.linalg.norm(voxel_m - chosen, axis=-1)
            to_centre += np.linalg.norm(centre_m - chosen, axis=-1)
        offset = self.offset[points]
        return to_voxel[:, None] * offset, to_centre[..., None] * offset


def _chain(kind: _Antennas | _Frequencies, tolerance: float) -> list[Skeleton]:
    """Return the skeletons of all levels, each chosen from the one above; indices are original."""
    each = tolerance / np.sqrt(kind.n_levels)
    for _ in range(ROUNDS):
        points, found = np.arange(kind.n_points), []
        for level in range(kind.n_levels):
            part = _skeleton(kind, level, points, each)
            points = points[part.index]
            found.append(Skeleton(points, part.weights))
        error = _error_of(kind, found)
        if error <= tolerance:
            break
        each *= 0.7 * tolerance / error
    return found


def _skeleton(
    kind: _Antennas | _Frequencies, level: int, points: np.ndarray, tolerance: float
) -> Skeleton:
    n = max(MIN_SAMPLES, SAMPLES_PER_POINT * len(points))

    def draw() -> np.ndarray:
        to_voxel, to_centre = kind.draw(n, level, points, slice(level, level + 1))
        return _phasor(to_voxel - to_centre[0])

    return skeleton(draw, tolerance)


def _error_of(kind: _Antennas | _Frequencies, found: list[Skeleton]) -> float:
    """Return the RMS error of all levels together, on voxels that had no part in any choice."""
    every = np.arange(kind.n_points)
    to_voxel, to_centre = kind.draw(MIN_SAMPLES, kind.n_levels - 1, every, slice(None))
    last = found[-1].index
    value = _phasor((to_voxel - to_centre[-1])[:, last])
    for level in reversed(range(kind.n_levels)):
        above = found[level - 1].index if level else every
        value = value @ found[level].weights.T
        turn = to_centre[level] - (to_centre[level - 1] if level else 0.0)
        value *= _phasor(turn[:, above])
    return float(np.sqrt(np.mean(np.abs(value - _phasor(to_voxel)) ** 2)))


def _phasor(turns: np.ndarray) -> np.ndarray:
    return np.exp(2j * np.pi * turns)
