"""Fast factorised back-projection: the tree of blocks of voxels, and their skeleton antennas.

L. M. H. Ulander, H. Hellsten, G. Stenstroem, "Synthetic-aperture radar processing using fast
factorized back-projection", IEEE Trans. Aerosp. Electron. Syst. 39 (2003) 760. Within a block the
phases relative to its centre vary little over antennas and frequencies, so few of them approximate
the rest (`clradar.imaging.interpolative`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.interpolative import (
    Decomposition,
    decompose_sampled,
    matrix_product,
    phasor_rms,
)
from clradar.model import AntennaArray, VoxelGrid, Waveform

MIN_SAMPLES = 480
SAMPLES_PER_POINT = 4
"""Sampled functions per antenna or frequency; as many complex numbers count twice."""

N_FAMILIES = 6
"""Families of voxels that samples are drawn of, see `_draw_samples`."""

CANDIDATES = 4
"""Samples of which the one whose phase varies most is taken."""

PROBES = 8
"""Antennas of one side over which that variation is measured."""

CHECKED = 120
"""Voxels of each family that all levels together are checked on."""

NEAR_POOL = 2**14
"""Voxels of which those closest to antennas are picked: a fraction of 1e-4 of the volume that does
40 dB worse than the rest is noticeable in its RMS."""

MARGIN = 0.8
"""Fraction of the tolerance that is used: samples show some voxels only, and are checked to
`clradar.imaging.interpolative.SLACK`."""

LEVEL_ROUNDS = 6
"""How often the levels are chosen again with smaller errors before all points are kept."""

EXTREME = 0.5
"""Fraction of the samples' coordinates at the ends of their range, where the errors are largest."""

LEAF_WAVELENGTHS = (1.0, 1.0, 2.0)
"""Size of the smallest blocks along x, y, z, in wavelengths: smaller ones cost more on the way down
the tree, larger ones in the last sum. Measured for 1 mm voxels at 77 GHz: 4 x 4 x 8 is the quickest
of 4x4x4, 4x2x8, 2x2x8, 8x4x8 and 4x4x16, which take 1.1 to 1.7 times as long."""

MOST_LEAF = 2**18
"""Voxels of a smallest block: the positions of all are held in memory."""

LEAST_LEAF = 8
"""Voxels of a smallest block, where the grid has as many: the lanes of a work-item."""

Triple = tuple[int, int, int]

_PathSet = tuple[np.ndarray, ...]
"""For each of n voxels the path that its phase is sampled on: frequency, or Tx and Rx."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockLevel:
    """Blocks of one size, with their skeleton antennas and frequencies.

    Attributes
    ----------
    voxels : tuple of 3 ints
        Size of a block along x, y, z.
    counts : tuple of 3 ints
        Number of blocks along x, y, z.
    tx, rx, frequency : Decomposition
        Skeleton indices into all antennas and frequencies; weights of shape (skeleton of the level
        above, skeleton of this one).
    """

    voxels: Triple
    counts: Triple
    tx: Decomposition
    rx: Decomposition
    frequency: Decomposition


def leaf_voxels(grid: VoxelGrid, wavelength_m: float) -> Triple:
    """Return the size of the smallest blocks in voxels: powers of two, at most the grid's size."""
    limits = [1 << (n - 1).bit_length() for n in grid.counts]
    size = []
    for wanted, step, limit in zip(LEAF_WAVELENGTHS, grid.spacing_m, limits, strict=True):
        exponent = int(np.floor(np.log2(wanted * wavelength_m / step) + 0.5))
        size.append(min(1 << max(0, exponent), limit))
    while np.prod(size) < LEAST_LEAF:
        growing = [i for i in range(3) if size[i] < limits[i]]
        if not growing:
            break
        shortest = min(growing, key=lambda i: size[i] * grid.spacing_m[i])
        size[shortest] *= 2
    while np.prod(size) > MOST_LEAF:
        longest = max(range(3), key=lambda i: size[i] * grid.spacing_m[i])
        size[longest] //= 2
    return size[0], size[1], size[2]


