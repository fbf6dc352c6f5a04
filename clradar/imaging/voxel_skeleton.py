"""Skeleton voxels of a block: few of its voxels, from which the image in all of them follows.

Referred to a plane wave through its middle, the image of a block varies slowly from voxel to voxel
along each axis, and real weights interpolate it from a few of them (interpolative decompositions
of sampled phases, `clradar.phasors`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model import AntennaArray, VoxelGrid
from clradar.phasors.interpolative import Decomposition, decompose_sampled, phasor_rms
from clradar.phasors.skeletons import (
    MIN_SAMPLES,
    N_FAMILIES,
    SAMPLES_PER_POINT,
    PathSet,
    PositionSampler,
    distances,
    draw_samples,
)

MOST_KEPT = 32  # skeleton voxels along x: a work-item holds a row of them in private memory
MOST_VOXELS = 64  # voxels of a block along an axis, of which some are chosen
ROW_UNIT = 4  # half the lanes of a work-item
BEYOND = 6  # skeleton voxels along an axis beside those that bandwidth alone asks for
SOME_ANTENNAS = 24  # antennas of a side that a plane wave is chosen by
CHECKED = 20  # voxels of each family that all axes together are checked on
LEAST_DISTANCE_M = 1e-9

ROUNDS = 3
"""How often the axes are decomposed again with smaller errors before all voxels are summed."""


Triple = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class VoxelSkeleton:
    """The skeleton voxels of every block of one size: all of some indices along x, y, z.

    `axes` have, along x, y and z, indices in a block, and the weights of all voxels.
    """

    axes: tuple[Decomposition, Decomposition, Decomposition]
    waves: PlaneWaves

    @property
    def counts(self) -> Triple:
        n_x, n_y, n_z = (len(axis.skeleton) for axis in self.axes)
        return n_x, n_y, n_z

    @property
    def row(self) -> int:
        """Numbers of a row along x: real parts, then imaginary parts, each filled up."""
        return 2 * (-(-len(self.axes[0].skeleton) // ROW_UNIT) * ROW_UNIT)


class PlaneWaves:
    """The plane wave that the image of each block is referred to: its wave vector is in the middle
    of those of all antennas and frequencies."""

    def __init__(self, array: AntennaArray, k: np.ndarray) -> None:
        self.sides = tuple(_some(side) for side in (array.tx_m, array.rx_m))
        self._k = float(k.min()), float(k.max())

    def cycles_per_m(self, centre_m: np.ndarray) -> np.ndarray:
        """Return wave vectors of blocks around some centres, shape (n, 3)."""
        low, high = self.range_of(centre_m, self.sides)
        return 0.5 * (low + high)

    def range_of(
        self, at_m: np.ndarray, sides: tuple[np.ndarray, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest components of wave vectors at positions, shape (n, 3)."""
        low, high = np.zeros(at_m.shape), np.zeros(at_m.shape)
        for antennas_m in sides:
            for axis in range(3):
                cosine = direction_cosines(at_m, antennas_m, axis)
                low[:, axis] += cosine.min(axis=1)
                high[:, axis] += cosine.max(axis=1)
        ends = [k * value for k in self._k for value in (low, high)]
        return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _some(antennas_m: np.ndarray) -> np.ndarray:
    step = -(-len(antennas_m) // SOME_ANTENNAS)
    return antennas_m[::step]


def direction_cosines(at_m: np.ndarray, antennas_m: np.ndarray, axis: int) -> np.ndarray:
    """Return components along an axis of unit vectors from antennas to positions, shape
    (n_positions, n_antennas); 0 at an antenna."""
    way_m = at_m[:, axis, None] - antennas_m[:, axis]
    return way_m / np.maximum(distances(at_m[:, None], antennas_m), LEAST_DISTANCE_M)


def kept_voxels(waves: PlaneWaves, grid: VoxelGrid, sizes: list[Triple]) -> list[int]:
    """Return about how many skeleton voxels blocks of some sizes will have; all of them where an
    axis has too many for a choice among them.

    As many along an axis as the wave vectors there need, and `BEYOND` for the block's ends: found
    for the paper's array and volume at -50 dB.
    """
    corners = np.indices((3, 3, 3)).reshape(3, -1).T * 0.5 * (np.array(grid.counts) - 1)
    low, high = waves.range_of(grid.origin_m + grid.spacing_m * corners, waves.sides)
    per_voxel = (high - low).max(axis=0) * grid.spacing_m
    found = []
    for size in np.array(sizes):
        kept = np.minimum(size, np.ceil(per_voxel * size + BEYOND))
        few = size.max() <= MOST_VOXELS and kept[0] <= MOST_KEPT
        found.append(int(np.prod(kept if few else size)))
    return found


class _LinePhases:
    """Phases over the voxels of a block along one axis, in cycles; a path is its Tx, Rx and k."""

    def __init__(
        self, array: AntennaArray, k: np.ndarray, sampler: PositionSampler, level: int, axis: int,
        waves: PlaneWaves,
    ) -> None:  # fmt: skip
        self.sides, self.k = (array.tx_m, array.rx_m), k
        self.sampler, self.level, self.axis = sampler, level, axis
        self.waves, self.size = waves, sampler.sizes[level]
        self.n_points = int(self.size[axis])

    def paths(self, voxel_m: np.ndarray) -> PathSet:
        rng, n = self.sampler.rng, len(voxel_m)
        tx_m, rx_m = (side_m[rng.integers(0, len(side_m), n)] for side_m in self.sides)
        return tx_m, rx_m, rng.choice(self.k, n)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, PathSet]:
        """Return n of some voxels, and paths, with the farthest wave vectors from the block's."""
        wave, every = self.waves.cycles_per_m(centre_m)[:, self.axis], np.arange(len(voxel_m))
        ends = np.zeros((2, len(voxel_m)))
        paths = []
        for side_m in self.sides:
            cosine = direction_cosines(voxel_m, side_m, self.axis)
            at = np.stack([cosine.argmin(axis=1), cosine.argmax(axis=1)])
            ends += cosine[every, at]
            paths.append(side_m[at])
        k = np.array([self.k.min(), self.k.max()])[:, None, None]
        away = np.abs(k * ends - wave).reshape(4, -1)  # k by ends
        which = away.argmax(axis=0)
        chosen = np.argsort(-away[which, every], kind="stable")[:n]
        which = which[chosen]
        tx_m, rx_m = (path_m[which % 2, chosen] for path_m in paths)
        return chosen, (tx_m, rx_m, k.ravel()[which // 2])

    def samples(self, n: int) -> np.ndarray:
        """Return phasors of n lines of voxels of each family as `decompose_sampled` wants them."""
        voxel, paths = draw_samples(self, n, self.level)
        at = np.repeat(voxel[:, None], self.n_points, axis=1)
        first = voxel[:, self.axis] // self.n_points * self.n_points
        at[..., self.axis] = first[:, None] + np.arange(self.n_points)
        value = self.phasors(voxel, at, paths)
        return np.stack([value.real, value.imag], axis=1).reshape(N_FAMILIES, 2 * n, -1)

    def phasors(self, voxel: np.ndarray, at: np.ndarray, paths: PathSet) -> np.ndarray:
        """Return the phasors of paths at voxels (n, m, 3) of the blocks that n voxels are in."""
        tx_m, rx_m, k = paths
        centre_m = self.sampler.centres(voxel, self.level)
        at_m = self.sampler.metres(at)
        length_m = distances(at_m, tx_m[:, None]) + distances(at_m, rx_m[:, None])
        wave = self.waves.cycles_per_m(centre_m)
        away_m = at_m - centre_m[:, None]
        cycles = k[:, None] * length_m - np.einsum("nmi,ni->nm", away_m, wave)
        return np.exp(2j * np.pi * cycles)


def voxel_skeleton(
    array: AntennaArray, k: np.ndarray, sampler: PositionSampler, level: int, tolerance: float
) -> VoxelSkeleton | None:
    """Return the skeleton voxels of the blocks of a level, to an RMS error of `tolerance`.

    None where all three axes together do not keep it, or too many voxels would be needed.
    """
    waves = PlaneWaves(array, k)
    lines = [_LinePhases(array, k, sampler, level, axis, waves) for axis in range(3)]
    each = tolerance / np.sqrt(3)
    for _ in range(ROUNDS):
        x, y, z = (
            decompose_sampled(
                lambda line=line: line.samples(  # type: ignore[misc]
                    max(MIN_SAMPLES, SAMPLES_PER_POINT * line.n_points) // N_FAMILIES
                ),
                each,
            )
            for line in lines
        )
        if len(x.skeleton) > MOST_KEPT:
            return None
        found = VoxelSkeleton((x, y, z), waves)
        error = _rms_error(found, lines[0])
        if error <= tolerance:
            return found
        each *= 0.7 * tolerance / error
    return None


def _rms_error(found: VoxelSkeleton, phases: _LinePhases) -> float:
    """Return the RMS error of all axes together on new voxels: the largest of the families."""
    voxel, paths = draw_samples(phases, CHECKED, phases.level)
    first = voxel // phases.size * phases.size
    inside = (voxel - first).astype(int)
    grids = np.meshgrid(*(axis.skeleton for axis in found.axes), indexing="ij")
    kept = np.stack(grids, axis=-1).reshape(-1, 3)
    value = phases.phasors(voxel, first[:, None] + kept, paths)
    value = value.reshape(len(voxel), *found.counts)
    x, y, z = (axis.weights[inside[:, i]] for i, axis in enumerate(found.axes))
    value = np.einsum("nxyz,nz->nxy", value, z)
    value = np.einsum("nxy,ny->nx", value, y)
    error = np.einsum("nx,nx->n", value, x) - phases.phasors(voxel, voxel[:, None], paths)[:, 0]
    parts = np.stack([error.real, error.imag], axis=1)
    return float(phasor_rms(parts.reshape(N_FAMILIES, 2 * CHECKED, 1)).max())
