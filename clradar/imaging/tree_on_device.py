"""The tree of blocks on a device: what both ways through it share.

Ulander, Hellsten, Stenstroem 2003, with skeleton antennas and frequencies in place of subapertures:
see `clradar.imaging.block_tree`. Kernels: ``kernels/tree_sums.cl`` and, for smallest
blocks, ``backproject_fast.cl`` and ``forward_fast.cl``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.grid_blocks import GridBlocks
from clradar.imaging.point_blocks import PointBlocks
from clradar.model import AntennaArray, Waveform
from clradar.opencl import Buffers, Device, build
from clradar.opencl.buffers import antenna_rows, hi_lo
from clradar.opencl.program import private_length

FLOAT32_SHARE = 0.3
"""Fraction of the tolerance that float32 phases may take; beyond it they are double-single."""

WEIGHTS_TILE = 4  # weighted sums that a kernel makes per pass; weights are padded to a multiple
CPU_CHUNK_BYTES = 8 * 2**20
"""What the blocks of one launch may take: about what stays in a CPU's cache."""

GPU_CHUNK_BYTES = 256 * 2**20

MOST_GROUPS = 16
"""Groups of lanes whose phasors to the skeleton of a smallest block an item of the way up holds."""

GROUPS_TIMES_LEAF = 512  # most groups times antennas: they are in private memory

AnyBlocks = GridBlocks | PointBlocks


