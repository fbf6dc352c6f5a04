"""``clradar image``: form the image of a capture, and draw it or a saved one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.image_parts import (
    OWN_NAMES,
    PartedImage,
    PartSteps,
    capture_of,
    made_by_parts,
)
from clradar.cli.inputs import ImageInput, form_image, grid_for
from clradar.cli.opening import open_written, require_picture
from clradar.cli.options.common import DevicesOption, ForceOption, OpenOption
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, recorded
from clradar.cli.options.imaging import (
    MODEL_METHODS,
    SLICE_HELP,
    VIEW_HELP,
    DepthMapOptions,
    GridOptions,
    ModelImagingOptions,
    ViewName,
    grid_text,
    plane,
)
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.seeds import SeedOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.options.workers import WorkerOptions
from clradar.cli.outputs import (
    check_figure,
    check_outputs,
    check_place_of_folder,
    check_suffix,
    save,
)
from clradar.cli.provenance import provenance
from clradar.cli.titles import title_of
from clradar.files.atomic import write_file

if TYPE_CHECKING:
    from clradar import Capture, DepthMap, Device, Volume, VoxelGrid


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

    def shown_of(self, image: PartedImage, range_db: float) -> Volume | DepthMap:
        """What is drawn of a large image: its depth map, where that is enough."""
        from clradar.plot.views import thin_view

        front = (self.view or thin_view(image.grid)) == "xy"
        if front and self.report is None and not self.dbsm:
            return image.depth_map(range_db)
        return image.volume()

    def draw(
        self,
        volume: Volume | DepthMap,
        title: str,
        source: str,
        origin: Mapping[str, Any],
        range_db: float,
        *,
        force: bool,
    ) -> bool:
        """Write figure and page, as far as they were asked for; False where nothing is to see."""
        from clradar import DepthMap
        from clradar.plot import image_figure, plane_of, save_figure
        from clradar.report import ReportImage, image_report

        reason = _nothing_to_draw(volume)
        for path in (self.png, self.report):
            if path is not None and reason is not None:
                print_warning(f"{path}: not drawn, since the image is {reason}")
        if reason is not None:
            return False
        shown: dict[str, Any] = {"dynamic_range_db": range_db, "view": self.view, "dbsm": self.dbsm}
        if self.png is not None:
            drawn = volume
            if self.slice is not None:
                if isinstance(volume, DepthMap):
                    raise wrong_usage("--slice", "of an image in one piece, or of its volume (-o)")
                drawn = plane_of(volume, *plane(self.slice))
            with progress_bar("drawing"):
                save_figure(image_figure(drawn, title, **shown), self.png, force=force)
            print_line(f"{self.png}: the picture, {range_db:g} dB")
        if self.report is not None:
            with progress_bar("writing the page"):
                assert not isinstance(volume, DepthMap)
                page = image_report(ReportImage(title, volume, source), settings=origin, **shown)
            write_file(self.report, page.encode("utf-8"), force=force)
            print_line(f"{self.report}: the image as a page, to be opened in a browser")
        return True


def command(
    captures: list[Path] = argument(
        REQUIRED,
        "Native capture, recorded .npy frame, or radar folder; or a volume, to be drawn. Several "
        "captures, as those of clusters, make one image.",
        metavar="CAPTURE...",
    ),
    *,
    files: ImageFiles,
    voxels: GridOptions,
    everything: bool = option(
        False,
        "Without a grid: one around all echoes up to 25 dB below the strongest, also where one is "
        "in the paper's grid.",
        names=("--all-echoes",),
    ),
    imaging: ModelImagingOptions,
    tolerance_db: float | None = option(
        None,
        "Error of fast and by iteration, RMS over RMS, -80 to -30. [default: -50]",
        metavar="DB",
    ),
    absolute: bool = option(
        False, "The samples are S-parameters, as those of --estimator physical are anyway."
    ),
    depth: DepthMapOptions,
    repeated: SeedOptions,
    frames: FrameOptions,
    processes: WorkerOptions,
    device: DevicesOption = None,
    force: ForceOption = False,
    show: OpenOption = False,
) -> None:
    """Without --x-mm, --y-mm and --z-mm the grid is that of the paper, 201 x 201 x 81 voxels of
    1 mm, if the object is in it and the radar resolves it there, and larger where it would cut the
    object; else one around the echoes beyond the direct coupling, up to 15 dB below the strongest,
    with voxels of half the resolution at most. The command says which. Of a volume, which is an
    image already, --png and --report are drawn. A grid of more than 2^23 voxels is imaged piece by
    piece: what is done is kept beside the output until all is, and the same command resumes.
    Workers and devices share the pieces of large grids, and several captures.
    """
    from clradar import Volume, open_device
    from clradar.errors import MeasurementError
    from clradar.opencl import open_devices

    if everything and given(voxels):
        raise wrong_usage("--all-echoes", f"expected without {', '.join(given(voxels))}")
    voxels.grid()  # wrong usage is reported before a file is read
    files.check(force=force, inputs=captures)
    capture = captures[0]
    require_picture(show, "--png or --report", files.png, files.report)
    if files.dbsm and imaging.method in MODEL_METHODS:
        raise wrong_usage("--dbsm", f"images by --method {imaging.method} are relative")
    loaded = ImageInput.open(capture, frames)
    if repeated.seeds is not None:
        _check_seeds(files, imaging)
    if files.dbsm and not (absolute or loaded.content.absolute):
        raise MeasurementError(f"{capture}: expected S-parameters for --dbsm, {RELATIVE}")
    if len(captures) > 1:
        _check_several(loaded, files, imaging, repeated, absolute)
    if repeated.seeds is not None or imaging.method in MODEL_METHODS:
        for name in given(processes):
            raise wrong_usage(name, "expected back-projection without --seeds")
    if isinstance(loaded.content, Volume):
        options = {**given(voxels), **given(imaging), **given(repeated), **given(processes)}
        options |= {"--absolute": 1} if absolute else {}
        options |= {"--all-echoes": 1} if everything else {}
        _check_no_imaging(files, options, tolerance_db, device)
        volume, origin = loaded.content, provenance("image", {}, loaded.files)
    else:
        fitted = imaging.method in MODEL_METHODS
        devices = open_devices(open_device(device) if fitted else device)
        opened = devices.first
        samples = loaded.content
        if absolute:
            samples = replace(samples, meta={**samples.meta, "absolute": True})
        grid = grid_for(samples, voxels, opened, everything=everything)
        if repeated.seeds is not None:
            way = {**imaging.arguments, "tolerance_db": tolerance_db, "device": devices}
            drawn = _image_over_seeds(loaded, grid, repeated, files, depth, way, force=force)
            open_written(show and drawn, files.png)
            return
        parts = PartSteps(
            folder=files.first.with_name(f"{files.first.name}.parts"), captures=tuple(captures),
            frames=frames, grid=grid, imaging={**imaging.arguments, "tolerance_db": tolerance_db},
        )  # fmt: skip
        workers = processes.chosen(parts.folder, captures)
        divided = workers is not None or len(devices.infos) > 1
        if not fitted and (len(parts.pieces) > 1 or (divided and len(captures) > 1)):
            by = {"workers": workers, "device": device, "force": force}
            drawn = _image_by_parts(parts, samples, files, imaging, depth, opened, by)
            open_written(show and drawn, files.png, files.report)
            return
        start_s = perf_counter()
        if len(captures) > 1:
            volume, read = _image_of_all(captures, frames, grid, imaging, tolerance_db, opened)
        else:
            volume = form_image(samples, grid, imaging, opened, "imaging", tolerance_db)
            read = loaded.files
        took_s = perf_counter() - start_s
        options = recorded(imaging, frames, grid=grid_text(grid))
        origin = provenance("image", options, read)
        if files.output is not None:
            save(files.output, volume, origin, force=force)
            print_line(f"{files.output}: {grid_text(grid)}, {took_s:.1f} s on {opened.info.label}")
        if "stopped" in volume.meta:
            print_line(_fit_words(volume.meta))
    title = title_of(capture, volume.meta) if len(captures) == 1 else _title(captures)
    drawn = files.draw(volume, title, str(capture), origin, depth.dynamic_range_db, force=force)
    open_written(show and drawn, files.png, files.report)


def _title(captures: list[Path]) -> str:
    return f"{captures[0].name} and {len(captures) - 1} more"


def _check_several(
    loaded: ImageInput,
    files: ImageFiles,
    imaging: ModelImagingOptions,
    repeated: SeedOptions,
    absolute: bool,
) -> None:
    """Raise where something has no meaning for one image of several captures."""
    from clradar import Volume

    if isinstance(loaded.content, Volume):
        raise wrong_usage("CAPTURE...", f"expected captures, got the volume {loaded.path}")
    if imaging.method in MODEL_METHODS:
        raise wrong_usage("--method", f"expected back-projection of several: {imaging.method}")
    for name in (*given(repeated), *(["--dbsm"] if files.dbsm else [])):
        raise wrong_usage(name, "of a single capture, not of several")
    if absolute:
        raise wrong_usage("--absolute", "of a single capture, not of several")


def _image_of_all(
    captures: list[Path],
    frames: FrameOptions,
    grid: VoxelGrid,
    imaging: ModelImagingOptions,
    tolerance_db: float | None,
    device: Device,
) -> tuple[Volume, list[Path]]:
    """One image of several captures, and the files that were read; one capture at a time."""
    from clradar import backproject

    read: list[Path] = []

    def opened() -> Iterator[Capture]:
        with progress_bar("imaging") as progress:
            for i, path in enumerate(captures):
                capture, found = capture_of(path, frames)
                read.extend(found)
                yield capture
                if progress is not None:
                    progress(i + 1, len(captures))

    volume = backproject(
        opened(), grid, tolerance_db=tolerance_db, device=device, **imaging.arguments
    )
    return volume, read


def _image_by_parts(
    parts: PartSteps,
    samples: Capture,
    files: ImageFiles,
    imaging: ModelImagingOptions,
    depth: DepthMapOptions,
    opened: Device,
    by: Mapping[str, Any],
) -> bool:
    """Write and draw an image of a large grid, or one that is divided; False if nothing is to see.

    `samples` are those of the first capture, `by` options of `made_by_parts`.
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
    with made_by_parts(parts, begun, sizes, **by):
        warn_of_grid(samples if alone else kept, grid, image, weights, opened)
        if files.output is not None:
            image.save(files.output, origin, force=by["force"])
            took = f"{perf_counter() - start_s:.1f} s on {opened.info.label}"
            print_line(f"{files.output}: {grid_text(grid)}, {took}")
        if files.png is None and files.report is None:
            return False
        title = title_of(parts.captures[0], meta) if alone else _title(list(parts.captures))
        shown, source = files.shown_of(image, range_db), str(parts.captures[0])
        return files.draw(shown, title, source, origin, range_db, force=by["force"])


