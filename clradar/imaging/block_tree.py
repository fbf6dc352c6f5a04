"""Blocks of voxels within blocks, and which antennas and frequencies stand for all there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.interpolative import Skeleton, product, rms, skeleton
from clradar.model import AntennaArray, VoxelGrid, Waveform

MIN_SAMPLES = 480
SAMPLES_PER_POINT = 4
"""Sampled functions per antenna or frequency; as many complex numbers count twice."""

N_KINDS = 6
"""Kinds of voxels that samples are drawn of, see `_draw`."""

CANDIDATES = 4
"""Samples of which the one whose phase varies most is taken."""

ENDS = 8
"""Antennas on which that is told, for one side."""

CHECKED = 120
"""Voxels of each kind that a chain of levels is checked on."""

NEAR_POOL = 2**14
"""Voxels of which those next to antennas are told: a share of 1e-4 of the volume that does 40 dB
worse than the rest is what its RMS notices."""

MARGIN = 0.8
"""Room for what samples do not show: they see some voxels, and are checked to `skeleton.SLACK`."""

ROUNDS = 6
"""How often the levels are chosen again with smaller errors before all points are kept."""

EXTREME = 0.5
"""Share of the samples' coordinates at the ends of their range, where the errors are largest."""

LEAF_WAVELENGTHS = (1.0, 1.0, 2.0)
"""Size of the smallest blocks along x, y, z, in wavelengths: smaller ones cost more on the way down
the tree, larger ones in the last sum. Measured for 1 mm voxels at 77 GHz: 4 x 4 x 8 is the quickest
of 4x4x4, 4x2x8, 2x2x8, 8x4x8 and 4x4x16, which take 1.1 to 1.7 times as long."""

