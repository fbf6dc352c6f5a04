"""Fast factorised back-projection and its adjoint, for voxels and points.

One tree of blocks (`clradar.imaging.block_tree`) for each part of the array and each piece of the
grid or of the points; `WayDown` forms the image, `WayUp` the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.imaging.block_tree import block_levels, image_levels
from clradar.imaging.grid_blocks import GridBlocks
from clradar.imaging.point_blocks import PointBlocks, point_blocks
from clradar.imaging.samples import SampleCube
from clradar.imaging.strongest import Strongest, StrongestAlongZ
from clradar.imaging.tiled import Tile, planes_and_rows, tiles_of
from clradar.imaging.tree_on_device import AnyBlocks, TreeOnDevice
from clradar.imaging.way_down import WayDown
from clradar.imaging.way_up import WayUp
from clradar.model import AntennaArray, VoxelGrid, Waveform, checks
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

TILE_STEPS = 1000  # steps of progress per tile, whose trees differ

Report = Callable[[float], None]
"""Called with the fraction that is done."""


@dataclass(frozen=True, slots=True, eq=False)
class GridPiece:
    """A tile of a grid, and that tile as a grid."""

    tile: Tile
    grid: VoxelGrid

    def blocks(
        self, array: AntennaArray, waveform: Waveform, tolerance: float, both_ways: bool
    ) -> GridBlocks:
        if both_ways:
            return GridBlocks(block_levels(array, waveform, self.grid, tolerance), self.grid)
        levels, skeleton = image_levels(array, waveform, self.grid, tolerance)
        return GridBlocks(levels, self.grid, skeleton)

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

    def blocks(
        self, array: AntennaArray, waveform: Waveform, tolerance: float, both_ways: bool
    ) -> PointBlocks:
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
    """The sums over pairs and frequencies, and over voxels or points, to a tolerance.

    `both_ways`: the two are adjoint to each other, and no voxel is interpolated from others.
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        pieces: Sequence[GridPiece | PointPiece],
        tolerance_db: float,
        device: Device,
        *,
        both_ways: bool,
    ) -> None:
        self._both_ways = both_ways
        self.array, self.waveform, self.pieces, self.device = array, waveform, pieces, device
        self.tolerance = 10.0 ** (tolerance_db / 20.0)
        self.parts = array_parts(array)
        self._blocks: dict[tuple[int, int], AnyBlocks] = {}

    def prepare(self) -> None:
        """Choose skeletons now and not when they are needed, and keep them."""
        for part in range(len(self.parts)):
            for piece in range(len(self.pieces)):
                self._blocks[part, piece] = self.blocks_of(part, piece)

    def adjoint(
        self, data: np.ndarray, weights: np.ndarray, out: np.ndarray, report: Report
    ) -> None:
        """Add the image of samples, weighted by frequency, to `out`: complex64, of all pieces."""
        with Buffers(self.device) as buffers:
            samples = buffers.borrow(data)
            for i, (tx, rx, array) in enumerate(self.parts):
                cube = SampleCube(tx, rx, data.shape[1], weights, buffers)
                filled = cube.fill(samples)
                for j, piece in enumerate(self.pieces):
                    blocks = self.blocks_of(i, j)
                    with (
                        self.tree(array, blocks, buffers, upwards=False) as tree,
                        WayDown(tree) as way,
                    ):
                        volume = way.image(filled, self._part_of(report, i, j))
                        image = buffers.read(volume, (2, way.n_values), np.float32)
                    piece.add(out, image, blocks)
                    del image  # before the next is read
                cube.release()

    def forward(self, volume: np.ndarray, out: np.ndarray, report: Report) -> None:
        """Add the samples of the values of all pieces to `out`: complex64, (n_tx, n_rx, n_freq)."""
        with Buffers(self.device) as buffers:
            for i, (tx, rx, array) in enumerate(self.parts):
                for j, piece in enumerate(self.pieces):
                    blocks = self.blocks_of(i, j)
                    values = piece.values(volume, blocks)
                    with self.tree(array, blocks, buffers, upwards=True) as tree:
                        cube = WayUp(tree, self._part_of(report, i, j)).samples(values)
                    out.real[tx, rx] += cube[:, :, 0].transpose(1, 2, 0)
                    out.imag[tx, rx] += cube[:, :, 1].transpose(1, 2, 0)

    def blocks_of(self, part: int, piece: int) -> AnyBlocks:
        kept = self._blocks.get((part, piece))
        if kept is not None:
            return kept
        array = self.parts[part][2]
        return self.pieces[piece].blocks(array, self.waveform, self.tolerance, self._both_ways)

    def tree(
        self, array: AntennaArray, blocks: AnyBlocks, buffers: Buffers, *, upwards: bool
    ) -> TreeOnDevice:
        return TreeOnDevice(array, self.waveform, blocks, self.tolerance, buffers, upwards=upwards)

    def _part_of(self, report: Report, part: int, piece: int) -> Report:
        n = len(self.parts) * len(self.pieces)
        return lambda share: report((part * len(self.pieces) + piece + share) / n)


class ResidentImage:
    """The image of one capture after the other, over one tree, on the device.

    Tree, skeletons, weights and all buffers stay there until `close`; of a frame its samples go
    there, and nothing comes back but what is asked for. On a CPU the samples are read where they
    are.
    """

    def __init__(self, total: FastSum, weights: np.ndarray) -> None:
        ((tx, rx, array),) = total.parts
        (self._piece,) = total.pieces
        assert isinstance(self._piece, GridPiece)
        self._blocks, device = total.blocks_of(0, 0), total.device
        self._shape = self._piece.grid.shape
        self._divisor = np.float32(array.n_tx * array.n_rx * len(weights))
        self._buffers = Buffers(device)
        self._depth: StrongestAlongZ | None = None
        try:
            self._samples = None
            if device.info.kind != "cpu":
                self._samples = self._buffers.empty(8 * array.n_tx * array.n_rx * len(weights))
            self._cube = SampleCube(tx, rx, array.n_rx, weights, self._buffers)
            self._tree = total.tree(array, self._blocks, self._buffers, upwards=False)
            self._way = WayDown(self._tree)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._buffers.close(waiting=True)

    def form(self, data: np.ndarray, report: Report) -> None:
        """Form the image of a capture's samples."""
        if self._samples is not None:
            self._buffers.write(self._samples, data)
            self._way.image(self._cube.fill(self._samples), report)
            return
        lent = self._buffers.borrow(data)
        try:
            self._way.image(self._cube.fill(lent), report)
        finally:
            self._buffers.release(lent)

    def form_on_device(self, samples: Any, stride: int, report: Report) -> None:
        """The same of samples on the device, complex64 (n_tx, n_rx, stride)."""
        self._way.image(self._cube.fill(samples, stride), report)

    def read(self) -> np.ndarray:
        """Return the unscaled sum, shape (n_z, n_y, n_x), complex64."""
        out = np.zeros(self._shape, dtype=np.complex64)
        values = self._buffers.read(self._way.volume, (2, self._way.n_values), np.float32)
        self._piece.add(out, values, self._blocks)
        return out

    def strongest(self) -> Strongest:
        """Return the strongest voxels along z of the image divided by the number of samples."""
        if self._depth is None:
            self._depth = StrongestAlongZ(self._shape, self._buffers)
        return self._depth.of(self._way.volume, self._divisor)


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
        return [(slice(0, array.n_tx), slice(0, array.n_rx), array)]
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