def _check_seeds(files: ImageFiles, imaging: ModelImagingOptions) -> None:
    """Raise where an option has no meaning for an image over seeds."""
    if files.report is not None or files.view is not None or files.dbsm:
        name = next(name for name in ("--report", "--view", "--dbsm") if name in given(files))
        raise wrong_usage(name, "of a single image, not of one over --seeds")
    if imaging.method in MODEL_METHODS:
        raise wrong_usage("--method", f"expected back-projection over --seeds: {imaging.method}")


def _image_over_seeds(
    loaded: ImageInput,
    grid: VoxelGrid,
    repeated: SeedOptions,
    files: ImageFiles,
    depth: DepthMapOptions,
    way: Mapping[str, Any],
    *,
    force: bool,
) -> bool:
    """Simulate a capture again with several seeds; write the mean image and draw the spread.

    False where nothing is to see.
    """
    from clradar import Capture, spread
    from clradar.cli.seeds import simulated_again, spread_words
    from clradar.plot import save_figure, spread_figure

    assert isinstance(loaded.content, Capture)
    assert repeated.seeds is not None
    capture = loaded.content
    scene, settings, meshes = simulated_again(loaded.path, capture, repeated.mesh or [])
    inputs = [*loaded.files, *meshes]
    files.check(force=force, inputs=inputs)
    noise = None if repeated.snr_db is None else {"snr_db": repeated.snr_db}
    range_db = depth.dynamic_range_db
    with progress_bar("seeds") as progress:
        found = spread(
            scene, capture.array, capture.waveform, grid, seeds=repeated.seeds, settings=settings,
            impairments=noise, dynamic_range_db=range_db, progress=progress, **way,
        )  # fmt: skip
    words = spread_words(found)
    print_line(words)
    if files.output is not None:
        own = {name: value for name, value in way.items() if name != "device"}
        options = recorded(repeated, grid=grid_text(grid), dynamic_range_db=range_db, **own)
        save(files.output, found.mean, provenance("image", options, inputs), force=force)
        print_line(f"{files.output}: mean image, {grid_text(grid)}")
    reason = _nothing_to_draw(found.mean)
    if files.png is not None and reason is not None:
        print_warning(f"{files.png}: not drawn, since the image is {reason}")
    elif files.png is not None:
        save_figure(spread_figure(found, f"{loaded.path.name}: {words}"), files.png, force=force)
        print_line(f"{files.png}: mean and standard deviation over the seeds")
    return reason is None


