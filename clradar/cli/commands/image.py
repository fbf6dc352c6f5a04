"""``image``: the image of captures, at once or by parts, each a capture on a piece of the grid."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np

import clradar as cl
from clradar.cli import console, images as img, options as opt, outputs as out
from clradar.errors import MeasurementError
from clradar.files.atomic import replacing
from clradar.imaging.fast import GridPiece, grid_pieces
from clradar.imaging.several_captures import mean_over_pairs
from clradar.jobs import KEY, Where
from clradar.model import ImageScale
from clradar.model.progress import Progress
from clradar.model.volume import depth_map_of_planes, plane_slabs
from clradar.plot.views import plane_index, thin_view

# Names in the folder of a begun image.
PARTS = "parts"  # images of captures on pieces of the grid; of all, once all their parts are there
WHOLE = "volume.h5"  # before it gets its name beside the folder

Part = tuple[int, int]  # numbers of a piece and of a capture


@dataclass(frozen=True, kw_only=True)
class ImageFiles(opt.PictureOptions):
    output: Path | None = opt.output_option("Volume to write (HDF5).")
    png: Path | None = opt.figure("Draw amplitude and depth", "--png")
    report: Path | None = opt.page("Page (.html): figure, 3-D view, facts and settings.")
    dbsm: bool = opt.option(
        "Draw radar cross sections in dBsm, of S-parameters.",
        False,
        without=opt.ITERATED,
        kept=False,
    )

    def flat(self, grid: cl.VoxelGrid) -> bool:
        """Whether the depth map of an image is enough."""
        seen_from_front = (self.view or thin_view(grid)) == "xy" and self.slice is None
        return seen_from_front and not (self.report or self.dbsm)


@dataclass(frozen=True, kw_only=True)
class ImageOptions(opt.GridOptions, opt.ImagingOptions):
    """How an image is formed, also by iteration, and where."""

    # A wider choice than that of the other commands.
    method: Literal["fast", "range", "exact", "least-squares", "sparse"] = opt.option(  # type: ignore[assignment]
        f"{opt.METHODS} By iteration (needs pylops): least-squares, or sparse, of few voxels.",
        "fast",
    )
    iterations: int | None = opt.option(
        "At most, of an image by iteration. [default: 30, sparse 100]",
        min=1,
        needs=opt.ITERATED,
    )
    damping_db: float | None = opt.option(
        "Of least-squares: weight of the power. [default: none]", needs="--method=least-squares"
    )
    sparsity_db: float | None = opt.option(
        "Of sparse: threshold below the maximum. [default: -30]", needs="--method=sparse"
    )
    everything: bool = opt.option(
        "Without a grid: one around all echoes up to 25 dB below the strongest.",
        False,
        "--all-echoes",
        without="--x-mm --y-mm --z-mm",
    )
    tolerance_db: float | None = opt.option(
        "Error of fast and by iteration, RMS over RMS, -80 to -30. [default: -50]"
    )
    absolute: bool = opt.option("The samples are S-parameters.", False)

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`, or of `clradar.reconstruct`."""
        names = ("iterations", "damping_db", "sparsity_db") if self.iterated else ("window",)
        return {name: getattr(self, name) for name in ("method", "tolerance_db", *names)}


def capture_of(path: Path, frames: opt.FrameOptions) -> cl.Capture:
    found = img.open_image(path, frames)
    if isinstance(found, cl.Volume):
        raise opt.wrong_usage("CAPTURE", f"expected captures, got the volume {path}")
    return found


@dataclass(frozen=True, kw_only=True)
class PartSteps:
    """How a part is made, as plain values that a worker process gets; the whole by its planes."""

    folder: Path
    captures: tuple[Path, ...]
    n_samples: tuple[int, ...]  # of each capture
    frames: opt.FrameOptions
    grid: cl.VoxelGrid
    imaging: Mapping[str, Any]

    @cached_property
    def pieces(self) -> list[GridPiece]:
        return grid_pieces(self.grid)

    def run(self, part: Part, device: cl.Device, progress: Progress) -> None:
        piece, number = part
        capture = capture_of(self.captures[number], self.frames)
        image = cl.backproject(
            capture, self.pieces[piece].grid, check_grid=False, device=device,
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
        return self.folder / PARTS / f"{piece:04d}.npy"

    def is_done(self, part: Part) -> bool:
        return self.piece_file(part[0]).is_file() or self.file_of(part).is_file()

    def join(self, piece: int) -> None:
        """Sum the parts of a piece, if all are there, and remove them: few are on disk at once."""
        parts = [self.file_of((piece, number)) for number in range(len(self.captures))]
        whole = self.piece_file(piece)
        if not whole.is_file() and all(path.is_file() for path in parts):
            grid = self.pieces[piece].grid
            image = np.empty(grid.shape, np.complex64)
            for slab in plane_slabs(grid):
                read = zip((_read(path)[slab] for path in parts), self.n_samples, strict=True)
                image[slab] = mean_over_pairs(read, image[slab].shape)
            _write(whole, image)
        if len(parts) > 1 and whole.is_file():
            for path in parts:
                path.unlink(missing_ok=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, planes: slice) -> np.ndarray:
        """Planes of the whole, from its pieces: `clradar.model.volume.Planes`."""
        first, stop, _ = planes.indices(len(self))
        out = np.empty((stop - first, *self.shape[1:]), np.complex64)
        for i, piece in enumerate(self.pieces):
            low, high = max(first, piece.tile.z.start), min(stop, piece.tile.z.stop)
            if low < high:
                inner = slice(low - piece.tile.z.start, high - piece.tile.z.start)
                found = _read(self.piece_file(i))[inner]
                out[low - first : high - first, piece.tile.y] = found
        out.flags.writeable = False  # so that a volume takes it as it is
        return out


def _write(path: Path, image: np.ndarray) -> None:
    with replacing(path, force=True) as temporary, open(temporary, "xb") as file:
        np.save(file, image)


def _read(path: Path) -> np.ndarray:
    return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))


def image_by_parts(
    steps: PartSteps, samples: cl.Capture, files: ImageFiles, where: Where, range_db: float
) -> None:
    """Write and draw an image of a large grid, or of several captures, of which one is read."""
    from clradar.imaging.frame_imager import image_meta
    from clradar.imaging.grid_check import warn_of_grid
    from clradar.imaging.several_captures import KeptCaptures
    from clradar.imaging.windows import frequency_weights
    from measurement_io.native.records import save_planes

    start_s, opened, output = perf_counter(), where.first, files.output
    grid, how, folder = steps.grid, steps.imaging, steps.folder
    sizes, metas, kept = list[int](), list[Any](), KeptCaptures()
    for path in steps.captures:
        capture = capture_of(path, steps.frames)
        sizes.append(capture.data.size)
        metas.append(capture.meta)
        kept.add(capture)
    steps, alone = replace(steps, n_samples=tuple(sizes)), len(sizes) == 1
    weights = frequency_weights(how["window"], samples.waveform.n_freq)
    meta = {**image_meta(device=opened, **how), "capture": samples.meta if alone else metas}
    scale = None
    if alone and samples.absolute:
        scale = ImageScale(samples.array, samples.waveform, weights)
    text = opt.grid_text(grid)
    job = out.begun(
        folder, "image", (KEY, PARTS, WHOLE), f"{PARTS}/*.npy", origin_m=grid.origin_m.tolist(),
        spacing_m=grid.spacing_m.tolist(), counts=list(grid.counts), device=opened.describe(),
    )  # fmt: skip
    with job.held():
        (folder / PARTS).mkdir(exist_ok=True)
        pieces = range(len(steps.pieces))
        for piece in pieces:
            steps.join(piece)
        items = [(piece, number) for piece in pieces for number in range(len(sizes))]
        with console.bar("imaging") as progress:
            for (piece, _), _ in job.each(
                steps.run, items, where, done=steps.is_done, progress=progress, say=console.line,
                noun="part",
            ):  # fmt: skip
                steps.join(piece)
        warn_of_grid(samples if alone else kept, grid, steps, weights, opened)
        whole = folder / WHOLE
        if output is not None:
            known = {**meta, **out.provenance(grid=text)}
            save_planes(whole, steps, grid, known, scale, force=True)
        if files.png or files.report:
            image: cl.DepthMap | cl.Volume
            if files.flat(grid):
                image = depth_map_of_planes(steps, grid, range_db)  # without it in memory
            else:
                image = cl.Volume(steps[:], grid, meta, scale)
            draw(files, image, meta, steps.captures, range_db, grid=text)
        job.clear([PARTS])  # killed from here on, the same command makes them again
        if output is not None:
            with replacing(output, force=opt.call.force) as temporary:
                os.replace(whole, temporary)
            took = f"{perf_counter() - start_s:.1f} s on {opened.info.label}"
            console.line(f"{output}: {text}, {took}")
        job.clear([KEY])
    with suppress(OSError):  # it is gone, or holds something else
        folder.rmdir()


def draw(
    files: ImageFiles,
    image: cl.Volume | cl.DepthMap,
    meta: Mapping[str, Any],
    captures: Sequence[Path],
    range_db: float,
    **more: Any,
) -> None:
    """Write figure and page, as far as they were asked for."""
    if files.png is None and files.report is None:
        return
    first, *others = captures
    title = f"{first.name} and {len(others)} more" if others else img.title_of(first, meta)
    shown: dict[str, Any] = {"dynamic_range_db": range_db, "view": files.view, "dbsm": files.dbsm}
    if (reason := img.nothing_to_draw(image)) is not None:
        for path in (files.png, files.report):
            if path is not None:
                console.warning(f"{path}: not drawn, since the image is {reason}")
        return
    figure = partial(img.volume_figure, image, title, files.slice, **shown)
    out.write(files.png, figure, f"the picture, {range_db:g} dB")
    if isinstance(image, cl.Volume):
        of, origin = cl.report.ReportImage(title, image, str(captures[0])), out.provenance(**more)
        page = partial(cl.report.image_report, of, settings=origin, **shown)
        out.write(files.report, page, "the image as a page, to be opened in a browser")


def image_command(
    captures: list[Path] = opt.argument(
        "Native capture, recorded .npy frame, or radar folder; or a volume, to be drawn. Several "
        "captures, as those of clusters, make one image.",
    ),
    *,
    files: ImageFiles,
    imaging: ImageOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Without ranges the grid is the paper's, 201 x 201 x 81 voxels of 1 mm, if the object is in it
    and the radar resolves it there; else one around the echoes up to 15 dB below the strongest,
    with voxels of half the resolution at most. Several captures, and grids of more than 2^23
    voxels, are imaged by parts, which workers and devices share: what is done is kept beside the
    output, and the same command resumes.
    """
    to_write = [file for file in (files.output, files.png, files.report) if file is not None]
    if not to_write:
        raise opt.wrong_usage("-o", "expected a volume to write, or --png, or --report; got none")
    folder = to_write[0].with_name(f"{to_write[0].name}.parts")
    several, range_db = len(captures) > 1, depth.dynamic_range_db
    content = (capture_of if several else img.open_image)(captures[0], frames)
    wrong = {"--method": imaging.iterated, "--dbsm": files.dbsm, "--absolute": imaging.absolute}
    for name in (name for name, is_wrong in wrong.items() if several and is_wrong):
        raise opt.wrong_usage(name, "expected with a single capture, not with several")
    if files.dbsm and not (imaging.absolute or content.absolute):
        raise MeasurementError(
            f"{captures[0]}: expected S-parameters for --dbsm, got samples on a relative "
            "scale; --absolute says that they are S-parameters"
        )
    others = {"-o": files.output, **opt.given(processes), "--device": device}
    chosen = {name: value for name, value in others.items() if value is not None}
    if isinstance(content, cl.Volume):
        for name in {**opt.given(imaging), **chosen}:
            raise opt.wrong_usage(name, "the input is a volume, which is an image already")
        draw(files, content, content.meta, captures, range_db)
        return
    if imaging.absolute:
        content = replace(content, meta={**content.meta, "absolute": True})
    where = processes.where(device)
    grid = img.grid_for(content, imaging, where.first, everything=imaging.everything)
    if files.slice is not None and (place_m := files.slice[1]) is not None:
        plane_index(grid, files.slice[0], place_m)  # raises where there is none
    steps = PartSteps(
        folder=folder, captures=tuple(captures), n_samples=(content.data.size,), frames=frames,
        grid=grid, imaging=imaging.arguments,
    )  # fmt: skip
    if not imaging.iterated and (several or len(steps.pieces) > 1):
        image_by_parts(steps, content, files, where, range_db)
        return
    start_s, text = perf_counter(), opt.grid_text(grid)
    volume = img.form_image(content, grid, imaging, where.first)
    took = f"{perf_counter() - start_s:.1f} s on {where.first.info.label}"
    out.write(files.output, volume, f"{text}, {took}", grid=text)
    if imaging.iterated:
        left_db, count = volume.meta["residual_db"], volume.meta["iterations"]
        left = "nothing" if left_db is None else f"{left_db:.1f} dB of the samples"
        reason = volume.meta["stopped"]  # as `clradar.reconstruct` has them
        console.line(f"{imaging.method}: {count} iterations, ended by {reason}; left: {left}")
    draw(files, volume, volume.meta, captures, range_db, grid=text)
