"""Fast factorised back-projection: host side of ``kernels/backproject_fast.cl``.

Ulander, Hellsten, Stenstroem 2003, with skeleton antennas and frequencies in place of subapertures:
see `clradar.imaging.block_tree`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.block_tree import BlockLevel, block_levels
from clradar.imaging.tiled import Tile, planes_and_rows, tiles_of
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform, checks
from clradar.model.progress import Progress
from clradar.opencl import Buffers, Device, build
from clradar.opencl.double_single import antenna_rows, hi_lo

TOLERANCE_DB = (-80.0, -30.0)
"""Tolerances that are accepted: below, float32 limits the accuracy; above, it is not faster."""

DEFAULT_TOLERANCE_DB = -50.0

MAX_ANTENNAS = 1024
"""Transmitters or receivers of one tree: a work-item holds one number for each in private memory.
Of larger arrays the images of the parts are added up."""

TILE_VOXELS = 2**23
"""Voxels of one tree. Larger grids are cut, by their own size alone, so that no result depends on
how much fits into a device's memory."""

FEW_TERMS = 2**30
"""Voxels times pairs times frequencies up to which the direct sum takes no longer than the choice
of skeletons: about 0.1 s."""

TILE_STEPS = 1000
"""Steps of progress per tile, whose trees differ."""

FLOAT32_SHARE = 0.3
"""Fraction of the tolerance that float32 phases may take; beyond it they are double-single."""

WEIGHTS_TILE = 4
"""Weighted sums that a kernel makes per pass; weights are padded to a multiple."""

CPU_CHUNK_BYTES = 8 * 2**20
"""What the blocks of one launch may take: about what stays in a CPU's cache."""

GPU_CHUNK_BYTES = 256 * 2**20

NO_VOXEL = 2**30
"""Index of the voxels that fill up a block to whole lanes: outside every grid."""


@dataclass(frozen=True, slots=True)
class _KernelSizes:
    """Compile-time constants of the kernels."""

    width: int
    rows: int
    leaf: int
    far: bool
    tile: int = WEIGHTS_TILE


@dataclass(frozen=True, slots=True, eq=False)
class _Antennas:
    """The antennas of one side, and how they are reduced to their skeleton.

    Attributes
    ----------
    antennas_m : ndarray, shape (n, 3), float64, metres
    n_skeleton : int
    planes : Buffer
        The antennas, as the kernels read them.
    weights : Buffer
    """

    antennas_m: np.ndarray
    n_skeleton: int
    planes: Any
    weights: Any

    @property
    def n(self) -> int:
        return len(self.antennas_m)