def block_sizes(grid: VoxelGrid, leaf: Triple) -> list[Triple]:
    """Return the sizes of blocks in voxels, from one around the whole grid down to `leaf`."""
    sizes = [leaf]
    while any(s < n for s, n in zip(sizes[0], grid.counts, strict=True)):
        x, y, z = (s if s >= n else 2 * s for s, n in zip(sizes[0], grid.counts, strict=True))
        sizes.insert(0, (x, y, z))
    return sizes


@lru_cache(maxsize=1)
def block_levels(
    array: AntennaArray, waveform: Waveform, grid: VoxelGrid, tolerance: float
) -> tuple[BlockLevel, ...]:
    """Return the levels of the tree, from the whole grid down to the smallest blocks.

    They do not depend on the samples and take most of the time of a small image, so those of the
    last call are kept: images of one array, waveform and grid (the same objects) share them.

    Parameters
    ----------
    tolerance : float
        Error of the image, relative to its RMS, that the tree may cause. Tx, Rx and frequency each
        get the same part of its square, and each level the same part of that; where the levels
        together exceed it, each is given less.
    """
    k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    sizes = block_sizes(grid, leaf_voxels(grid, SPEED_OF_LIGHT_M_PER_S / waveform.center_hz))
    sampler = _VoxelSampler(grid, sizes, array, np.random.Generator(np.random.Philox(0)))
    share = MARGIN * tolerance / np.sqrt(3)
    tx = _decompositions(_AntennaPhases(array.tx_m, k, sampler), share)
    rx = _decompositions(_AntennaPhases(array.rx_m, k, sampler), share)
    frequency = _decompositions(_FrequencyPhases(array, k, sampler), share)
    found = []
    for voxels, *parts in zip(sizes, tx, rx, frequency, strict=True):
        x, y, z = (-(-n // s) for n, s in zip(grid.counts, voxels, strict=True))
        found.append(BlockLevel(voxels, (x, y, z), *parts))
    return tuple(found[: _worthwhile(array, waveform, found)])


def _worthwhile(array: AntennaArray, waveform: Waveform, found: list[BlockLevel]) -> int:
    """Return how many levels make the image cheapest; with fewer, the last sum is larger.

    Where a block has few voxels, or where the skeletons hardly shrink because the voxels are far
    apart, the sum from larger blocks is faster. Costs are in terms of that sum and were
    measured with 8 lanes on PoCL.
    """
    way_down, least, best = 0.0, np.inf, len(found)
    r, c, m = array.n_tx, array.n_rx, waveform.n_freq
    for i, level in enumerate(found):
        rows, columns, frequencies = (
            len(part.skeleton) for part in (level.tx, level.rx, level.frequency)
        )
        if i % 2:
            rows, columns = columns, rows
        n_blocks, block = int(np.prod(level.counts)), int(np.prod(level.voxels))
        step = m * c * (0.5 * r * rows + 2 * r + 2 * rows)
        step += m * rows * (0.5 * c * columns + 2 * c + 2 * columns)
        step += rows * columns * (0.5 * m * frequencies + m + frequencies)
        way_down += n_blocks * step
        antennas = rows + columns
        last = n_blocks * block * (frequencies * (rows * columns + 9 * antennas) + 5 * antennas)
        if block <= MOST_LEAF and way_down + last < least:
            least, best = way_down + last, i + 1
        r, c, m = columns, rows, frequencies
    return best


class _VoxelSampler:
    """Draws random voxels, and gives the centres of the blocks that they are in."""

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
        """Return n voxels close to antennas: log-uniform in the rank of their distance."""
        rank = len(self._near) ** self.rng.random(n) - 1.0
        return self._near[rank.astype(int)]

    def centres(self, voxel: np.ndarray, levels: int | slice) -> np.ndarray:
        """Return the centres of the blocks that voxels are in, shape ([n_levels,] n, 3), metres."""
        sizes = self.sizes[levels, None]
        return self.metres(voxel // sizes * sizes + 0.5 * (sizes - 1))

    def metres(self, at: np.ndarray) -> np.ndarray:
        return self.grid.origin_m + self.grid.spacing_m * at

    def _fraction(self, n: int) -> np.ndarray:
        value = self.rng.random((n, 3))
        return np.where(self.rng.random((n, 3)) < EXTREME, np.round(value), value)


class _AntennaPhases:
    """Phases over the antennas of one side, in cycles; a path is its frequency."""

    def __init__(self, antennas_m: np.ndarray, k: np.ndarray, sampler: _VoxelSampler) -> None:
        self.antennas_m, self.k, self.sampler = antennas_m, k, sampler
        self.n_points, self.n_levels = len(antennas_m), len(sampler.sizes)

    def paths(self, voxel_m: np.ndarray) -> _PathSet:
        """Return a random path for each of n voxels."""
        return (self.sampler.rng.choice(self.k, len(voxel_m)),)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, _PathSet]:
        """Return n of some voxels, and paths, whose phase relative to the centre varies most."""
        paths = self.paths(voxel_m)
        some = self.sampler.rng.choice(self.n_points, min(PROBES, self.n_points), replace=False)
        cycles = self.cycles(voxel_m, paths, some) - self.cycles(centre_m, paths, some)
        chosen = _largest(np.ptp(cycles, axis=1), n)
        return chosen, (paths[0][chosen],)

    def cycles(self, at_m: np.ndarray, paths: _PathSet, points: Any) -> np.ndarray:
        """Return the cycles to positions (..., n, 3) over some points, (..., n, n_points)."""
        return paths[0][:, None] * distances(at_m[..., None, :], self.antennas_m[points])


class _FrequencyPhases:
    """Phases over the frequencies, in cycles from the band's centre; a path is its Tx and Rx."""

    def __init__(self, array: AntennaArray, k: np.ndarray, sampler: _VoxelSampler) -> None:
        # About the centre of the band, so that conjugate phasors are equally typical samples.
        self.sides = (array.tx_m, array.rx_m)
        self.offset, self.sampler = k - 0.5 * (k[0] + k[-1]), sampler
        self.n_points, self.n_levels = len(k), len(sampler.sizes)

    def paths(self, voxel_m: np.ndarray) -> _PathSet:
        rng, n = self.sampler.rng, len(voxel_m)
        return tuple(side[rng.integers(0, len(side), n)] for side in self.sides)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, _PathSet]:
        # The largest difference over all pairs is the sum of the largest ones of Tx and Rx.
        every = np.arange(len(voxel_m))
        longest, shortest, paths = np.zeros(len(every)), np.zeros(len(every)), []
        for side in self.sides:
            change = distances(voxel_m[:, None], side) - distances(centre_m[:, None], side)
            ends = change.argmax(axis=1), change.argmin(axis=1)
            longest += change[every, ends[0]]
            shortest += change[every, ends[1]]
            paths.append([side[end] for end in ends])
        outward = (longest > -shortest)[:, None]
        chosen = _largest(np.maximum(longest, -shortest), n)
        return chosen, tuple(np.where(outward, far, near)[chosen] for far, near in paths)

    def cycles(self, at_m: np.ndarray, paths: _PathSet, points: Any) -> np.ndarray:
        length = distances(at_m, paths[0]) + distances(at_m, paths[1])
        return length[..., None] * self.offset[points]


_Phases = _AntennaPhases | _FrequencyPhases


def distances(a_m: np.ndarray, b_m: np.ndarray) -> np.ndarray:
    """Return distances between points of shape (..., 3), metres."""
    x, y, z = (a_m[..., i] - b_m[..., i] for i in range(3))
    return np.sqrt(x * x + y * y + z * z)


def _largest(values: np.ndarray, n: int) -> np.ndarray:
    return np.argsort(-values, kind="stable")[:n]


def _draw_samples(phases: _Phases, n: int, level: int) -> tuple[np.ndarray, _PathSet]:
    """Return n voxels of each of six families, and their paths; each family has to keep the
    tolerance on its own.

    Voxels spread over the blocks of a level; corners of the grid; voxels next to antennas; and of
    more of each those whose phase varies most over the points: the error of an interpolation rises
    steeply just beyond what has been sampled.
    """
    sampler, m = phases.sampler, CANDIDATES * n
    found: list[np.ndarray] = []
    chosen: list[_PathSet] = []
    for draw in (partial(sampler.spread, level=level), sampler.corners, sampler.near):
        voxel = draw(n)
        found.append(voxel)
        chosen.append(phases.paths(sampler.metres(voxel)))
        voxel = draw(m)
        centre_m = sampler.centres(voxel, level)
        hardest, paths = phases.hardest(sampler.metres(voxel), centre_m, n)
        found.append(voxel[hardest])
        chosen.append(paths)
    return np.concatenate(found), tuple(np.concatenate(p) for p in zip(*chosen, strict=True))


def _decompositions(phases: _Phases, tolerance: float) -> list[Decomposition]:
    """Return those of all levels, each of the skeleton above; indices are into all points."""
    each = tolerance / np.sqrt(phases.n_levels)
    for _ in range(LEVEL_ROUNDS):
        points, found = np.arange(phases.n_points), []
        for level in range(phases.n_levels):
            part = _decomposition(phases, level, points, each)
            points = points[part.skeleton]
            found.append(Decomposition(points, part.weights))
        error = _rms_error(phases, found)
        if error <= tolerance:
            return found
        each *= 0.7 * tolerance / error
    every = Decomposition(np.arange(phases.n_points), np.eye(phases.n_points))
    return [every] * phases.n_levels


def _decomposition(
    phases: _Phases, level: int, points: np.ndarray, tolerance: float
) -> Decomposition:
    n = max(MIN_SAMPLES, SAMPLES_PER_POINT * len(points)) // N_FAMILIES

    def draw() -> np.ndarray:
        voxel, paths = _draw_samples(phases, n, level)
        cycles = phases.cycles(phases.sampler.metres(voxel), paths, points)
        centre_m = phases.sampler.centres(voxel, level)
        cycles -= phases.cycles(centre_m, paths, points)
        angle = 2.0 * np.pi * cycles
        parts = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return parts.reshape(N_FAMILIES, 2 * n, -1)

    return decompose_sampled(draw, tolerance)


def _rms_error(phases: _Phases, found: list[Decomposition]) -> float:
    """Return the RMS error of all levels together on new voxels: the largest of the families."""
    sampler, every = phases.sampler, np.arange(phases.n_points)
    voxel, paths = _draw_samples(phases, CHECKED, phases.n_levels - 1)
    voxel_m, centre_m = sampler.metres(voxel), sampler.centres(voxel, slice(None))
    last = found[-1].skeleton
    cycles = phases.cycles(voxel_m, paths, last)
    value = np.exp(2j * np.pi * (cycles - phases.cycles(centre_m[-1], paths, last)))
    for level in reversed(range(phases.n_levels)):
        weights = found[level].weights.T
        value = matrix_product(value.real, weights) + 1j * matrix_product(value.imag, weights)
        above = found[level - 1].skeleton if level else every
        cycles = phases.cycles(centre_m[level], paths, above)
        if level:
            cycles -= phases.cycles(centre_m[level - 1], paths, above)
        value *= np.exp(2j * np.pi * cycles)
    error = value - np.exp(2j * np.pi * phases.cycles(voxel_m, paths, every))
    parts = np.stack([error.real, error.imag], axis=1)
    return float(phasor_rms(parts.reshape(N_FAMILIES, 2 * CHECKED, -1)).max())
