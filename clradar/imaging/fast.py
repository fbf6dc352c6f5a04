"""Fast factorised back-projection and its adjoint, for voxels and points.

One tree of blocks (`clradar.imaging.block_tree`) for each part of the array and each piece of the
grid or of the points; `WayDown` forms the image, `WayUp` the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.imaging.block_tree import block_levels
from clradar.imaging.grid_blocks import GridBlocks
from clradar.imaging.point_blocks import PointBlocks, point_blocks
from clradar.imaging.tiled import Tile, planes_and_rows, tiles_of
from clradar.imaging.tree_on_device import AnyBlocks, TreeOnDevice, column_unit, padded
from clradar.imaging.way_down import WayDown
from clradar.imaging.way_up import WayUp
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform, checks
from clradar.model.progress import Progress
from clradar.opencl import Buffers, Device

TOLERANCE_DB = (-80.0, -30.0)
"""Tolerances that are accepted: below, float32 limits the accuracy; above, it is not faster."""

DEFAULT_TOLERANCE_DB = -50.0

MAX_ANTENNAS = 1024
"""Transmitters or receivers of one tree: a work-item holds one number for each in private memory.
Of larger arrays the images of the parts are added up."""

TILE_VOXELS = 2**23
"""Voxels or points of one tree. Larger grids are cut, by their own size alone, so that no result
depends on how much fits into a device's memory."""

FEW_TERMS = 2**30
"""Voxels times pairs times frequencies up to which the direct sum takes no longer than the choice
of skeletons: about 0.1 s."""

TILE_STEPS = 1000
"""Steps of progress per tile, whose trees differ."""

Report = Callable[[float], None]
"""Called with the fraction that is done."""


@dataclass(frozen=True, slots=True, eq=False)
class GridPiece:
    """A tile of a grid, and that tile as a grid."""

    tile: Tile
    grid: VoxelGrid

    def blocks(self, array: AntennaArray, waveform: Waveform, tolerance: float) -> GridBlocks:
        return GridBlocks(block_levels(array, waveform, self.grid, tolerance), self.grid)

    def values(self, volume: np.ndarray, blocks: AnyBlocks) -> np.ndarray:
        """Return the piece's values of a volume as the kernels read them, (2, n), float32."""
        part = volume[self.tile.z, self.tile.y]
        return np.stack([part.real, part.imag])

    def add(self, volume: np.ndarray, values: np.ndarray, blocks: AnyBlocks) -> None:
        """Add values to the piece's voxels."""
        real, imag = values.reshape(2, *self.grid.shape)
        volume.real[self.tile.z, self.tile.y] += real
        volume.imag[self.tile.z, self.tile.y] += imag


@dataclass(frozen=True, slots=True, eq=False)
class PointPiece:
    """Some of all points: their numbers and positions."""

    number: np.ndarray
    points_m: np.ndarray

    def blocks(self, array: AntennaArray, waveform: Waveform, tolerance: float) -> PointBlocks:
        return point_blocks(array, waveform, self.points_m, tolerance)

    def values(self, volume: np.ndarray, blocks: AnyBlocks) -> np.ndarray:
        """Return the piece's values as the kernels read them, in the order of the blocks."""
        part = volume[self._order(blocks)]
        return np.stack([part.real, part.imag])

    def add(self, volume: np.ndarray, values: np.ndarray, blocks: AnyBlocks) -> None:
        """Add values to the piece's points."""
        order = self._order(blocks)
        volume.real[order] += values[0]
        volume.imag[order] += values[1]

    def _order(self, blocks: AnyBlocks) -> np.ndarray:
        assert isinstance(blocks, PointBlocks)
        return self.number[blocks.cells.order]