def _fit_words(meta: Mapping[str, Any]) -> str:
    """How an image by iteration ended: `clradar.reconstruct` explains the reasons."""
    reasons = {
        "noise": "what is left looks like noise",
        "change": "it changes no more",
        "iterations": "no more were asked for",
    }
    left_db, count = meta["residual_db"], meta["iterations"]
    left = "nothing" if left_db is None else f"{left_db:.1f} dB of the samples"
    return f"{meta['method']}: {count} iterations, {reasons[meta['stopped']]}; left: {left}"


def _check_no_imaging(
    files: ImageFiles,
    options: Mapping[str, Any],
    tolerance_db: float | None,
    device: str | None,
) -> None:
    """Raise where an option of image formation comes with a volume."""
    others = {"-o": files.output, "--tolerance-db": tolerance_db, "--device": device}
    for name in (*options, *(name for name, value in others.items() if value is not None)):
        raise wrong_usage(name, "the input is a volume, which is an image already")


def _nothing_to_draw(volume: Volume | DepthMap) -> str | None:
    values = np.asarray(volume.data if hasattr(volume, "data") else volume.amplitude)
    if not values.any():
        return "zero everywhere"
    if values.size == 1:
        return f"one voxel, of amplitude {abs(values.item()):.4g}"
    return None
