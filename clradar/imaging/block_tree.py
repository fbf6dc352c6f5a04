"""Fast factorised back-projection: the tree of blocks of voxels, and their skeleton antennas.

L. M. H. Ulander, H. Hellsten, G. Stenstroem, "Synthetic-aperture radar processing using fast
factorized back-projection", IEEE Trans. Aerosp. Electron. Syst. 39 (2003) 760. Within a block the
phases relative to its centre vary little over antennas and frequencies, so few of them approximate
the rest (`clradar.phasors.skeletons`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.voxel_skeleton import PlaneWaves, VoxelSkeleton, kept_voxels, voxel_skeleton
from clradar.model import AntennaArray, VoxelGrid, Waveform
from clradar.phasors.interpolative import Decomposition
from clradar.phasors.skeletons import (
    AntennaPhases,
    FrequencyPhases,
    PositionSampler,
    decompositions,
)

LEAF_WAVELENGTHS = (1.0, 1.0, 2.0)
"""Size of the smallest blocks along x, y, z, in wavelengths: smaller ones cost more on the way down
the tree, larger ones in the last sum. Measured for 1 mm voxels at 77 GHz: 4 x 4 x 8 is the quickest
of 4x4x4, 4x2x8, 2x2x8, 8x4x8 and 4x4x16, which take 1.1 to 1.7 times as long."""

NEAR_POOL = 2**14
"""Voxels of which those closest to antennas are picked: a fraction of 1e-4 of the volume that does
40 dB worse than the rest is noticeable in its RMS."""

MARGIN = 0.8
"""Fraction of the tolerance that is used: samples show some voxels only, and are checked to
`clradar.phasors.interpolative.SLACK`."""

EXTREME = 0.5
"""Fraction of the samples' coordinates at the ends of their range, where the errors are largest."""

STEP_COST = 2.0  # what a term on the way down costs, in terms of the last sum's products
FEW_KEPT = 1 / 3
"""Fraction of the grid's voxels up to which the image in the rest is interpolated from them."""

MOST_LEAF = 2**18  # voxels of a smallest block: the positions of all are held in memory
LEAST_LEAF = 8  # voxels of a smallest block, where the grid has as many: the lanes of a work-item

Triple = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class BlockLevel:
    """Blocks of one size, with their skeleton antennas and frequencies.

    Decompositions have skeleton indices into all antennas and frequencies, and weights of shape
    (skeleton of the level above, skeleton of this one).
    """

    voxels: Triple  # size of a block along x, y, z
    n_blocks: int
    n_voxels: int  # that all are summed over, with what fills them up
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


def block_sizes(counts: Triple, leaf: Triple) -> list[Triple]:
    """Return the sizes of blocks in voxels, from one around the whole grid down to `leaf`."""
    sizes = [leaf]
    while any(s < n for s, n in zip(sizes[0], counts, strict=True)):
        x, y, z = (s if s >= n else 2 * s for s, n in zip(sizes[0], counts, strict=True))
        sizes.insert(0, (x, y, z))
    return sizes


@lru_cache(maxsize=1)
def block_levels(
    array: AntennaArray, waveform: Waveform, grid: VoxelGrid, tolerance: float
) -> tuple[BlockLevel, ...]:
    """Return the levels of the tree, from the whole grid down to blocks whose voxels are summed.

    They do not depend on the samples and take most of the time of a small image, so those of the
    last call are kept: images of one array, waveform and grid (the same objects) share them.
    `tolerance` is the error of the image, relative to its RMS, that the tree may cause: Tx, Rx and
    frequency each get the same part of its square, and each level the same part of that; where the
    levels together exceed it, each is given less.
    """
    sizes = _grid_sizes(waveform, grid)
    return tree_levels(array, waveform, _voxel_sampler(array, grid, sizes), sizes, tolerance)


@lru_cache(maxsize=1)
def image_levels(
    array: AntennaArray, waveform: Waveform, grid: VoxelGrid, tolerance: float
) -> tuple[tuple[BlockLevel, ...], VoxelSkeleton | None]:
    """Return the levels for an image alone, and the skeleton voxels of the smallest blocks where
    the image in all voxels is interpolated from these.

    Parameters as of `block_levels`; the skeleton voxels get a quarter of the tolerance's square.
    """
    sizes, k = _grid_sizes(waveform, grid), waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    kept = kept_voxels(PlaneWaves(array, k), grid, [size[0] for size in sizes])
    most = FEW_KEPT * np.prod(grid.counts)
    few = [bool(n * size[1] <= most) for n, size in zip(kept, sizes, strict=True)]
    if any(few):
        n_levels = len(few) - few[::-1].index(True)
        sampler = _voxel_sampler(array, grid, sizes[:n_levels])
        share = MARGIN * tolerance / 2.0
        found = _levels(array, k, sampler, sizes[:n_levels], share)
        summed = [n * level.n_blocks for n, level in zip(kept, found, strict=False)]
        best = cheapest(array, waveform, found, summed)
        skeleton = None
        if few[best - 1]:
            skeleton = voxel_skeleton(array, k, sampler, best - 1, share)
        if skeleton is not None:
            return found[:best], skeleton
    return block_levels(array, waveform, grid, tolerance), None