class FastSum:
    """The sums over pairs and frequencies, and over voxels or points, to a tolerance."""

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        pieces: Sequence[GridPiece | PointPiece],
        tolerance_db: float,
        device: Device,
    ) -> None:
        self.array, self.waveform, self.pieces, self.device = array, waveform, pieces, device
        self.tolerance = 10.0 ** (tolerance_db / 20.0)
        self.parts = array_parts(array)
        self._blocks: dict[tuple[int, int], AnyBlocks] = {}

    def prepare(self) -> None:
        """Choose skeletons now and not when they are needed, and keep them."""
        for part in range(len(self.parts)):
            for piece in range(len(self.pieces)):
                self._blocks[part, piece] = self._blocks_of(part, piece)

    def adjoint(
        self, data: np.ndarray, weights: np.ndarray, out: np.ndarray, report: Report
    ) -> None:
        """Add the image of samples, weighted by frequency, to `out`: complex64, of all pieces."""
        with Buffers(self.device) as buffers:
            for i, (tx, rx, array) in enumerate(self.parts):
                cube = buffers.upload(self._cube(data[tx, rx], weights))
                for j, piece in enumerate(self.pieces):
                    blocks = self._blocks_of(i, j)
                    with (
                        self._tree(array, blocks, buffers, upwards=False) as tree,
                        WayDown(tree) as way,
                    ):
                        volume = way.image(cube, self._part_of(report, i, j))
                        image = buffers.read(volume, (2, way.n_values), np.float32)
                    piece.add(out, image, blocks)
                    del image  # before the next is read
                buffers.release(cube)

    def forward(self, volume: np.ndarray, out: np.ndarray, report: Report) -> None:
        """Add the samples of the values of all pieces to `out`: complex64, (n_tx, n_rx, n_freq)."""
        with Buffers(self.device) as buffers:
            for i, (tx, rx, array) in enumerate(self.parts):
                for j, piece in enumerate(self.pieces):
                    blocks = self._blocks_of(i, j)
                    values = piece.values(volume, blocks)
                    with self._tree(array, blocks, buffers, upwards=True) as tree:
                        cube = WayUp(tree, self._part_of(report, i, j)).samples(values)
                    out.real[tx, rx] += cube[:, :, 0].transpose(1, 2, 0)
                    out.imag[tx, rx] += cube[:, :, 1].transpose(1, 2, 0)

    def _blocks_of(self, part: int, piece: int) -> AnyBlocks:
        kept = self._blocks.get((part, piece))
        if kept is not None:
            return kept
        return self.pieces[piece].blocks(self.parts[part][2], self.waveform, self.tolerance)

    def _tree(
        self, array: AntennaArray, blocks: AnyBlocks, buffers: Buffers, *, upwards: bool
    ) -> TreeOnDevice:
        return TreeOnDevice(array, self.waveform, blocks, self.tolerance, buffers, upwards=upwards)

    def _part_of(self, report: Report, part: int, piece: int) -> Report:
        n = len(self.parts) * len(self.pieces)
        return lambda share: report((part * len(self.pieces) + piece + share) / n)

    def _cube(self, data: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return some antennas' data as one block: (n_freq, n_tx, 2, padded n_rx), float32."""
        data = data.transpose(2, 0, 1)
        n_rx = data.shape[2]
        shape = (*data.shape[:2], 2, padded(n_rx, column_unit(self.device)))
        cube = np.zeros(shape, dtype=np.float32)
        weights = weights[:, None, None]
        np.multiply(data.real, weights, out=cube[:, :, 0, :n_rx], casting="same_kind")
        np.multiply(data.imag, weights, out=cube[:, :, 1, :n_rx], casting="same_kind")
        return cube


class FastImager:
    """The image of a capture over a grid."""

    def __init__(
        self,
        capture: Capture,
        grid: VoxelGrid,
        weights: np.ndarray,
        device: Device,
        tolerance_db: float,
    ) -> None:
        self.capture, self.grid, self.weights = capture, grid, weights
        self.sum = FastSum(capture.array, capture.waveform, grid_pieces(grid), tolerance_db, device)

    def run(self, progress: Progress | None) -> np.ndarray:
        """Return the unscaled sum, shape (n_z, n_y, n_x), complex64."""
        out = np.zeros(self.grid.shape, dtype=np.complex64)
        total = TILE_STEPS * len(self.sum.parts) * len(self.sum.pieces)
        self.sum.adjoint(self.capture.data, self.weights, out, reported(progress, total))
        return out


def reported(progress: Progress | None, total: int) -> Report:
    """Return what calls `progress` with a share of `total` steps."""

    def report(share: float) -> None:
        if progress is not None:
            progress(round(total * share), total)

    return report


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


def grid_pieces(grid: VoxelGrid) -> list[GridPiece]:
    """Return the tiles of a grid; a grid of one tile is itself."""
    nx = grid.counts[0]
    tiles = list(tiles_of(grid, *planes_and_rows(grid, TILE_VOXELS // nx)))
    if len(tiles) == 1:
        return [GridPiece(tiles[0], grid)]
    origins = [grid.origin_m + grid.spacing_m * [0, t.y.start, t.z.start] for t in tiles]
    return [
        GridPiece(tile, VoxelGrid(origin_m, grid.spacing_m, (nx, tile.n_y, tile.n_z)))
        for tile, origin_m in zip(tiles, origins, strict=True)
    ]


def point_pieces(points_m: np.ndarray, number: np.ndarray | None = None) -> list[PointPiece]:
    """Return points, cut across their longest extent where they are too many.

    `number` says which of a larger set they are; all of it by default.
    """
    number = np.arange(len(points_m)) if number is None else number
    n_pieces = -(-len(points_m) // TILE_VOXELS)
    if n_pieces == 1:
        return [PointPiece(number, points_m)]
    longest = int(np.ptp(points_m, axis=0).argmax())
    order = np.argsort(points_m[:, longest], kind="stable")
    return [PointPiece(number[some], points_m[some]) for some in np.array_split(order, n_pieces)]