@dataclass(frozen=True, slots=True, eq=False)
class _LevelStep:
    """From one level to the next. Rows are summed first.

    Rows are the transmitters on even levels and the receivers on odd ones; the skeleton of the
    columns becomes the rows of the next level.
    """

    level: BlockLevel
    rows: _Antennas
    columns: _Antennas
    n_frequencies: int
    n_skeleton_frequencies: int
    k: Any
    frequency_weights: Any

    def buffers(self) -> list[Any]:
        antennas = [b for side in (self.rows, self.columns) for b in (side.planes, side.weights)]
        return [*antennas, self.k, self.frequency_weights]


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Some blocks of one level and their samples.

    Attributes
    ----------
    index : ndarray, shape (n, 3), int
        x, y, z index of each block.
    centre_m : ndarray, shape (n, 3), float32
    centres : Buffer
        The same.
    g : Buffer
        float (n, frequencies, rows, 2, columns), see the kernels.
    """

    index: np.ndarray
    centre_m: np.ndarray
    centres: Any
    g: Any


class FastImager:
    """The image over one tree of blocks for each tile of the grid and part of the array."""

    def __init__(
        self,
        capture: Capture,
        grid: VoxelGrid,
        weights: np.ndarray,
        device: Device,
        tolerance_db: float,
    ) -> None:
        self.capture, self.grid, self.device = capture, grid, device
        self.weights, self.tolerance = weights, 10.0 ** (tolerance_db / 20.0)

    def run(self, progress: Progress | None) -> np.ndarray:
        """Return the unscaled sum, shape (n_z, n_y, n_x), complex64."""
        out = np.zeros(self.grid.shape, dtype=np.complex64)
        tiles = grid_tiles(self.grid)
        parts = array_parts(self.capture.array)
        total = TILE_STEPS * len(parts) * len(tiles)
        done = 0

        def report(share: float) -> None:
            if progress is not None:
                progress(done + int(TILE_STEPS * share), total)

        with Buffers(self.device) as buffers:
            for tx, rx, array in parts:
                cube = buffers.upload(self._cube(tx, rx))
                for tile, grid in tiles:
                    waveform = self.capture.waveform
                    tree = _Tree(array, waveform, grid, self.tolerance, buffers, report)
                    image = tree.image(cube)
                    out.real[tile.z, tile.y] += image[0]
                    out.imag[tile.z, tile.y] += image[1]
                    del image  # before the next is read
                    done += TILE_STEPS
                buffers.release(cube)
        return out

    def _cube(self, tx: slice, rx: slice) -> np.ndarray:
        """Return some antennas' data as one block: (n_freq, n_tx, 2, padded n_rx), float32."""
        data = self.capture.data[tx, rx].transpose(2, 0, 1)
        n_rx = data.shape[2]
        shape = (*data.shape[:2], 2, _padded(n_rx, _column_unit(self.device)))
        cube = np.zeros(shape, dtype=np.float32)
        weights = self.weights[:, None, None]
        np.multiply(data.real, weights, out=cube[:, :, 0, :n_rx], casting="same_kind")
        np.multiply(data.imag, weights, out=cube[:, :, 1, :n_rx], casting="same_kind")
        return cube