def groups_of_leaf(leaf: int) -> int:
    """Groups of lanes of an item of the way up, for so many antennas of a smallest block."""
    return min(MOST_GROUPS, max(1, GROUPS_TIMES_LEAF // leaf))


@dataclass(frozen=True, slots=True, kw_only=True)
class _SumSizes:
    """Compile-time constants of ``tree_sums.cl``."""

    width: int
    rows: int
    far: bool
    tile: int = WEIGHTS_TILE


@dataclass(frozen=True, slots=True, kw_only=True)
class _KernelSizes:
    """Those of ``backproject_fast.cl``."""

    width: int
    leaf: int
    far: bool
    points: bool
    kept: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class _ForwardSizes:
    """Those of ``forward_fast.cl``."""

    width: int
    leaf: int
    far: bool
    points: bool
    groups: int
    tile: int = WEIGHTS_TILE


@dataclass(frozen=True, slots=True, eq=False)
class Antennas:
    """The antennas of one side, and how they are reduced to their skeleton."""

    antennas_m: np.ndarray  # (n, 3), float64
    n_skeleton: int
    planes: Any  # buffer of the antennas, as the kernels read them
    weights: Any  # buffer, from the antennas to the skeleton; for the way up transposed

    @property
    def n(self) -> int:
        return len(self.antennas_m)


@dataclass(frozen=True, slots=True, eq=False)
class LevelStep:
    """From one level to the next. Down, rows are summed first; up, columns.

    Rows are the transmitters on even levels and the receivers on odd ones; the skeleton of the
    columns becomes the rows of the next level.
    """

    rows: Antennas
    columns: Antennas
    n_frequencies: int
    n_skeleton_frequencies: int
    k: Any
    frequency_weights: Any


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Some blocks of one level and their samples."""

    index: np.ndarray  # (n, ...), int: which blocks
    centre_m: np.ndarray  # (n, 3), float32
    centres: Any  # buffer of the same
    g: Any  # buffer, float (n, frequencies, rows, 2, columns), see the kernels


@dataclass(frozen=True, slots=True, eq=False)
class Leaf:
    """What all smallest blocks share, see ``kernels/common/smallest_blocks.h``."""

    n_voxels: int
    n_offsets: int
    offsets: Any
    place: Any
    rows: Any
    columns: Any
    k: Any


class TreeOnDevice:
    """Antennas, weights and smallest blocks of one tree, uploaded for one way through it.

    A context manager, which frees its buffers.
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        blocks: AnyBlocks,
        tolerance: float,
        buffers: Buffers,
        *,
        upwards: bool,
    ) -> None:
        self.array, self.blocks, self.buffers, device = array, blocks, buffers, buffers.device
        self.k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        self.width, self.unit = device.width, column_unit(device)
        self.levels, self.upwards = blocks.levels, upwards
        self._held: list[Any] = []
        self._middle: Any = None
        chunk = GPU_CHUNK_BYTES if device.info.kind == "gpu" else CPU_CHUNK_BYTES
        self.chunk_bytes = min(chunk, device.budget_bytes // 16)
        self.skeleton = blocks.skeleton if isinstance(blocks, GridBlocks) else None
        self.steps = [self._step(i) for i in range(len(self.levels))]
        rows = max(side.n for step in self.steps for side in (step.rows, step.columns))
        leaf = max(self.steps[-1].rows.n_skeleton, self.steps[-1].columns.n_skeleton)
        far = float32_phase_error(array, self.k, blocks.diagonal_m) > FLOAT32_SHARE * tolerance
        sums = _SumSizes(width=self.width, rows=private_length(rows, 32, device), far=far)
        self.sums = build(device, "tree_sums.cl", sums)
        sizes: dict[str, Any] = {
            "width": self.width, "leaf": private_length(leaf, 16, device), "far": far,
            "points": isinstance(blocks, PointBlocks),
        }  # fmt: skip
        if upwards:
            forward = _ForwardSizes(**sizes, groups=groups_of_leaf(padded(leaf, 16)))
            self.program = build(device, "forward_fast.cl", forward)
        else:
            if self.skeleton is not None:
                sizes["kept"] = private_length(self.skeleton.counts[0], 8, device)
            self.program = build(device, "backproject_fast.cl", _KernelSizes(**sizes))
        self.leaf = self._leaf(far)

    def __enter__(self) -> TreeOnDevice:
        return self

    def __exit__(self, *error: Any) -> None:
        self.release(*self._held)

    def release(self, *held: Any) -> None:
        for buffer in held:
            self.buffers.release(buffer)

    def blocks_at_once(self, i: int, striped: bool = False) -> int:
        """Return how many blocks of level i make one chunk; `striped` are those of which a few at a
        time need more than their result."""
        step = self.steps[i]
        rows, columns = step.rows, step.columns
        row = 8 * padded(rows.n_skeleton, self.unit)
        phasors = 8 * (padded(rows.n, self.unit) + padded(columns.n, self.unit))
        per_frequency = row * (columns.n + columns.n_skeleton) + phasors
        n_bytes = step.n_skeleton_frequencies * columns.n_skeleton * row
        if not striped:
            n_bytes += step.n_frequencies * per_frequency
        if self.skeleton is not None and i + 1 == len(self.steps):
            planes = self.skeleton.counts[2] + self.levels[i].voxels[2]
            n_bytes += 4 * self.skeleton.row * self.skeleton.counts[1] * planes
        return max(1, self.chunk_bytes // n_bytes)

    def phasors(
        self,
        i: int,
        centre_m: np.ndarray,
        centres: Any,
        above: Blocks,
        parents: Any,
    ) -> list[Any]:
        """Return buffers of the phasors of rows and columns that refer samples from the centres of
        the blocks above to those of blocks of level i."""
        step, n = self.steps[i], len(centre_m)
        if i == 0:
            return [self.buffers.upload(phasors) for phasors in self.root_phasors(step, centre_m)]
        sides = (step.rows, step.columns)
        found = [
            self.buffers.empty(8 * n * step.n_frequencies * padded(side.n, self.unit))
            for side in sides
        ]
        self.start_phasors(i, n, centres, above, parents, found)
        return found

    def start_phasors(
        self, i: int, n: int, centres: Any, above: Blocks, parents: Any, out: list[Any]
    ) -> None:
        """Start writing the phasors of rows and columns of n blocks, below the first level."""
        step, u = self.steps[i], np.uint32
        for side, phasors in zip((step.rows, step.columns), out, strict=True):
            count = padded(side.n, self.unit)
            self.sums.start(
                "block_phasors", (count // self.width, n), u(count), u(n), u(step.n_frequencies),
                side.planes, step.k, centres, above.centres, parents, phasors,
                work=40.0 * step.n_frequencies,
            )  # fmt: skip

    def root(self, cube: Any) -> Blocks:
        """Return the one block above the first level: the antennas' samples, about the origin."""
        middle_m = np.zeros((1, 3), np.float32)
        if self._middle is None:
            self._middle = self._kept(middle_m)
        return Blocks(np.zeros((1, 3), np.int64), middle_m, self._middle, cube)

    def leaf_arguments(self, blocks: Blocks) -> tuple[list[Any], list[Any], list[Any]]:
        """Return numbers, per-block buffers and shared buffers of the kernels of smallest blocks.

        The per-block buffers are the caller's to free.
        """
        step, leaf, u = self.steps[-1], self.leaf, np.uint32
        n, exact_m = len(blocks.index), self.blocks.centres_m(len(self.steps) - 1, blocks.index)
        rest_m = self.blocks.rest_m(exact_m, blocks.centre_m)
        first = self.blocks.first(blocks.index)
        held = [self.buffers.upload(a) for a in (rest_m.astype(np.float32), first)]
        numbers = [
            leaf.n_voxels, n, step.n_skeleton_frequencies, step.columns.n_skeleton,
            step.rows.n_skeleton, padded(step.rows.n_skeleton, self.unit), *self.blocks.counts,
            leaf.n_offsets,
        ]  # fmt: skip
        shared = [leaf.place, leaf.rows, leaf.columns, leaf.k]
        return [u(number) for number in numbers], [leaf.offsets, blocks.centres, *held], shared

    def leaf_work(self) -> float:
        """Operations of a voxel of a smallest block at each of its frequencies."""
        step = self.steps[-1]
        n_rows, n_columns = step.rows.n_skeleton, step.columns.n_skeleton
        return 8.0 * n_rows * n_columns + 50.0 * (n_rows + n_columns)

    def _kept(self, array: np.ndarray) -> Any:
        """Upload an array that is freed at the end."""
        self._held.append(self.buffers.upload(array))
        return self._held[-1]

    def _step(self, i: int) -> LevelStep:
        level, array = self.levels[i], self.array
        if i == 0:
            tx, rx, k = array.tx_m, array.rx_m, self.k
        else:
            above = self.levels[i - 1]
            tx, rx = array.tx_m[above.tx.skeleton], array.rx_m[above.rx.skeleton]
            k = self.k[above.frequency.skeleton]
        sides = [(tx, level.tx), (rx, level.rx)]
        units = (WEIGHTS_TILE, self.unit) if self.upwards else (self.unit, WEIGHTS_TILE)
        rows, columns = (
            Antennas(
                antennas_m,
                len(part.skeleton),
                self._kept(self._antenna_planes(antennas_m)),
                self._weights(part.weights, unit),
            )
            for (antennas_m, part), unit in zip(
                sides if i % 2 == 0 else sides[::-1], units, strict=True
            )
        )
        n_skeleton = len(level.frequency.skeleton)
        weights = self._weights(level.frequency.weights, WEIGHTS_TILE)
        k_rows = self._kept(np.stack(hi_lo(k)))
        return LevelStep(rows, columns, len(k), n_skeleton, k_rows, weights)

    def _weights(self, weights: np.ndarray, multiple: int) -> Any:
        used = weights.T if self.upwards else weights
        out = np.zeros((len(used), padded(used.shape[1], multiple)), np.float32)
        out[:, : used.shape[1]] = used
        return self._kept(out)

    def _antenna_planes(self, antennas_m: np.ndarray) -> np.ndarray:
        planes = np.zeros((6, padded(len(antennas_m), self.unit)), np.float32)
        planes[:, : len(antennas_m)] = antenna_rows(antennas_m).T
        return planes

    def _leaf(self, far: bool) -> Leaf:
        level = self.levels[-1]
        n_voxels, planes, place = self.blocks.leaf(self.width, far)
        tx_m, rx_m = self.array.tx_m[level.tx.skeleton], self.array.rx_m[level.rx.skeleton]
        # The last step's columns have become rows.
        rows, columns = (rx_m, tx_m) if len(self.levels) % 2 else (tx_m, rx_m)
        arrays = [
            place,
            antenna_rows(rows),
            antenna_rows(columns),
            np.stack(hi_lo(self.k[level.frequency.skeleton])),
        ]
        self._held.append(self.buffers.borrow(planes))
        kept = [self._kept(array) for array in arrays]
        return Leaf(n_voxels, planes.shape[1], self._held[-len(kept) - 1], *kept)

    def root_phasors(self, step: LevelStep, centre_m: np.ndarray) -> list[np.ndarray]:
        """Return the phasors of the largest blocks: of whole lengths, so in float64."""
        made = []
        for antennas_m in (step.rows.antennas_m, step.columns.antennas_m):
            out_m = centre_m.astype(np.float64)[:, None] - antennas_m
            cycles = self.k[:, None] * np.linalg.norm(out_m, axis=-1)[:, None]
            angle = 2.0 * np.pi * (cycles - np.round(cycles))
            shape = (len(centre_m), len(self.k), 2, padded(len(antennas_m), self.unit))
            out = np.zeros(shape, np.float32)
            out[:, :, 0, : len(antennas_m)] = np.cos(angle)
            out[:, :, 1, : len(antennas_m)] = np.sin(angle)
            made.append(out)
        return made


def float32_phase_error(array: AntennaArray, k: np.ndarray, diagonal_m: float) -> float:
    """Return the largest phase error, radians, if path lengths in metres are float32 numbers.

    From the centre of a block to the voxels in it a distance to an antenna changes by half the
    block's diagonal at most, and the largest block is the whole region. Beside the rounding of such
    a difference and of k there is that of the antennas' coordinates, which counts twice where the
    direction to the antenna reverses.
    """
    coordinate_m = max(np.abs(array.tx_m).max(), np.abs(array.rx_m).max())
    length_m = 2.0 * 0.5 * diagonal_m + 2.0 * coordinate_m
    return float(2.0 * np.pi * k.max() * length_m * 2.0**-25)


def column_unit(device: Device) -> int:
    """Columns are padded to a multiple of this: whole lanes, and whole passes over weights."""
    return max(device.width, WEIGHTS_TILE)


def padded(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple
