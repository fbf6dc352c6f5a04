"""Image formation over a tree of blocks: host side of ``kernels/backproject_fast.cl``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.block_tree import Level, levels
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform
from clradar.model.progress import Progress
from clradar.opencl import Buffers, Device, Program, build
from clradar.opencl.double_single import antenna_rows, hi_lo

TOLERANCE_DB = (-80.0, -30.0)
"""Errors that can be asked for: below, float32 has the last word; above, nothing gets quicker."""

DEFAULT_TOLERANCE_DB = -50.0

MAX_ANTENNAS = 1024
"""Transmitters or receivers of one tree: a work-item holds one number for each in private memory.
Of larger arrays the images of the parts are added up."""

TILE_VOXELS = 2**23
"""Voxels of one tree. Larger grids are cut, by their own size alone, so that what fits into a
device's memory has no part in the result."""

FEW_TERMS = 2**30
"""Voxels times pairs times frequencies up to which the sum as it stands takes no longer than the
choice of antennas and frequencies: about 0.1 s."""

TILE_STEPS = 1000
"""Steps of progress per tile, whose trees differ."""

FLOAT32_SHARE = 0.3
"""Share of the tolerance that single float32 phases may take; beyond it they are made of two."""

ROW_TILE = 4
"""TILE of the kernels: weights are padded to a multiple."""

CPU_CHUNK_BYTES = 8 * 2**20
"""What the blocks of one launch may take: about what stays in a CPU's cache."""

GPU_CHUNK_BYTES = 256 * 2**20

NO_VOXEL = 2**30
"""Index of the voxels that fill up a block to whole lanes: outside every grid."""


@dataclass(frozen=True, slots=True)
class _Options:
    width: int
    rows: int
    leaf: int
    far: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """From the level above to one level: sizes and constants. Rows are summed first.

    Of odd levels the rows are receivers, of even ones transmitters; what is left of the columns
    becomes the rows of the next.
    """

    level: Level
    n_rows: int
    n_columns: int
    n_frequencies: int
    row_antennas_m: np.ndarray
    column_antennas_m: np.ndarray
    rows_left: int
    columns_left: int
    frequencies_left: int
    buffers: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Some blocks of one level, and what has been summed for them.

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

    def release(self, buffers: Buffers) -> None:
        buffers.release(self.centres)
        buffers.release(self.g)


class Fast:
    """The image over a tree of blocks."""

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
        tiles = list(_tiles(self.grid))
        parts = _antenna_parts(self.capture.array)
        steps = len(parts) * len(tiles)
        with Buffers(self.device) as buffers:
            for i, (tx, rx, array) in enumerate(parts):
                cube = buffers.upload(self._cube(tx, rx))
                for j, (place, grid) in enumerate(tiles):
                    tree = _Tree(
                        array, self.capture.waveform, grid, self.tolerance, self.device, buffers
                    )
                    image = tree.image(cube, progress, i * len(tiles) + j, steps)
                    out.real[place] += image[0]
                    out.imag[place] += image[1]
                    del image  # before the next is read
                buffers.release(cube)
        return out

    def _cube(self, tx: slice, rx: slice) -> np.ndarray:
        """Return some antennas' data as one block: (n_freq, n_tx, 2, padded n_rx), float32."""
        data = self.capture.data[tx, rx].transpose(2, 0, 1)
        n_rx = data.shape[2]
        shape = (*data.shape[:2], 2, _padded(n_rx, _unit(self.device)))
        cube = np.zeros(shape, dtype=np.float32)
        weights = self.weights[:, None, None]
        np.multiply(data.real, weights, out=cube[:, :, 0, :n_rx], casting="same_kind")
        np.multiply(data.imag, weights, out=cube[:, :, 1, :n_rx], casting="same_kind")
        return cube


