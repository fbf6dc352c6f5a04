"""Images by parts: each capture on each piece of the grid, kept in a folder until all are there."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.console import print_line, progress_bar
from clradar.cli.inputs import ImageInput
from clradar.cli.options.groups import wrong_usage
from clradar.cli.options.measured import FrameOptions
from clradar.files.atomic import replacing
from clradar.imaging.several_captures import mean_over_pairs
from clradar.jobs import Job, Where
from clradar.jobs.job import KEY
from clradar.model.volume import depth_map_of_planes, plane_slabs

if TYPE_CHECKING:
    from clradar.imaging.fast import GridPiece
    from clradar.jobs import Where
    from clradar.model import ImageScale
    from clradar.model.progress import Progress

PARTS = "parts"
"""Folder of the images of single captures on pieces of the grid; of several captures alone."""

PIECES = "pieces"
"""Folder of the pieces of the image, which are there once all their parts are."""

WHOLE = "volume.h5"
"""The file that is written, before it gets its name beside the folder."""

OWN_NAMES = (KEY, PARTS, PIECES, WHOLE)

Part = tuple[int, int]
"""Numbers of a piece and of a capture."""


def capture_of(path: Path, frames: FrameOptions) -> tuple[cl.Capture, list[Path]]:
    """A capture and its files; wrong usage if the file is a volume."""

    found = ImageInput.open(path, frames)
    if isinstance(found.content, cl.Volume):
        raise wrong_usage("CAPTURE...", f"expected captures, got the volume {path}")
    return found.content, found.files


@dataclass(frozen=True, kw_only=True)
class PartSteps:
    """How a part is made, as plain values that a worker process gets."""

    folder: Path
    captures: tuple[Path, ...]
    frames: FrameOptions
    grid: cl.VoxelGrid
    imaging: Mapping[str, Any]
    device: cl.Device | str | None = None

    @cached_property
    def pieces(self) -> list[GridPiece]:
        from clradar.imaging.fast import grid_pieces

        return grid_pieces(self.grid)

    def run(self, part: Part, progress: Progress | None = None) -> None:
        """Image a capture on a piece of the grid, and write it."""

        piece, number = part
        capture, _ = capture_of(self.captures[number], self.frames)
        grid = self.pieces[piece].grid
        image = cl.backproject(
            capture, grid, check_grid=False, device=self.device, progress=progress, **self.imaging
        )
        _write(self.file_of(part), image.data)

    def file_of(self, part: Part) -> Path:
        """Of a single capture the parts are the pieces."""
        piece, number = part
        if len(self.captures) == 1:
            return self.piece_file(piece)
        return self.folder / PARTS / f"{piece:04d}-{number:04d}.npy"

    def piece_file(self, piece: int) -> Path:
        return self.folder / PIECES / f"{piece:04d}.npy"

    def left(self, piece: int) -> list[Part]:
        """The parts of a piece that are still to be made."""
        if self.piece_file(piece).is_file():
            return []
        parts = [(piece, number) for number in range(len(self.captures))]
        return [part for part in parts if not self.file_of(part).is_file()]

    def join(self, piece: int, n_samples: Sequence[int]) -> None:
        """Sum the parts of a piece, in the order of the captures, and remove them."""
        if not self.piece_file(piece).is_file():
            parts = [self.file_of((piece, number)) for number in range(len(self.captures))]
            grid = self.pieces[piece].grid
            image = np.empty(grid.shape, np.complex64)
            for slab in plane_slabs(grid):
                read = zip((_read(path)[slab] for path in parts), n_samples, strict=True)
                image[slab] = mean_over_pairs(read, image[slab].shape)
            _write(self.piece_file(piece), image)
        for path in (self.folder / PARTS).glob(f"{piece:04d}-*.npy"):
            path.unlink()


def _write(path: Path, image: np.ndarray) -> None:
    with replacing(path, force=True) as temporary, open(temporary, "xb") as file:
        np.save(file, image)


def _read(path: Path) -> np.ndarray:
    found: np.ndarray = np.load(path, mmap_mode="r", allow_pickle=False)
    return found


@dataclass(frozen=True, kw_only=True)
class PartedImage:
    """An image whose planes are read from its pieces: `clradar.model.volume.Planes`."""

    steps: PartSteps
    meta: Mapping[str, Any]
    scale: ImageScale | None

    @property
    def grid(self) -> cl.VoxelGrid:
        return self.steps.grid

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, planes: slice) -> np.ndarray:
        first, stop, _ = planes.indices(len(self))
        out = np.empty((stop - first, *self.shape[1:]), np.complex64)
        for i, piece in enumerate(self.steps.pieces):
            low, high = max(first, piece.tile.z.start), min(stop, piece.tile.z.stop)
            if low < high:
                inner = slice(low - piece.tile.z.start, high - piece.tile.z.start)
                found = _read(self.steps.piece_file(i))[inner]
                out[low - first : high - first, piece.tile.y] = found
        return out

    def depth_map(self, dynamic_range_db: float) -> cl.DepthMap:
        """That of `volume`, which need not be in memory for it."""
        return depth_map_of_planes(self, self.grid, dynamic_range_db)

    def volume(self) -> cl.Volume:
        """The whole image, in memory."""

        data = self[:]
        data.flags.writeable = False
        return cl.Volume(data, self.grid, self.meta, self.scale)

    def save(self, path: Path, origin: Mapping[str, Any], *, force: bool) -> None:
        """Write it as a native volume, a few planes in memory at a time."""
        from measurement_io.native.records import save_planes

        whole = self.steps.folder / WHOLE
        save_planes(whole, self, self.grid, {**self.meta, **origin}, self.scale, force=True)
        with replacing(path, force=force) as temporary:
            os.replace(whole, temporary)


@contextmanager
def made_by_parts(
    steps: PartSteps,
    settings: Mapping[str, Any],
    n_samples: Sequence[int],
    where: Where,
    *,
    force: bool,
) -> Iterator[None]:
    """Make all parts that are not there yet; the folder is removed at the end of the block.

    `settings` are the key of the folder, `n_samples` those of each capture.
    """
    job = Job(
        folder=steps.folder, work="image", key=settings, own=OWN_NAMES, force=force,
        resumable=lambda folder: any(folder.glob("*/*.npy")),
    )  # fmt: skip
    with job.held():
        for name in (PARTS, PIECES):
            (steps.folder / name).mkdir(exist_ok=True)
        _make(job, steps, n_samples, where)
        yield
        job.clear()
    with suppress(OSError):  # it is gone, or holds something else
        steps.folder.rmdir()


def _make(job: Job, steps: PartSteps, n_samples: Sequence[int], where: Where) -> None:
    # Piece by piece, so that the parts of few pieces are on disk at the same time.
    left = {piece: set(steps.left(piece)) for piece in range(len(steps.pieces))}
    for piece in (piece for piece, parts in left.items() if not parts):
        steps.join(piece, n_samples)
    # Workers may be in other folders.
    captures = tuple(path.absolute() for path in steps.captures)
    sent = replace(steps, folder=steps.folder.absolute(), captures=captures)
    items = [(piece, number) for piece in left for number in range(len(n_samples))]
    with progress_bar("imaging") as progress:
        for (piece, number), _ in job.each(
            sent, items, where, done=lambda part: part not in left[part[0]],
            progress=progress, say=print_line, noun="part",
        ):  # fmt: skip
            left[piece].remove((piece, number))
            if not left[piece]:
                steps.join(piece, n_samples)
