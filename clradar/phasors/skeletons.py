"""Skeleton antennas and frequencies of blocks of space, chosen from sampled phases.

Within a block the phases relative to its centre vary little over antennas and frequencies, so few
of them approximate the rest (`clradar.phasors.interpolative`).
"""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import numpy as np

from clradar.model import AntennaArray
from clradar.phasors.interpolative import (
    Decomposition,
    decompose_sampled,
    matrix_product,
    phasor_rms,
)

MIN_SAMPLES = 480
SAMPLES_PER_POINT = 4
"""Sampled functions per antenna or frequency; as many complex numbers count twice."""

N_FAMILIES = 6  # families of voxels that samples are drawn of, see `draw_samples`
CANDIDATES = 4  # samples of which the one whose phase varies most is taken
PROBES = 8  # antennas of one side over which that variation is measured
CHECKED = 120  # voxels of each family that all levels together are checked on
LEVEL_ROUNDS = 6
"""How often the levels are chosen again with smaller errors before all points are kept."""

PathSet = tuple[np.ndarray, ...]
"""For each of n voxels the path that its phase is sampled on: frequency, or Tx and Rx."""


class PositionSampler(Protocol):
    """Draws random positions in blocks of a tree, as numbers of voxels, shape (n, 3)."""

    sizes: np.ndarray
    rng: np.random.Generator

    def spread(self, n: int, level: int) -> np.ndarray:
        """Return n positions spread over the blocks of a level and over each of these blocks."""

    def corners(self, n: int) -> np.ndarray:
        """Return n corners of the region."""

    def near(self, n: int) -> np.ndarray:
        """Return n positions close to antennas."""

    def centres(self, voxel: np.ndarray, levels: int | slice) -> np.ndarray:
        """Return the centres of the blocks that they are in, shape ([n_levels,] n, 3), metres."""

    def metres(self, at: np.ndarray) -> np.ndarray:
        """Return positions in metres."""


class SampledPhases(Protocol):
    """Phases in cycles at positions, along paths: what `draw_samples` draws."""

    sampler: PositionSampler

    def paths(self, voxel_m: np.ndarray) -> PathSet:
        """Return a random path for each of n voxels."""

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, PathSet]:
        """Return n of some voxels, and paths, whose phase relative to the centre varies most."""


class AntennaPhases:
    """Phases over the antennas of one side, in cycles; a path is its frequency."""

    def __init__(self, antennas_m: np.ndarray, k: np.ndarray, sampler: PositionSampler) -> None:
        self.antennas_m, self.k, self.sampler = antennas_m, k, sampler
        self.n_points, self.n_levels = len(antennas_m), len(sampler.sizes)

    def paths(self, voxel_m: np.ndarray) -> PathSet:
        """Return a random path for each of n voxels."""
        return (self.sampler.rng.choice(self.k, len(voxel_m)),)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, PathSet]:
        """Return n of some voxels, and paths, whose phase relative to the centre varies most."""
        paths = self.paths(voxel_m)
        some = self.sampler.rng.choice(self.n_points, min(PROBES, self.n_points), replace=False)
        cycles = self.cycles(voxel_m, paths, some) - self.cycles(centre_m, paths, some)
        chosen = _largest(np.ptp(cycles, axis=1), n)
        return chosen, (paths[0][chosen],)

    def cycles(self, at_m: np.ndarray, paths: PathSet, points: Any) -> np.ndarray:
        """Return the cycles to positions (..., n, 3) over some points, (..., n, n_points)."""
        return paths[0][:, None] * distances(at_m[..., None, :], self.antennas_m[points])


class FrequencyPhases:
    """Phases over the frequencies, in cycles from the band's centre; a path is its Tx and Rx."""

    def __init__(self, array: AntennaArray, k: np.ndarray, sampler: PositionSampler) -> None:
        # About the centre of the band, so that conjugate phasors are equally typical samples.
        self.sides = (array.tx_m, array.rx_m)
        self.offset, self.sampler = k - 0.5 * (k[0] + k[-1]), sampler
        self.n_points, self.n_levels = len(k), len(sampler.sizes)

    def paths(self, voxel_m: np.ndarray) -> PathSet:
        rng, n = self.sampler.rng, len(voxel_m)
        return tuple(side[rng.integers(0, len(side), n)] for side in self.sides)

    def hardest(
        self, voxel_m: np.ndarray, centre_m: np.ndarray, n: int
    ) -> tuple[np.ndarray, PathSet]:
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

    def cycles(self, at_m: np.ndarray, paths: PathSet, points: Any) -> np.ndarray:
        length = distances(at_m, paths[0]) + distances(at_m, paths[1])
        return length[..., None] * self.offset[points]


Phases = AntennaPhases | FrequencyPhases


def distances(a_m: np.ndarray, b_m: np.ndarray) -> np.ndarray:
    """Return distances between points of shape (..., 3), metres."""
    x, y, z = (a_m[..., i] - b_m[..., i] for i in range(3))
    return np.sqrt(x * x + y * y + z * z)


def _largest(values: np.ndarray, n: int) -> np.ndarray:
    return np.argsort(-values, kind="stable")[:n]


def draw_samples(phases: SampledPhases, n: int, level: int) -> tuple[np.ndarray, PathSet]:
    """Return n voxels of each of six families, and their paths; each family has to keep the
    tolerance on its own.

    Voxels spread over the blocks of a level; corners of the grid; voxels next to antennas; and of
    more of each those whose phase varies most over the points: the error of an interpolation rises
    steeply just beyond what has been sampled.
    """
    sampler, m = phases.sampler, CANDIDATES * n
    found: list[np.ndarray] = []
    chosen: list[PathSet] = []
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


def decompositions(phases: Phases, tolerance: float) -> list[Decomposition]:
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
    phases: Phases, level: int, points: np.ndarray, tolerance: float
) -> Decomposition:
    n = max(MIN_SAMPLES, SAMPLES_PER_POINT * len(points)) // N_FAMILIES

    def draw() -> np.ndarray:
        voxel, paths = draw_samples(phases, n, level)
        cycles = phases.cycles(phases.sampler.metres(voxel), paths, points)
        centre_m = phases.sampler.centres(voxel, level)
        cycles -= phases.cycles(centre_m, paths, points)
        angle = 2.0 * np.pi * cycles
        parts = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return parts.reshape(N_FAMILIES, 2 * n, -1)

    return decompose_sampled(draw, tolerance)


def _rms_error(phases: Phases, found: list[Decomposition]) -> float:
    """Return the RMS error of all levels together on new voxels: the largest of the families."""
    sampler, every = phases.sampler, np.arange(phases.n_points)
    voxel, paths = draw_samples(phases, CHECKED, phases.n_levels - 1)
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