MOST_LEAF = 2**18
"""Voxels of a smallest block: the places of all are held in memory."""

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
    while np.prod(size) > MOST_LEAF:
        longest = max(range(3), key=lambda i: size[i] * grid.spacing_m[i])
        size[longest] //= 2
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
    places = _Places(grid, sizes, array, np.random.Generator(np.random.Philox(0)))
    share = MARGIN * tolerance / np.sqrt(3)
    tx = _chain(_Antennas(array.tx_m, k, places), share)
    rx = _chain(_Antennas(array.rx_m, k, places), share)
    frequency = _chain(_Frequencies(array, k, places), share)
    found = []
    for voxels, *parts in zip(sizes, tx, rx, frequency, strict=True):
        x, y, z = (-(-n // s) for n, s in zip(grid.counts, voxels, strict=True))
        indices, weights = [p.index for p in parts], [p.weights for p in parts]
        found.append(Level(voxels, (x, y, z), *indices, *weights))
    return tuple(found[: _worthwhile(array, waveform, found)])


def _worthwhile(array: AntennaArray, waveform: Waveform, found: list[Level]) -> int:
    """Return how many levels are worth their price: with fewer, more is left to the last sum.

    Where few voxels share what the way down costs, or hardly anything can stand for all since the
    voxels are far apart, the sum from larger blocks is the quicker. Prices are in terms of that sum
    and were measured with 8 lanes on PoCL.
    """
    way_down, least, best = 0.0, np.inf, len(found)
    r, c, m = array.n_tx, array.n_rx, waveform.n_freq
    for i, level in enumerate(found):
        rows, columns, frequencies = len(level.tx), len(level.rx), len(level.frequency)
        if i % 2:
            rows, columns = columns, rows
        n_blocks, block = int(np.prod(level.counts)), int(np.prod(level.voxels))
        step = m * c * (0.5 * r * rows + 2 * r + 2 * rows)
        step += m * rows * (0.5 * c * columns + 2 * c + 2 * columns)
        step += rows * columns * (0.5 * m * frequencies + m + frequencies)
        way_down += n_blocks * step
        left = rows + columns
        last = n_blocks * block * (frequencies * (rows * columns + 9 * left) + 5 * left)
        if block <= MOST_LEAF and way_down + last < least:
            least, best = way_down + last, i + 1
        r, c, m = columns, rows, frequencies
    return best


class _Places:
    """Draws voxels, and the centres of the blocks of every level that they are in."""

    def __init__(
        self, grid: VoxelGrid, sizes: list[Triple], array: AntennaArray, rng: np.random.Generator
    ) -> None:
        from scipy.spatial import cKDTree

        self.grid, self.rng = grid, rng
        self.counts, self.sizes = np.array(grid.counts), np.array(sizes)
        pool = rng.integers(0, grid.counts, (NEAR_POOL, 3))
        antennas = cKDTree(np.concatenate([array.tx_m, array.rx_m]))
        self._near = pool[np.argsort(antennas.query(self.metres(pool))[0], kind="stable")]

    def spread(self, n: int, level: int) -> np.ndarray:
        """Return n voxels spread over the blocks of a level and over each of these blocks."""
        size = self.sizes[level]
        first = size * np.round(self._fraction(n) * (-(-self.counts // size) - 1))
        last = np.minimum(first + size, self.counts) - 1
        return np.round(first + self._fraction(n) * (last - first))

    def corners(self, n: int) -> np.ndarray:
        """Return n corners of the grid."""
        return self.rng.integers(0, 2, (n, 3)) * (self.counts - 1)

    def near(self, n: int) -> np.ndarray:
        """Return n voxels next to antennas, the closer the rarer in the grid."""
        rank = len(self._near) ** self.rng.random(n) - 1.0
        return self._near[rank.astype(int)]

    def centres(self, voxel: np.ndarray, levels: slice) -> np.ndarray:
        """Return the centres of the blocks that voxels are in, shape (n_levels, n, 3), metres."""
        sizes = self.sizes[levels][:, None]
        return self.metres(voxel // sizes * sizes + 0.5 * (sizes - 1))

    def metres(self, at: np.ndarray) -> np.ndarray:
        return self.grid.origin_m + self.grid.spacing_m * at

    def _fraction(self, n: int) -> np.ndarray:
        value = self.rng.random((n, 3))
        return np.where(self.rng.random((n, 3)) < EXTREME, np.round(value), value)


class _Kind(Protocol):
    """What is interpolated over: the points of the functions, and paths on which to sample them."""

    places: _Places
    n_points: int
    n_levels: int

    def paths(self, voxel_m: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return what else than the voxel a sample depends on, for each of n voxels."""

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Return n of some voxels, and paths, for which the phase from the centre varies most."""

    def cycles(self, at_m: np.ndarray, paths: tuple[np.ndarray, ...], points: Any) -> np.ndarray:
        """Return the cycles to places (..., n, 3) over some points, (..., n, n_points)."""


class _Antennas:
    """Phases over the antennas of one side, in cycles."""

    def __init__(self, antennas_m: np.ndarray, k: np.ndarray, places: _Places) -> None:
        self.antennas_m, self.k, self.places = antennas_m, k, places
        self.n_points, self.n_levels = len(antennas_m), len(places.sizes)

    def paths(self, voxel_m: np.ndarray) -> tuple[np.ndarray, ...]:
        return (self.places.rng.choice(self.k, len(voxel_m)),)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        paths = self.paths(voxel_m)
        some = self.places.rng.choice(self.n_points, min(ENDS, self.n_points), replace=False)
        turns = self.cycles(voxel_m, paths, some) - self.cycles(centre_m, paths, some)
        chosen = _largest(np.ptp(turns, axis=1), n)
        return chosen, (paths[0][chosen],)

    def cycles(self, at_m: np.ndarray, paths: tuple[np.ndarray, ...], points: Any) -> np.ndarray:
        return paths[0][:, None] * lengths(at_m[..., None, :], self.antennas_m[points])


class _Frequencies:
    """Phases over the frequencies, in cycles from the centre of the band."""

    def __init__(self, array: AntennaArray, k: np.ndarray, places: _Places) -> None:
        # Conjugates count as typical, which they are about the centre of the band.
        self.sides = (array.tx_m, array.rx_m)
        self.offset, self.places = k - 0.5 * (k[0] + k[-1]), places
        self.n_points, self.n_levels = len(k), len(places.sizes)

    def paths(self, voxel_m: np.ndarray) -> tuple[np.ndarray, ...]:
        rng, n = self.places.rng, len(voxel_m)
        return tuple(side[rng.integers(0, len(side), n)] for side in self.sides)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Over the pairs of each voxel the largest difference is known: that of either leg."""
        every = np.arange(len(voxel_m))
        longest, shortest, paths = np.zeros(len(every)), np.zeros(len(every)), []
        for side in self.sides:
            leg = lengths(voxel_m[:, None], side) - lengths(centre_m[:, None], side)
            ends = leg.argmax(axis=1), leg.argmin(axis=1)
            longest += leg[every, ends[0]]
            shortest += leg[every, ends[1]]
            paths.append([side[end] for end in ends])
        outward = (longest > -shortest)[:, None]
        chosen = _largest(np.maximum(longest, -shortest), n)
        return chosen, tuple(np.where(outward, far, near)[chosen] for far, near in paths)

    def cycles(self, at_m: np.ndarray, paths: tuple[np.ndarray, ...], points: Any) -> np.ndarray:
        length = lengths(at_m, paths[0]) + lengths(at_m, paths[1])
        return length[..., None] * self.offset[points]


def lengths(a_m: np.ndarray, b_m: np.ndarray) -> np.ndarray:
    """Return distances between places, (..., 3) metres."""
    x, y, z = (a_m[..., i] - b_m[..., i] for i in range(3))
    return np.sqrt(x * x + y * y + z * z)


def _largest(values: np.ndarray, n: int) -> np.ndarray:
    return np.argsort(-values, kind="stable")[:n]


def _draw(kind: _Kind, n: int, level: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Return n voxels of each of six kinds, which are held to the tolerance each by itself, and
    what else their samples depend on.

    Voxels spread over the blocks of a level; corners of the grid; voxels next to antennas; and of
    more of each those whose phase varies most over the points: interpolation is bad, and suddenly,
    just beyond what has been sampled.
    """
    places, m = kind.places, CANDIDATES * n
    found: list[np.ndarray] = []
    chosen: list[tuple[np.ndarray, ...]] = []
    for draw in (partial(places.spread, level=level), places.corners, places.near):
        voxel = draw(n)
        found.append(voxel)
        chosen.append(kind.paths(places.metres(voxel)))
        voxel = draw(m)
        centre_m = places.centres(voxel, slice(level, level + 1))[0]
        hardest, paths = kind.hardest(places.metres(voxel), centre_m, n)
        found.append(voxel[hardest])
        chosen.append(paths)
    return np.concatenate(found), tuple(np.concatenate(p) for p in zip(*chosen, strict=True))


def _chain(kind: _Kind, tolerance: float) -> list[Skeleton]:
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
            return found
        each *= 0.7 * tolerance / error
    every = Skeleton(np.arange(kind.n_points), np.eye(kind.n_points))
    return [every] * kind.n_levels


def _skeleton(kind: _Kind, level: int, points: np.ndarray, tolerance: float) -> Skeleton:
    n = max(MIN_SAMPLES, SAMPLES_PER_POINT * len(points)) // N_KINDS

    def draw() -> np.ndarray:
        voxel, paths = _draw(kind, n, level)
        turns = kind.cycles(kind.places.metres(voxel), paths, points)
        centre_m = kind.places.centres(voxel, slice(level, level + 1))[0]
        turns -= kind.cycles(centre_m, paths, points)
        return _phasor(turns, N_KINDS)

    return skeleton(draw, tolerance)


def _error_of(kind: _Kind, found: list[Skeleton]) -> float:
    """Return the RMS error of all levels together, on voxels that had no part in any choice: that
    of the kind of voxels that has the largest.
    """
    places, every = kind.places, np.arange(kind.n_points)
    voxel, paths = _draw(kind, CHECKED, kind.n_levels - 1)
    voxel_m, centre_m = places.metres(voxel), places.centres(voxel, slice(None))
    turns = kind.cycles(voxel_m, paths, found[-1].index)
    value = np.exp(2j * np.pi * (turns - kind.cycles(centre_m[-1], paths, found[-1].index)))
    for level in reversed(range(kind.n_levels)):
        weights = found[level].weights.T
        value = product(value.real, weights) + 1j * product(value.imag, weights)
        above = found[level - 1].index if level else every
        turns = kind.cycles(centre_m[level], paths, above)
        if level:
            turns -= kind.cycles(centre_m[level - 1], paths, above)
        value *= np.exp(2j * np.pi * turns)
    error = value - np.exp(2j * np.pi * kind.cycles(voxel_m, paths, every))
    parts = np.stack([error.real, error.imag], axis=1)
    return float(rms(parts.reshape(N_KINDS, 2 * CHECKED, -1)).max())


def _phasor(turns: np.ndarray, n_kinds: int) -> np.ndarray:
    """Return real and imaginary parts as samples by themselves, (n_kinds, samples, points)."""
    angle = 2.0 * np.pi * turns
    parts = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return parts.reshape(n_kinds, 2 * (len(turns) // n_kinds), -1)
