"""The files of ``clradar image``, and images of large grids or several captures, made by parts.

A part is one capture on a piece of the grid; parts are kept in a folder until all are there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import clradar as cl
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.inputs import ImageInput, nothing_to_draw, title_of
from clradar.cli.options.groups import given, option, output_option, wrong_usage
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ModelImagingOptions,
    PictureOptions,
    grid_text,
)
from clradar.cli.outputs import PAGES, check_figure, check_outputs, check_suffix, provenance
from clradar.errors import MeasurementError
from clradar.files.atomic import replacing, write_file
from clradar.imaging.fast import GridPiece, grid_pieces
from clradar.imaging.frame_imager import image_meta
from clradar.imaging.grid_check import warn_of_grid
from clradar.imaging.several_captures import KeptCaptures, mean_over_pairs
from clradar.imaging.windows import frequency_weights
from clradar.jobs import Job, Where
from clradar.jobs.job import KEY, remove
from clradar.jobs.lock import LOCK
from clradar.model import ImageScale
from clradar.model.progress import Progress
from clradar.model.volume import depth_map_of_planes, plane_slabs


@dataclass(frozen=True, kw_only=True)
class ImageFiles(PictureOptions):
    """Files of an image, one of which has to be written."""

    output: Path | None = output_option("Volume to write (HDF5).")
    png: Path | None = option(
        "Draw amplitude and depth: .png, .pdf or .svg.", names=("--png", "--figure")
    )
    report: Path | None = option("Page: figure, 3-D view, facts and settings in one .html file.")
    dbsm: bool = option("Draw radar cross sections in dBsm, of S-parameters.", False)

    def check(self, *, force: bool, inputs: list[Path]) -> None:
        """Raise unless all of them may be written, and there is one."""
        if not self.files:
            raise wrong_usage("-o", "expected a volume to write, or --png, or --report; got none")
        remove_remains(self.parts)
        check_figure(self.png)
        check_suffix(self.report, PAGES)
        check_outputs(self.files, force=force, inputs=inputs)

    @property
    def files(self) -> list[Path]:
        """Those that were asked for."""
        return [file for file in (self.output, self.png, self.report) if file is not None]

    @property
    def parts(self) -> Path:
        """The folder of parts, beside the first of them."""
        return self.files[0].with_name(f"{self.files[0].name}.parts")

    def draw(
        self,
        image: cl.Volume | PartedImage,
        title: str,
        source: str,
        origin: Mapping[str, Any],
        range_db: float,
        *,
        force: bool,
    ) -> None:
        """Write figure and page, as far as they were asked for."""
        from clradar.plot import image_figure, plane_of, save_figure
        from clradar.plot.views import thin_view
        from clradar.report import ReportImage, image_report

        if self.png is None and self.report is None:
            return
        volume: cl.Volume | cl.DepthMap
        flat = (self.view or thin_view(image.grid)) == "xy" and self.slice is None
        if isinstance(image, cl.Volume):
            volume = image
        elif flat and not (self.report or self.dbsm):
            volume = depth_map_of_planes(image, image.grid, range_db)  # without it in memory
        else:
            volume = image.volume()
        reason = nothing_to_draw(volume)
        if reason is not None:
            for path in (self.png, self.report):
                if path is not None:
                    print_warning(f"{path}: not drawn, since the image is {reason}")
            return
        shown: dict[str, Any] = {"dynamic_range_db": range_db, "view": self.view, "dbsm": self.dbsm}
        if self.png is not None:
            drawn = volume
            if self.plane is not None and isinstance(volume, cl.Volume):
                drawn = plane_of(volume, *self.plane)
            with progress_bar("drawing"):
                save_figure(image_figure(drawn, title, **shown), self.png, force=force)
            print_line(f"{self.png}: the picture, {range_db:g} dB")
        if self.report is not None and isinstance(volume, cl.Volume):
            with progress_bar("writing the page"):
                page = image_report(ReportImage(title, volume, source), settings=origin, **shown)
            write_file(self.report, page.encode("utf-8"), force=force)
            print_line(f"{self.report}: the image as a page, to be opened in a browser")


@dataclass(frozen=True, kw_only=True)
class ImageOptions(GridOptions, ModelImagingOptions):
    """How an image is formed, and where."""

    everything: bool = option(
        "Without a grid: one around all echoes up to 25 dB below the strongest.",
        False,
        names=("--all-echoes",),
        without="--x-mm --y-mm --z-mm",
    )
    tolerance_db: float | None = option(
        "Error of fast and by iteration, RMS over RMS, -80 to -30. [default: -50]"
    )
    absolute: bool = option("The samples are S-parameters.", False)

    def check(
        self, loaded: ImageInput, captures: list[Path], files: ImageFiles, others: Mapping[str, Any]
    ) -> None:
        """Raise where an option has no meaning for what is read."""
        if len(captures) > 1:
            if isinstance(loaded.content, cl.Volume):
                raise wrong_usage("CAPTURE...", f"expected captures, got the volume {loaded.path}")
            wrong = {"--method": self.fitted, "--dbsm": files.dbsm, "--absolute": self.absolute}
            for name in (name for name, is_wrong in wrong.items() if is_wrong):
                raise wrong_usage(name, "expected with a single capture, not with several")
        divided = ["--dbsm"] * files.dbsm + [name for name in others if name != "--device"]
        if self.fitted and divided:
            raise wrong_usage(divided[0], f"not an option of --method {self.method}")
        if files.dbsm and not (self.absolute or loaded.content.absolute):
            raise MeasurementError(
                f"{loaded.path}: expected S-parameters for --dbsm, got samples on a relative "
                "scale; --absolute says that they are S-parameters"
            )
        if isinstance(loaded.content, cl.Volume):
            chosen = {**given(self), "-o": files.output, **others}
            for name in (name for name, value in chosen.items() if value is not None):
                raise wrong_usage(name, "the input is a volume, which is an image already")


STOPPED = {
    "noise": "what is left looks like noise",
    "change": "it changes no more",
    "iterations": "no more were asked for",
}
"""How an image by iteration ended: `clradar.reconstruct` explains the reasons."""


def print_fit(volume: cl.Volume) -> None:
    """Say how an image by iteration ended."""
    left_db, count = volume.meta["residual_db"], volume.meta["iterations"]
    left = "nothing" if left_db is None else f"{left_db:.1f} dB of the samples"
    reason = STOPPED[volume.meta["stopped"]]
    print_line(f"{volume.meta['method']}: {count} iterations, {reason}; left: {left}")


def title_of_image(captures: Sequence[Path], meta: Mapping[str, Any]) -> str:
    """The title of an image of one or several captures."""
    first, *others = captures
    return f"{first.name} and {len(others)} more" if others else title_of(first, meta)


PARTS = "parts"
"""Folder of the images of single captures on pieces of the grid, and of the pieces of the image,
which are there once all their parts are."""

WHOLE = "volume.h5"
"""The file that is written, before it gets its name beside the folder."""

Part = tuple[int, int]
"""Numbers of a piece and of a capture."""


def remove_remains(folder: Path) -> None:
    """Remove a folder whose image was complete when the process was killed.

    Its settings go first at the end, so that nothing could resume there.
    """
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else {KEY}
    if names <= {WHOLE, LOCK}:
        remove(folder, names)
        folder.rmdir()


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
        """The pieces of the grid."""
        return grid_pieces(self.grid)

    def run(self, part: Part, progress: Progress | None = None) -> None:
        """Image a capture on a piece of the grid, and write it."""
        piece, number = part
        capture, _ = capture_of(self.captures[number], self.frames)
        image = cl.backproject(
            capture, self.pieces[piece].grid, check_grid=False, device=self.device,
            progress=progress, **self.imaging,
        )  # fmt: skip
        _write(self.file_of(part), image.data)

    def file_of(self, part: Part) -> Path:
        """Of a single capture the parts are the pieces."""
        piece, number = part
        if len(self.captures) == 1:
            return self.piece_file(piece)
        return self.folder / PARTS / f"{piece:04d}-{number:04d}.npy"

    def piece_file(self, piece: int) -> Path:
        """The file of a piece of the image."""
        return self.folder / PARTS / f"{piece:04d}.npy"

    def is_done(self, part: Part) -> bool:
        """Whether a part is there, or its piece of the image."""
        return self.piece_file(part[0]).is_file() or self.file_of(part).is_file()

    def join(self, piece: int, n_samples: Sequence[int]) -> None:
        """Sum the parts of a piece, in the order of the captures, and remove them."""
        parts = [self.file_of((piece, number)) for number in range(len(self.captures))]
        if not self.piece_file(piece).is_file():
            grid = self.pieces[piece].grid
            image = np.empty(grid.shape, np.complex64)
            for slab in plane_slabs(grid):
                read = zip((_read(path)[slab] for path in parts), n_samples, strict=True)
                image[slab] = mean_over_pairs(read, image[slab].shape)
            _write(self.piece_file(piece), image)
        if len(parts) > 1:
            for path in parts:
                path.unlink(missing_ok=True)


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

    def volume(self) -> cl.Volume:
        """The whole image, in memory."""
        data = self[:]
        data.flags.writeable = False
        return cl.Volume(data, self.grid, self.meta, self.scale)


def image_by_parts(
    steps: PartSteps,
    samples: cl.Capture,
    files: ImageFiles,
    options: Mapping[str, Any],
    range_db: float,
    opened: cl.Device,
    where: Where,
    *,
    force: bool,
) -> None:
    """Write and draw an image of a large grid, or of several captures.

    `samples` are those of the first capture.
    """
    from measurement_io.native.records import save_planes

    start_s = perf_counter()
    grid, how = steps.grid, steps.imaging
    sizes, metas, read, kept = [], [], [], KeptCaptures()
    for path in steps.captures:
        capture, found = capture_of(path, steps.frames)
        sizes.append(capture.data.size)
        metas.append(capture.meta)
        kept.add(capture)
        read += found
    alone = len(sizes) == 1
    weights = frequency_weights(how["window"], samples.waveform.n_freq)
    meta = {**image_meta(device=opened, **how), "capture": samples.meta if alone else metas}
    scale = ImageScale(samples.array, samples.waveform, weights) if samples.absolute else None
    image = PartedImage(steps=steps, meta=meta, scale=scale if alone else None)
    origin = provenance("image", read, **options)
    job = Job(
        folder=steps.folder, work="image", own=(KEY, PARTS, WHOLE), force=force,
        key={
            **options, "tolerance_db": how["tolerance_db"], "origin_m": grid.origin_m.tolist(),
            "spacing_m": grid.spacing_m.tolist(), "counts": list(grid.counts),
            "inputs": origin["inputs"], "clradar": origin["clradar"], "device": opened.describe(),
        },
        resumable=lambda folder: any(folder.glob(f"{PARTS}/*.npy")),
    )  # fmt: skip
    with job.held():
        (steps.folder / PARTS).mkdir(exist_ok=True)
        _make(job, steps, sizes, where)
        warn_of_grid(samples if alone else kept, grid, image, weights, opened)
        whole = steps.folder / WHOLE
        if files.output is not None:
            save_planes(whole, image, grid, {**meta, **origin}, image.scale, force=True)
        title = title_of_image(steps.captures, meta)
        files.draw(image, title, str(steps.captures[0]), origin, range_db, force=force)
        job.clear([KEY, PARTS])
        if files.output is not None:
            with replacing(files.output, force=force) as temporary:
                os.replace(whole, temporary)
            took = f"{perf_counter() - start_s:.1f} s on {opened.info.label}"
            print_line(f"{files.output}: {grid_text(grid)}, {took}")
    with suppress(OSError):  # it is gone, or holds something else
        steps.folder.rmdir()


def _make(job: Job, steps: PartSteps, n_samples: Sequence[int], where: Where) -> None:
    items = [(i, n) for i in range(len(steps.pieces)) for n in range(len(n_samples))]
    # Piece by piece, so that the parts of few pieces are on disk at the same time.
    left = {i: {n for n in range(len(n_samples)) if not steps.is_done((i, n))} for i, _ in items}
    for piece in (piece for piece, numbers in left.items() if not numbers):
        steps.join(piece, n_samples)
    with progress_bar("imaging") as progress:
        for (piece, number), _ in job.each(
            steps, items, where, done=lambda part: part[1] not in left[part[0]],
            progress=progress, say=print_line, noun="part",
        ):  # fmt: skip
            left[piece].remove(number)
            if not left[piece]:
                steps.join(piece, n_samples)