class _Tree:
    """One grid of at most `TILE_VOXELS` voxels."""

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        grid: VoxelGrid,
        tolerance: float,
        device: Device,
        buffers: Buffers,
    ) -> None:
        self.array, self.grid = array, grid
        self.k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        self.device, self.buffers, self.width = device, buffers, device.width
        self.unit = _unit(device)
        self.levels = levels(array, waveform, grid, tolerance)
        self.far = _float32_error(array, self.k, grid) > FLOAT32_SHARE * tolerance
        chunk = GPU_CHUNK_BYTES if device.info.kind == "gpu" else CPU_CHUNK_BYTES
        self.chunk_bytes = min(chunk, device.budget_bytes // 16)
        self.done = 0

    def image(self, cube: Any, progress: Progress | None, tile: int, n_tiles: int) -> np.ndarray:
        """Return the unscaled sum, shape (2, n_z, n_y, n_x), float32."""
        shape = (2, *self.grid.shape)
        self.volume = self.buffers.empty(4 * int(np.prod(shape)))
        self.steps = [self._step(i) for i in range(len(self.levels))]
        self.program = self._program()
        self.leaf = self._leaf()
        self.progress, self.tile, self.n_tiles = progress, tile, n_tiles
        self._report()
        middle_m = np.zeros((1, 3), np.float32)
        centre = self.buffers.upload(middle_m)
        root = _Blocks(np.zeros((1, 3), np.int64), middle_m, centre, cube)
        self._descend(0, root, np.zeros((1, 3), np.int64), np.zeros(1, np.int32))
        out = self.buffers.read(self.volume, shape, np.float32)
        held = [self.volume, centre, *self.leaf.values()]
        for buffer in held + [b for step in self.steps for b in step.buffers.values()]:
            self.buffers.release(buffer)
        return out

    def _report(self) -> None:
        if self.progress is not None:
            of_tile = TILE_STEPS * self.done // int(np.prod(self.levels[-1].counts))
            self.progress(TILE_STEPS * self.tile + of_tile, TILE_STEPS * self.n_tiles)

    def _program(self) -> Program:
        """Build the kernels; sizes are rounded up, so that similar images share a program."""
        leaf = max(self.steps[-1].rows_left, self.steps[-1].columns_left)
        rows = max(max(step.n_rows, step.n_columns) for step in self.steps)
        options = _Options(self.width, _padded(rows, 32), _padded(leaf, 16), self.far)
        return build(self.device, "backproject_fast.cl", options)

    def _step(self, i: int) -> _Step:
        level, array = self.levels[i], self.array
        if i == 0:
            tx, rx, k = array.tx_m, array.rx_m, self.k
        else:
            above = self.levels[i - 1]
            tx, rx, k = array.tx_m[above.tx], array.rx_m[above.rx], self.k[above.frequency]
        sides = [(tx, level.tx_weights), (rx, level.rx_weights)]
        rows, columns = sides if i % 2 == 0 else sides[::-1]
        up = self.buffers.upload
        buffers = {
            "rows": up(self._antenna_planes(rows[0])),
            "columns": up(self._antenna_planes(columns[0])),
            "k": up(np.stack(hi_lo(k))),
            "row_weights": up(_weights(rows[1], self.unit)),
            "column_weights": up(_weights(columns[1], ROW_TILE)),
            "frequency_weights": up(_weights(level.frequency_weights, ROW_TILE)),
        }
        return _Step(
            level, len(rows[0]), len(columns[0]), len(k), rows[0], columns[0],
            rows[1].shape[1], columns[1].shape[1], len(level.frequency), buffers,
        )  # fmt: skip

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
        tx_m, rx_m = self.array.tx_m[level.tx], self.array.rx_m[level.rx]
        # The last step's columns have become rows.
        rows, columns = (rx_m, tx_m) if len(self.levels) % 2 else (tx_m, rx_m)
        arrays = {
            "offsets": antenna_rows(offset_m).T,
            "place": place.astype(np.int32),
            "rows": antenna_rows(rows),
            "columns": antenna_rows(columns),
            "k": np.stack(hi_lo(self.k[level.frequency])),
        }
        return {name: self.buffers.upload(array) for name, array in arrays.items()}

    def _descend(self, i: int, above: _Blocks, index: np.ndarray, parent: np.ndarray) -> None:
        """Go on with some blocks of level i, by and by, down to their voxels.

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
                self.done += len(blocks.index)
                self._report()
            blocks.release(self.buffers)

    def _block_bytes(self, step: _Step) -> int:
        """Device memory that a step takes per block."""
        row = 8 * _padded(step.rows_left, self.unit)
        turns = 8 * (_padded(step.n_rows, self.unit) + _padded(step.n_columns, self.unit))
        per_frequency = row * (step.n_columns + step.columns_left) + turns
        return step.n_frequencies * per_frequency + step.frequencies_left * step.columns_left * row

    def _children(self, i: int, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the blocks of level i + 1 in those of level i, and for each which one it is in."""
        ratio = np.array(self.levels[i].voxels) // np.array(self.levels[i + 1].voxels)
        inner = np.indices(tuple(ratio)).reshape(3, -1).T
        children = (index[:, None] * ratio + inner).reshape(-1, 3)
        parent = np.repeat(np.arange(len(index), dtype=np.int32), len(inner))
        there = (children < self.levels[i + 1].counts).all(axis=1)
        return children[there], parent[there]

    def _centres_m(self, level: Level, index: np.ndarray) -> np.ndarray:
        middle = index * np.array(level.voxels) + 0.5 * (np.array(level.voxels) - 1)
        return self.grid.origin_m + self.grid.spacing_m * middle

    def _reduced(self, i: int, above: _Blocks, index: np.ndarray, parent: np.ndarray) -> _Blocks:
        """Return blocks of level i, summed from those of the level above."""
        step, buffers, u = self.steps[i], self.buffers, np.uint32
        constants, start, width = step.buffers, self.program.start, self.width
        n, n_m = len(index), step.n_frequencies
        centre_m = self._centres_m(step.level, index).astype(np.float32)
        rows, columns = _padded(step.n_rows, self.unit), _padded(step.n_columns, self.unit)
        row_left = _padded(step.rows_left, self.unit)

        started: list[Callable[[], None]] = []
        parents, centres = buffers.upload(parent), buffers.upload(centre_m)
        if i == 0:
            row_turns = buffers.upload(self._first_turns(step.row_antennas_m, centre_m))
            column_turns = buffers.upload(self._first_turns(step.column_antennas_m, centre_m))
        else:
            row_turns = buffers.empty(8 * n * n_m * rows)
            column_turns = buffers.empty(8 * n * n_m * columns)
            for name, count, turns in (
                ("rows", rows, row_turns),
                ("columns", columns, column_turns),
            ):
                started.append(start(
                    "block_turns", (count // width, n), u(count), u(n), u(n_m), constants[name],
                    constants["k"], centres, above.centres, parents, turns,
                ))  # fmt: skip

        swapped = buffers.empty(8 * n * n_m * step.n_columns * row_left)
        started.append(start(
            "reduce_and_swap", (columns // width, n_m, n), u(columns), u(n_m), u(n),
            u(step.n_rows), u(row_left), u(step.n_columns), u(rows), above.g, parents, row_turns,
            constants["row_weights"], swapped,
        ))  # fmt: skip
        reduced = buffers.empty(8 * n * n_m * step.columns_left * row_left)
        started.append(start(
            "reduce_rows", (row_left // width, n_m, n), u(row_left), u(n_m), u(n),
            u(step.n_columns), u(step.columns_left), u(_padded(step.columns_left, ROW_TILE)),
            u(columns), swapped, column_turns, constants["column_weights"], reduced,
        ))  # fmt: skip
        n_values = 2 * step.columns_left * row_left
        g = buffers.empty(4 * n * step.frequencies_left * n_values)
        started.append(start(
            "reduce_frequencies", (n_values // width, n), u(n_values), u(n), u(n_m),
            u(step.frequencies_left), u(_padded(step.frequencies_left, ROW_TILE)), reduced,
            constants["frequency_weights"], g,
        ))  # fmt: skip
        for wait in started:
            wait()
        for buffer in (parents, row_turns, column_turns, swapped, reduced):
            buffers.release(buffer)
        return _Blocks(index, centre_m, centres, g)

    def _first_turns(self, antennas_m: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
        """Return the turns to the first block: whole lengths, so in float64."""
        length = np.linalg.norm(centre_m.astype(np.float64) - antennas_m, axis=1)
        turns = self.k[:, None] * length
        angle = 2.0 * np.pi * (turns - np.round(turns))
        out = np.zeros((len(self.k), 2, _padded(len(antennas_m), self.unit)), np.float32)
        out[:, 0, : len(antennas_m)] = np.cos(angle)
        out[:, 1, : len(antennas_m)] = np.sin(angle)
        return out

    def _image_of(self, blocks: _Blocks) -> None:
        """Write the voxels of some smallest blocks."""
        u, step, leaf = np.uint32, self.steps[-1], self.leaf
        exact_m = self._centres_m(step.level, blocks.index)
        n_voxels = _padded(int(np.prod(step.level.voxels)), self.width)
        n = len(blocks.index)
        own = [
            self.buffers.upload(array)
            for array in (
                (exact_m - blocks.centre_m).astype(np.float32),
                (blocks.index * np.array(step.level.voxels)).astype(np.int32),
            )
        ]
        self.program.launch(
            "image_of_blocks", (n_voxels // self.width, n), u(n_voxels), u(n),
            u(step.frequencies_left), u(step.columns_left), u(step.rows_left),
            u(_padded(step.rows_left, self.unit)), *(u(c) for c in self.grid.counts),
            blocks.g, leaf["offsets"], blocks.centres, *own, leaf["place"], leaf["rows"],
            leaf["columns"], leaf["k"], self.volume,
        )  # fmt: skip
        for buffer in own:
            self.buffers.release(buffer)


def _antenna_parts(array: AntennaArray) -> list[tuple[slice, slice, AntennaArray]]:
    """Return which Tx and Rx are imaged at a time, and these as an array."""
    if max(array.n_tx, array.n_rx) <= MAX_ANTENNAS:
        return [(slice(None), slice(None), array)]
    sides = []
    for n in (array.n_tx, array.n_rx):
        n_parts = -(-n // MAX_ANTENNAS)
        sides.append([slice(i * n // n_parts, (i + 1) * n // n_parts) for i in range(n_parts)])
    return [(t, r, AntennaArray(array.tx_m[t], array.rx_m[r])) for t in sides[0] for r in sides[1]]


def _tiles(grid: VoxelGrid) -> Iterator[tuple[tuple[slice, slice], VoxelGrid]]:
    """Yield the pieces of a grid: slices along z and y, and the piece."""
    nx, ny, nz = grid.counts
    rows = max(1, TILE_VOXELS // nx)
    n_z, n_y = (min(nz, rows // ny), ny) if rows >= ny else (1, rows)
    if (n_z, n_y) == (nz, ny):
        yield (slice(0, nz), slice(0, ny)), grid
        return
    for z in range(0, nz, n_z):
        for y in range(0, ny, n_y):
            counts = (nx, min(n_y, ny - y), min(n_z, nz - z))
            origin_m = grid.origin_m + grid.spacing_m * np.array([0, y, z])
            piece = VoxelGrid(origin_m, grid.spacing_m, counts)
            yield (slice(z, z + counts[2]), slice(y, y + counts[1])), piece


def _float32_error(array: AntennaArray, k: np.ndarray, grid: VoxelGrid) -> float:
    """Return the largest phase error, radians, of legs that are single float32 numbers of metres.

    From the centre of a block to what is in it legs change by half the block's diagonal at most,
    and the largest block is the grid. Beside the rounding of such a difference and of k there is
    that of the antennas' coordinates, which counts twice where the leg turns round.
    """
    diagonal_m = np.linalg.norm(grid.spacing_m * (np.array(grid.counts) - 1))
    coordinate_m = max(np.abs(array.tx_m).max(), np.abs(array.rx_m).max())
    leg_m = 2.0 * 0.5 * diagonal_m + 2.0 * coordinate_m
    return float(2.0 * np.pi * k.max() * leg_m * 2.0**-25)


def _unit(device: Device) -> int:
    """Columns are padded to a multiple of this: whole lanes, and whole passes over weights."""
    return max(device.width, ROW_TILE)


def _weights(weights: np.ndarray, multiple: int) -> np.ndarray:
    out = np.zeros((len(weights), _padded(weights.shape[1], multiple)), np.float32)
    out[:, : weights.shape[1]] = weights
    return out


def _padded(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple
