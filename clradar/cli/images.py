"""The files of ``clradar image``, and which of its options go together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.image_parts import OWN_NAMES, PartedImage, PartSteps, capture_of, made_by_parts
from clradar.cli.inputs import ImageInput, nothing_to_draw, title_of
from clradar.cli.options.groups import option, output_option, recorded, wrong_usage
from clradar.cli.options.measured import (
    MODEL_METHODS,
    SLICE_HELP,
    VIEW_HELP,
    DepthMapOptions,
    FrameOptions,
    ModelImagingOptions,
    ViewName,
    grid_text,
    plane,
)
from clradar.cli.outputs import (
    check_figure,
    check_outputs,
    check_place_of_folder,
    check_suffix,
    provenance,
)
from clradar.files.atomic import write_file
from clradar.jobs import Where

if TYPE_CHECKING:
    from clradar.jobs import Where


RELATIVE = (
    "got samples on a relative scale; --absolute says that they are S-parameters, as those of "
    "--estimator physical are"
)


@dataclass(frozen=True, kw_only=True)
class ImageFiles:
    """Files of an image, one of which has to be written."""

    output: Path | None = output_option(None, "Volume to write (HDF5).")
    png: Path | None = option(None, "Draw amplitude and depth: .png, .pdf or .svg.")
    report: Path | None = option(
        None, "Page to write: figure, 3-D view, facts and settings in one .html file."
    )
    view: ViewName | None = option(None, VIEW_HELP)
    slice: str | None = option(None, SLICE_HELP, metavar="AXIS[=MM]")
    dbsm: bool = option(
        False, "Draw radar cross sections in dBsm, of samples that are S-parameters."
    )

    def check(self, *, force: bool, inputs: list[Path]) -> None:
        """Raise unless all of them may be written, and there is one."""
        if self.slice is not None:
            plane(self.slice)
            if self.png is None:
                raise wrong_usage("--slice", "expected with --png, which it is for")
        files = [self.output, self.png, self.report]
        if not any(files):
            raise wrong_usage("-o", "expected a volume to write, or --png, or --report; got none")
        check_figure(self.png)
        check_suffix(self.report, (".html", ".htm"))
        check_outputs(files, force=force, inputs=inputs)

    @property
    def first(self) -> Path:
        """That of them which comes first."""
        return next(file for file in (self.output, self.png, self.report) if file is not None)

    def shown_of(self, image: PartedImage, range_db: float) -> cl.Volume | cl.DepthMap:
        """What is drawn of a large image: its depth map, where that is enough."""
        from clradar.plot.views import thin_view

        front = (self.view or thin_view(image.grid)) == "xy"
        if front and self.report is None and not self.dbsm:
            return image.depth_map(range_db)
        return image.volume()

    def draw(
        self,
        volume: cl.Volume | cl.DepthMap,
        title: str,
        source: str,
        origin: Mapping[str, Any],
        range_db: float,
        *,
        force: bool,
    ) -> bool:
        """Write figure and page, as far as they were asked for; False where nothing is to see."""
        from clradar.plot import image_figure, plane_of, save_figure
        from clradar.report import ReportImage, image_report

        reason = nothing_to_draw(volume)
        for path in (self.png, self.report):
            if path is not None and reason is not None:
                print_warning(f"{path}: not drawn, since the image is {reason}")
        if reason is not None:
            return False
        shown: dict[str, Any] = {"dynamic_range_db": range_db, "view": self.view, "dbsm": self.dbsm}
        if self.png is not None:
            drawn = volume
            if self.slice is not None:
                if isinstance(volume, cl.DepthMap):
                    raise wrong_usage("--slice", "of an image in one piece, or of its volume (-o)")
                drawn = plane_of(volume, *plane(self.slice))
            with progress_bar("drawing"):
                save_figure(image_figure(drawn, title, **shown), self.png, force=force)
            print_line(f"{self.png}: the picture, {range_db:g} dB")
        if self.report is not None:
            with progress_bar("writing the page"):
                assert not isinstance(volume, cl.DepthMap)
                page = image_report(ReportImage(title, volume, source), settings=origin, **shown)
            write_file(self.report, page.encode("utf-8"), force=force)
            print_line(f"{self.report}: the image as a page, to be opened in a browser")
        return True


def check_several(
    loaded: ImageInput,
    files: ImageFiles,
    imaging: ModelImagingOptions,
    absolute: bool,
) -> None:
    """Raise where something has no meaning for one image of several captures."""

    if isinstance(loaded.content, cl.Volume):
        raise wrong_usage("CAPTURE...", f"expected captures, got the volume {loaded.path}")
    if imaging.method in MODEL_METHODS:
        raise wrong_usage("--method", f"expected back-projection of several: {imaging.method}")
    if files.dbsm:
        raise wrong_usage("--dbsm", "of a single capture, not of several")
    if absolute:
        raise wrong_usage("--absolute", "of a single capture, not of several")


def fit_words(meta: Mapping[str, Any]) -> str:
    """How an image by iteration ended: `clradar.reconstruct` explains the reasons."""
    reasons = {
        "noise": "what is left looks like noise",
        "change": "it changes no more",
        "iterations": "no more were asked for",
    }
    left_db, count = meta["residual_db"], meta["iterations"]
    left = "nothing" if left_db is None else f"{left_db:.1f} dB of the samples"
    return f"{meta['method']}: {count} iterations, {reasons[meta['stopped']]}; left: {left}"


def check_no_imaging(
    files: ImageFiles,
    options: Mapping[str, Any],
    tolerance_db: float | None,
    device: str | None,
) -> None:
    """Raise where an option of image formation comes with a volume."""
    others = {"-o": files.output, "--tolerance-db": tolerance_db, "--device": device}
    for name in (*options, *(name for name, value in others.items() if value is not None)):
        raise wrong_usage(name, "the input is a volume, which is an image already")


def title_of_several(captures: Sequence[Path]) -> str:
    """The title of one image of several captures."""
    return f"{captures[0].name} and {len(captures) - 1} more"


def image_of_all(
    captures: list[Path],
    frames: FrameOptions,
    grid: cl.VoxelGrid,
    imaging: ModelImagingOptions,
    tolerance_db: float | None,
    device: cl.Device,
) -> tuple[cl.Volume, list[Path]]:
    """One image of several captures, and the files that were read; one capture at a time."""

    read: list[Path] = []

    def opened() -> Iterator[cl.Capture]:
        with progress_bar("imaging") as progress:
            for i, path in enumerate(captures):
                capture, found = capture_of(path, frames)
                read.extend(found)
                yield capture
                if progress is not None:
                    progress(i + 1, len(captures))

    volume = cl.backproject(
        opened(), grid, tolerance_db=tolerance_db, device=device, **imaging.arguments
    )
    return volume, read


def image_by_parts(
    parts: PartSteps,
    samples: cl.Capture,
    files: ImageFiles,
    imaging: ModelImagingOptions,
    depth: DepthMapOptions,
    opened: cl.Device,
    where: Where,
    *,
    force: bool,
) -> None:
    """Write and draw an image of a large grid, or one that is divided.

    `samples` are those of the first capture.
    """
    from clradar.imaging.frame_imager import image_meta
    from clradar.imaging.grid_check import warn_of_grid
    from clradar.imaging.several_captures import KeptCaptures
    from clradar.imaging.windows import frequency_weights
    from clradar.model import ImageScale

    start_s = perf_counter()
    check_place_of_folder(parts.folder, OWN_NAMES, parts.captures)
    range_db, grid, way = depth.dynamic_range_db, parts.grid, parts.imaging
    sizes, metas, read, kept = [], [], [], KeptCaptures()
    for path in parts.captures:
        capture, found = capture_of(path, parts.frames)
        sizes.append(capture.data.size)
        metas.append(capture.meta)
        kept.add(capture)
        read += found
    alone = len(sizes) == 1
    weights = frequency_weights(way["window"], samples.waveform.n_freq)
    meta = {**image_meta(device=opened, **way), "capture": samples.meta if alone else metas}
    scale = ImageScale(samples.array, samples.waveform, weights) if samples.absolute else None
    image = PartedImage(steps=parts, meta=meta, scale=scale if alone else None)
    options = recorded(imaging, parts.frames, grid=grid_text(grid))
    origin = provenance("image", options, read)
    begun = {
        **options, "tolerance_db": way["tolerance_db"], "origin_m": grid.origin_m.tolist(),
        "spacing_m": grid.spacing_m.tolist(), "counts": list(grid.counts),
        "inputs": origin["inputs"], "clradar": origin["clradar"], "device": opened.describe(),
    }  # fmt: skip
    with made_by_parts(parts, begun, sizes, where, force=force):
        warn_of_grid(samples if alone else kept, grid, image, weights, opened)
        if files.output is not None:
            image.save(files.output, origin, force=force)
            took = f"{perf_counter() - start_s:.1f} s on {opened.info.label}"
            print_line(f"{files.output}: {grid_text(grid)}, {took}")
        if files.png is None and files.report is None:
            return
        first = parts.captures[0]
        title = title_of(first, meta) if alone else title_of_several(parts.captures)
        shown = files.shown_of(image, range_db)
        files.draw(shown, title, str(first), origin, range_db, force=force)
