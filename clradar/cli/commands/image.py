"""``clradar image``: form the image of a capture, and draw it or a saved one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import clradar as cl
from clradar.cli import images, parse
from clradar.cli import options as opt
from clradar.cli.comparison import volume_figure
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.inputs import ImageInput, form_image, grid_for, nothing_to_draw
from clradar.cli.outputs import provenance, save
from clradar.errors import MeasurementError
from clradar.files.atomic import write_file


@dataclass(frozen=True, kw_only=True)
class ImageFiles(opt.PictureOptions):
    """Files of an image, one of which has to be written."""

    output: Path | None = opt.output_option("Volume to write (HDF5).")
    png: Path | None = opt.written(
        "Draw amplitude and depth: .png, .pdf or .svg.", "--png", "--figure", check=parse.figure
    )
    report: Path | None = opt.written(
        "Page: figure, 3-D view, facts and settings in one .html file.", check=parse.page
    )
    dbsm: bool = opt.option(
        "Draw radar cross sections in dBsm, of S-parameters.",
        False,
        without=opt.ITERATED,
        kept=False,
    )

    def draw(
        self,
        image: cl.Volume | images.PartedImage,
        captures: list[Path],
        origin: Mapping[str, Any],
        range_db: float,
        *,
        force: bool,
    ) -> None:
        """Write figure and page, as far as they were asked for."""
        from clradar.model.volume import depth_map_of_planes
        from clradar.plot import save_figure
        from clradar.plot.views import thin_view
        from clradar.report import ReportImage, image_report

        if self.png is None and self.report is None:
            return
        title = images.title_of_captures(captures, image.meta)
        shown: dict[str, Any] = {"dynamic_range_db": range_db, "view": self.view, "dbsm": self.dbsm}
        flat = (self.view or thin_view(image.grid)) == "xy" and self.slice is None
        volume: cl.Volume | cl.DepthMap
        if isinstance(image, cl.Volume):
            volume = image
        elif flat and not (self.report or self.dbsm):
            volume = depth_map_of_planes(image, image.grid, range_db)  # without it in memory
        else:
            volume = image.volume()
        if (reason := nothing_to_draw(volume)) is not None:
            for path in (self.png, self.report):
                if path is not None:
                    print_warning(f"{path}: not drawn, since the image is {reason}")
            return
        if self.png is not None:
            with progress_bar("drawing"):
                figure = volume_figure(volume, title, self.slice, **shown)
                save_figure(figure, self.png, force=force)
            print_line(f"{self.png}: the picture, {range_db:g} dB")
        if self.report is not None and isinstance(volume, cl.Volume):
            with progress_bar("writing the page"):
                of = ReportImage(title, volume, str(captures[0]))
                page = image_report(of, settings=origin, **shown)
            write_file(self.report, page.encode("utf-8"), force=force)
            print_line(f"{self.report}: the image as a page, to be opened in a browser")


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
        metavar="N",
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
    def iterated(self) -> bool:
        """Whether it is formed by iteration: by `clradar.reconstruct`."""
        return self.method in ("least-squares", "sparse")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`, or of `clradar.reconstruct`."""
        names = ("iterations", "damping_db", "sparsity_db") if self.iterated else ("window",)
        return {name: getattr(self, name) for name in ("method", "tolerance_db", *names)}

    def check(
        self, loaded: ImageInput, captures: list[Path], files: ImageFiles, others: Mapping[str, Any]
    ) -> None:
        """Raise where an option has no meaning for what is read."""
        several, volume = len(captures) > 1, isinstance(loaded.content, cl.Volume)
        if several and volume:
            raise opt.wrong_usage("CAPTURE...", f"expected captures, got the volume {loaded.path}")
        wrong = {"--method": self.iterated, "--dbsm": files.dbsm, "--absolute": self.absolute}
        if several and any(wrong.values()):
            name = next(name for name, is_wrong in wrong.items() if is_wrong)
            raise opt.wrong_usage(name, "expected with a single capture, not with several")
        if files.dbsm and not (self.absolute or loaded.content.absolute):
            raise MeasurementError(
                f"{loaded.path}: expected S-parameters for --dbsm, got samples on a relative "
                "scale; --absolute says that they are S-parameters"
            )
        chosen = {**opt.given(self), "-o": files.output, **others}
        names = [name for name, value in chosen.items() if value is not None]
        if volume and names:
            raise opt.wrong_usage(names[0], "the input is a volume, which is an image already")


def command(
    captures: list[Path] = opt.argument(
        "Native capture, recorded .npy frame, or radar folder; or a volume, to be drawn. Several "
        "captures, as those of clusters, make one image.",
        opt.REQUIRED,
        metavar="CAPTURE...",
    ),
    *,
    files: ImageFiles,
    imaging: ImageOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """Without --x-mm, --y-mm and --z-mm the grid is that of the paper, 201 x 201 x 81 voxels of
    1 mm, if the object is in it and the radar resolves it there, and larger where it would cut the
    object; else one around the echoes beyond the direct coupling, up to 15 dB below the strongest,
    with voxels of half the resolution at most. The command says which. Of a volume, which is an
    image already, --png and --report are drawn. Several captures, and a grid of more than 2^23
    voxels piece by piece, are imaged by parts: what is done is kept beside the output until all is,
    and the same command resumes. Workers and devices share the parts.
    """
    to_write = [file for file in (files.output, files.png, files.report) if file is not None]
    if not to_write:
        raise opt.wrong_usage("-o", "expected a volume to write, or --png, or --report; got none")
    folder = to_write[0].with_name(f"{to_write[0].name}.parts")
    images.remove_remains(folder)
    loaded = ImageInput.open(captures[0], frames)
    content, range_db = loaded.content, depth.dynamic_range_db
    imaging.check(loaded, captures, files, {**opt.given(processes), "--device": device})
    if isinstance(content, cl.Volume):
        files.draw(content, captures, provenance(loaded.files), range_db, force=force)
        return
    if imaging.absolute:
        content = replace(content, meta={**content.meta, "absolute": True})
    where = processes.where(device, captures)
    grid = grid_for(content, imaging, where.first, everything=imaging.everything)
    steps = images.PartSteps(
        folder=folder, captures=tuple(captures), n_samples=(content.data.size,), frames=frames,
        grid=grid, imaging=imaging.arguments,
    )  # fmt: skip
    if not imaging.iterated and (len(captures) > 1 or len(steps.pieces) > 1):

        def draw(image: images.PartedImage, origin: Mapping[str, Any]) -> None:
            files.draw(image, captures, origin, range_db, force=force)

        images.image_by_parts(steps, content, files.output, draw, where, force=force)
        return
    start_s = perf_counter()
    volume = form_image(content, grid, imaging, where.first)
    took_s = perf_counter() - start_s
    origin = provenance(loaded.files, grid=opt.grid_text(grid))
    if files.output is not None:
        save(files.output, volume, origin, force=force)
        took = f"{took_s:.1f} s on {where.first.info.label}"
        print_line(f"{files.output}: {opt.grid_text(grid)}, {took}")
    if imaging.iterated:
        print_fit(volume)
    files.draw(volume, captures, origin, range_db, force=force)


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