def _grid_sizes(waveform: Waveform, grid: VoxelGrid) -> list[tuple[Triple, int, int]]:
    """Return the blocks of all sizes as `tree_levels` takes them."""
    sizes = block_sizes(grid.counts, leaf_voxels(grid, centre_wavelength_m(waveform)))
    blocks = [int(np.prod(grid_block_counts(grid, size))) for size in sizes]
    voxels = [n * int(np.prod(size)) for n, size in zip(blocks, sizes, strict=True)]
    return list(zip(sizes, blocks, voxels, strict=True))


def _voxel_sampler(
    array: AntennaArray, grid: VoxelGrid, sizes: list[tuple[Triple, int, int]]
) -> _VoxelSampler:
    rng = np.random.Generator(np.random.Philox(0))
    return _VoxelSampler(grid, [size[0] for size in sizes], array, rng)


def grid_block_counts(grid: VoxelGrid, size: Triple) -> Triple:
    """Return how many blocks of a size there are along x, y, z."""
    x, y, z = (-(-n // s) for n, s in zip(grid.counts, size, strict=True))
    return x, y, z


def centre_wavelength_m(waveform: Waveform) -> float:
    return SPEED_OF_LIGHT_M_PER_S / waveform.center_hz


def tree_levels(
    array: AntennaArray,
    waveform: Waveform,
    sampler: PositionSampler,
    sizes: list[tuple[Triple, int, int]],
    tolerance: float,
) -> tuple[BlockLevel, ...]:
    """Return the levels that are worthwhile, of blocks of `sizes` (voxels, n_blocks, n_voxels).

    These are as in `BlockLevel`, from one block down; `tolerance` is as in `block_levels`.
    """
    k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    found = _levels(array, k, sampler, sizes, MARGIN * tolerance / np.sqrt(3))
    return found[: cheapest(array, waveform, found, [level.n_voxels for level in found])]


def _levels(
    array: AntennaArray,
    k: np.ndarray,
    sampler: PositionSampler,
    sizes: list[tuple[Triple, int, int]],
    share: float,
) -> tuple[BlockLevel, ...]:
    """Return all levels; Tx, Rx and frequency may each cause an error of `share`."""
    tx = decompositions(AntennaPhases(array.tx_m, k, sampler), share)
    rx = decompositions(AntennaPhases(array.rx_m, k, sampler), share)
    frequency = decompositions(FrequencyPhases(array, k, sampler), share)
    return tuple(
        BlockLevel(*size, *parts) for size, *parts in zip(sizes, tx, rx, frequency, strict=True)
    )


def cheapest(
    array: AntennaArray,
    waveform: Waveform,
    found: tuple[BlockLevel, ...],
    summed: list[int],
) -> int:
    """Return how many levels make the image cheapest; with fewer, the last sum is larger.

    Where a block has few voxels, or where the skeletons hardly shrink because the voxels are far
    apart, the sum from larger blocks is faster. Costs are in terms of that sum and were measured
    with 8 lanes on PoCL. `summed` has for each level as the last one in how many voxels the samples
    are summed.
    """
    way_down, least, best = 0.0, np.inf, len(found)
    r, c, m = array.n_tx, array.n_rx, waveform.n_freq
    for i, level in enumerate(found):
        rows, columns, frequencies = (
            len(part.skeleton) for part in (level.tx, level.rx, level.frequency)
        )
        if i % 2:
            rows, columns = columns, rows
        step = m * c * (0.5 * r * rows + 2 * r + 2 * rows)
        step += m * rows * (0.5 * c * columns + 2 * c + 2 * columns)
        step += rows * columns * (0.5 * m * frequencies + m + frequencies)
        way_down += STEP_COST * level.n_blocks * step
        antennas = rows + columns
        last = frequencies * (rows * columns + 6 * antennas) + 9 * antennas
        last *= summed[i]
        if summed[i] <= level.n_blocks * MOST_LEAF and way_down + last < least:
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