class _Tree:
    """One grid of at most `TILE_VOXELS` voxels; `report` gets the fraction that is done."""

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        grid: VoxelGrid,
        tolerance: float,
        buffers: Buffers,
        report: Callable[[float], None],
    ) -> None:
        self.report = report
        self.array, self.grid, self.buffers, device = array, grid, buffers, buffers.device
        self.k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        self.width, self.unit = device.width, _column_unit(device)
        self.levels = block_levels(array, waveform, grid, tolerance)
        chunk = GPU_CHUNK_BYTES if device.info.kind == "gpu" else CPU_CHUNK_BYTES
        self.chunk_bytes = min(chunk, device.budget_bytes // 16)
        self.volume = buffers.empty(8 * int(np.prod(grid.shape)))
        self.steps = [self._step(i) for i in range(len(self.levels))]
        # Sizes are rounded up, so that similar images share a program.
        rows = max(side.n for step in self.steps for side in (step.rows, step.columns))
        leaf = max(self.steps[-1].rows.n_skeleton, self.steps[-1].columns.n_skeleton)
        far = float32_phase_error(array, self.k, grid) > FLOAT32_SHARE * tolerance
        sizes = _KernelSizes(self.width, _padded(rows, 32), _padded(leaf, 16), far)
        self.program = build(device, "backproject_fast.cl", sizes)
        self.leaf = self._leaf()
        self.n_done, self.n_leaves = 0, int(np.prod(self.levels[-1].counts))

    def image(self, cube: Any) -> np.ndarray:
        """Return the unscaled sum, shape (2, n_z, n_y, n_x), float32, and free all buffers."""
        self.report(0.0)
        middle_m = np.zeros((1, 3), np.float32)
        centre = self.buffers.upload(middle_m)
        root = _Blocks(np.zeros((1, 3), np.int64), middle_m, centre, cube)
        self._descend(0, root, np.zeros((1, 3), np.int64), np.zeros(1, np.int32))
        out = self.buffers.read(self.volume, (2, *self.grid.shape), np.float32)
        constants = [b for step in self.steps for b in step.buffers()]
        self._release(self.volume, centre, *self.leaf.values(), *constants)
        return out

    def _release(self, *held: Any) -> None:
        for buffer in held:
            self.buffers.release(buffer)

    def _step(self, i: int) -> _LevelStep:
        level, array, up = self.levels[i], self.array, self.buffers.upload
        if i == 0:
            tx, rx, k = array.tx_m, array.rx_m, self.k
        else:
            above = self.levels[i - 1]
            tx, rx = array.tx_m[above.tx.skeleton], array.rx_m[above.rx.skeleton]
            k = self.k[above.frequency.skeleton]
        sides = [(tx, level.tx), (rx, level.rx)]
        rows, columns = (
            _Antennas(
                antennas_m,
                len(part.skeleton),
                up(self._antenna_planes(antennas_m)),
                up(_padded_weights(part.weights, unit)),
            )
            for (antennas_m, part), unit in zip(
                sides if i % 2 == 0 else sides[::-1], (self.unit, WEIGHTS_TILE), strict=True
            )
        )
        n_skeleton = len(level.frequency.skeleton)
        weights = up(_padded_weights(level.frequency.weights, WEIGHTS_TILE))
        return _LevelStep(level, rows, columns, len(k), n_skeleton, up(np.stack(hi_lo(k))), weights)

    def _antenna_planes(self, antennas_m: np.ndarray) -> np.ndarray:
        planes = np.zeros((6, _padded(len(antennas_m), self.unit)), np.float32)
        planes[:, : len(antennas_m)] = antenna_rows(antennas_m).T
        return planes

    def _leaf(self) -> dict[str, Any]:
        """Upload what all smallest blocks share."""
        level = self.levels[-1]
        n_x, n_y, n_z = level.voxels
        index = np.arange(_padded(n_x * n_y * n_z, self.width))
        place = np.stack([index % n_x, index // n_x % n_y, index // (n_x * n_y)], axis=1)
        offset_m = self.grid.spacing_m * (place - 0.5 * (np.array(level.voxels) - 1))
        place[n_x * n_y * n_z :] = NO_VOXEL
        tx_m, rx_m = self.array.tx_m[level.tx.skeleton], self.array.rx_m[level.rx.skeleton]
        # The last step's columns have become rows.
        rows, columns = (rx_m, tx_m) if len(self.levels) % 2 else (tx_m, rx_m)
        arrays = {
            "offsets": antenna_rows(offset_m).T,
            "place": place.astype(np.int32),
            "rows": antenna_rows(rows),
            "columns": antenna_rows(columns),
            "k": np.stack(hi_lo(self.k[level.frequency.skeleton])),
        }
        return {name: self.buffers.upload(array) for name, array in arrays.items()}

    def _descend(self, i: int, above: _Blocks, index: np.ndarray, parent: np.ndarray) -> None:
        """Form the image of blocks of level i by depth-first recursion, a chunk of them at a time.

        Parameters
        ----------
        index : ndarray, shape (n, 3)
            Blocks of level i.
        parent : ndarray, shape (n,), int32
            For each the block of `above` that it lies in.
        """
        at_once = max(1, self.chunk_bytes // self._block_bytes(self.steps[i]))
        for start in range(0, len(index), at_once):
            part = slice(start, start + at_once)
            blocks = self._reduced(i, above, index[part], parent[part])
            if i + 1 < len(self.levels):
                self._descend(i + 1, blocks, *self._children(i, blocks.index))
            else:
                self._image_of(blocks)
                self.n_done += len(blocks.index)
                self.report(self.n_done / self.n_leaves)
            self._release(blocks.centres, blocks.g)

    def _block_bytes(self, step: _LevelStep) -> int:
        """Device memory that a step takes per block."""
        rows, columns = step.rows, step.columns
        row = 8 * _padded(rows.n_skeleton, self.unit)
        phasors = 8 * (_padded(rows.n, self.unit) + _padded(columns.n, self.unit))
        per_frequency = row * (columns.n + columns.n_skeleton) + phasors
        skeleton = step.n_skeleton_frequencies * columns.n_skeleton * row
        return step.n_frequencies * per_frequency + skeleton

    def _children(self, i: int, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the blocks of level i + 1 in those of level i, and for each which one it is in."""
        ratio = np.array(self.levels[i].voxels) // np.array(self.levels[i + 1].voxels)
        inner = np.indices(tuple(ratio)).reshape(3, -1).T
        children = (index[:, None] * ratio + inner).reshape(-1, 3)
        parent = np.repeat(np.arange(len(index), dtype=np.int32), len(inner))
        inside = (children < self.levels[i + 1].counts).all(axis=1)
        return children[inside], parent[inside]

    def _centres_m(self, level: BlockLevel, index: np.ndarray) -> np.ndarray:
        middle = index * np.array(level.voxels) + 0.5 * (np.array(level.voxels) - 1)
        return self.grid.origin_m + self.grid.spacing_m * middle

    def _reduced(self, i: int, above: _Blocks, index: np.ndarray, parent: np.ndarray) -> _Blocks:
        """Return blocks of level i, summed from those of the level above."""
        step, buffers, u, width = self.steps[i], self.buffers, np.uint32, self.width
        rows, columns, n, n_m = step.rows, step.columns, len(index), step.n_frequencies
        n_rows, n_columns = _padded(rows.n, self.unit), _padded(columns.n, self.unit)
        new_row = _padded(rows.n_skeleton, self.unit)
        centre_m = self._centres_m(step.level, index).astype(np.float32)
        parents, centres = buffers.upload(parent), buffers.upload(centre_m)
        started: list[Callable[[], None]] = []

        def start(kernel: str, size: tuple[int, ...], *args: Any) -> None:
            started.append(self.program.start(kernel, size, *args))

        phasors = []
        for side, count in ((rows, n_rows), (columns, n_columns)):
            if i == 0:
                phasors.append(buffers.upload(self._root_phasors(side.antennas_m, centre_m)))
                continue
            phasors.append(buffers.empty(8 * n * n_m * count))
            start(
                "block_phasors", (count // width, n), u(count), u(n), u(n_m), side.planes, step.k,
                centres, above.centres, parents, phasors[-1],
            )  # fmt: skip
        transposed = buffers.empty(8 * n * n_m * columns.n * new_row)
        start(
            "reduce_and_transpose", (n_columns // width, n_m, n), u(n_columns), u(n_m), u(n),
            u(rows.n), u(new_row), u(columns.n), u(n_rows), above.g, parents, phasors[0],
            rows.weights, transposed,
        )  # fmt: skip
        reduced = buffers.empty(8 * n * n_m * columns.n_skeleton * new_row)
        start(
            "reduce_rows", (new_row // width, n_m, n), u(new_row), u(n_m), u(n), u(columns.n),
            u(columns.n_skeleton), u(_padded(columns.n_skeleton, WEIGHTS_TILE)), u(n_columns),
            transposed, phasors[1], columns.weights, reduced,
        )  # fmt: skip
        n_values, n_left = 2 * columns.n_skeleton * new_row, step.n_skeleton_frequencies
        g = buffers.empty(4 * n * n_left * n_values)
        start(
            "reduce_frequencies", (n_values // width, n), u(n_values), u(n), u(n_m), u(n_left),
            u(_padded(n_left, WEIGHTS_TILE)), reduced, step.frequency_weights, g,
        )  # fmt: skip
        for wait in started:
            wait()
        self._release(parents, *phasors, transposed, reduced)
        return _Blocks(index, centre_m, centres, g)

    def _root_phasors(self, antennas_m: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
        """Return the phasors of the largest block: of whole lengths, so in float64."""
        length = np.linalg.norm(centre_m.astype(np.float64) - antennas_m, axis=1)
        cycles = self.k[:, None] * length
        angle = 2.0 * np.pi * (cycles - np.round(cycles))
        out = np.zeros((len(self.k), 2, _padded(len(antennas_m), self.unit)), np.float32)
        out[:, 0, : len(antennas_m)] = np.cos(angle)
        out[:, 1, : len(antennas_m)] = np.sin(angle)
        return out

    def _image_of(self, blocks: _Blocks) -> None:
        """Write the voxels of some smallest blocks."""
        u, step, leaf = np.uint32, self.steps[-1], self.leaf
        n, n_voxels = len(blocks.index), _padded(int(np.prod(step.level.voxels)), self.width)
        rest_m = self._centres_m(step.level, blocks.index) - blocks.centre_m
        rests = self.buffers.upload(rest_m.astype(np.float32))
        first = blocks.index * np.array(step.level.voxels)
        firsts = self.buffers.upload(first.astype(np.int32))
        self.program.launch(
            "image_of_blocks", (n_voxels // self.width, n), u(n_voxels), u(n),
            u(step.n_skeleton_frequencies), u(step.columns.n_skeleton), u(step.rows.n_skeleton),
            u(_padded(step.rows.n_skeleton, self.unit)), *(u(c) for c in self.grid.counts),
            blocks.g, leaf["offsets"], blocks.centres, rests, firsts, leaf["place"], leaf["rows"],
            leaf["columns"], leaf["k"], self.volume,
        )  # fmt: skip
        self._release(rests, firsts)


def checked_tolerance_db(field: str, given: float | None) -> float:
    """Return the tolerance, `DEFAULT_TOLERANCE_DB` where none is given."""
    if given is None:
        return DEFAULT_TOLERANCE_DB
    value = checks.real(field, given)
    low, high = TOLERANCE_DB
    if not low <= value <= high:
        checks.fail(field, f"{low:g} to {high:g} dB", f"{value:g}")
    return value


def array_parts(array: AntennaArray) -> list[tuple[slice, slice, AntennaArray]]:
    """Return which Tx and Rx are imaged at a time, and these as an array."""
    if max(array.n_tx, array.n_rx) <= MAX_ANTENNAS:
        return [(slice(None), slice(None), array)]
    sides = []
    for n in (array.n_tx, array.n_rx):
        n_parts = -(-n // MAX_ANTENNAS)
        sides.append([slice(i * n // n_parts, (i + 1) * n // n_parts) for i in range(n_parts)])
    return [(t, r, array.part(t, r)) for t in sides[0] for r in sides[1]]


def grid_tiles(grid: VoxelGrid) -> list[tuple[Tile, VoxelGrid]]:
    """Return the tiles of a grid, and each as a grid; a grid of one tile is itself."""
    nx = grid.counts[0]
    tiles = list(tiles_of(grid, *planes_and_rows(grid, TILE_VOXELS // nx)))
    if len(tiles) == 1:
        return [(tiles[0], grid)]
    origins = [grid.origin_m + grid.spacing_m * [0, t.y.start, t.z.start] for t in tiles]
    return [
        (tile, VoxelGrid(origin_m, grid.spacing_m, (nx, tile.n_y, tile.n_z)))
        for tile, origin_m in zip(tiles, origins, strict=True)
    ]


def float32_phase_error(array: AntennaArray, k: np.ndarray, grid: VoxelGrid) -> float:
    """Return the largest phase error, radians, if path lengths in metres are float32 numbers.

    From the centre of a block to the voxels in it a distance to an antenna changes by half the
    block's diagonal at most, and the largest block is the grid. Beside the rounding of such a
    difference and of k there is that of the antennas' coordinates, which counts twice where the
    direction to the antenna reverses.
    """
    diagonal_m = np.linalg.norm(grid.spacing_m * (np.array(grid.counts) - 1))
    coordinate_m = max(np.abs(array.tx_m).max(), np.abs(array.rx_m).max())
    length_m = 2.0 * 0.5 * diagonal_m + 2.0 * coordinate_m
    return float(2.0 * np.pi * k.max() * length_m * 2.0**-25)


def _column_unit(device: Device) -> int:
    """Columns are padded to a multiple of this: whole lanes, and whole passes over weights."""
    return max(device.width, WEIGHTS_TILE)


def _padded_weights(weights: np.ndarray, multiple: int) -> np.ndarray:
    out = np.zeros((len(weights), _padded(weights.shape[1], multiple)), np.float32)
    out[:, : weights.shape[1]] = weights
    return out


def _padded(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple
