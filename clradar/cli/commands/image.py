"""``clradar image``: form the image of a capture, and draw it or a saved one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli.console import print_line
from clradar.cli.image_parts import PartSteps
from clradar.cli.images import (
    RELATIVE,
    ImageFiles,
    check_no_imaging,
    check_several,
    fit_words,
    image_by_parts,
    image_of_all,
    title_of_several,
)
from clradar.cli.inputs import ImageInput, form_image, grid_for, title_of
from clradar.cli.options.common import DEVICES, FORCE, WorkerOptions
from clradar.cli.options.groups import REQUIRED, argument, given, option, recorded, wrong_usage
from clradar.cli.options.measured import (
    MODEL_METHODS,
    DepthMapOptions,
    FrameOptions,
    GridOptions,
    ModelImagingOptions,
    grid_text,
)
from clradar.cli.outputs import provenance, save


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
    frames: FrameOptions,
    processes: WorkerOptions,
    device: str | None = DEVICES,
    force: bool = FORCE,
) -> None:
    """Without --x-mm, --y-mm and --z-mm the grid is that of the paper, 201 x 201 x 81 voxels of
    1 mm, if the object is in it and the radar resolves it there, and larger where it would cut the
    object; else one around the echoes beyond the direct coupling, up to 15 dB below the strongest,
    with voxels of half the resolution at most. The command says which. Of a volume, which is an
    image already, --png and --report are drawn. A grid of more than 2^23 voxels is imaged piece by
    piece: what is done is kept beside the output until all is, and the same command resumes.
    Workers and devices share the pieces of large grids, and several captures.
    """
    from clradar.errors import MeasurementError
    from clradar.jobs import open_devices

    if everything and given(voxels):
        raise wrong_usage("--all-echoes", f"expected without {', '.join(given(voxels))}")
    voxels.grid()  # wrong usage is reported before a file is read
    files.check(force=force, inputs=captures)
    capture = captures[0]
    if files.dbsm and imaging.method in MODEL_METHODS:
        raise wrong_usage("--dbsm", f"images by --method {imaging.method} are relative")
    loaded = ImageInput.open(capture, frames)
    if files.dbsm and not (absolute or loaded.content.absolute):
        raise MeasurementError(f"{capture}: expected S-parameters for --dbsm, {RELATIVE}")
    if len(captures) > 1:
        check_several(loaded, files, imaging, absolute)
    if imaging.method in MODEL_METHODS:
        for name in given(processes):
            raise wrong_usage(name, "expected back-projection")
    if isinstance(loaded.content, cl.Volume):
        options = {**given(voxels), **given(imaging), **given(processes)}
        options |= {"--absolute": 1} if absolute else {}
        options |= {"--all-echoes": 1} if everything else {}
        check_no_imaging(files, options, tolerance_db, device)
        volume, origin = loaded.content, provenance("image", {}, loaded.files)
    else:
        fitted = imaging.method in MODEL_METHODS
        devices = open_devices(cl.open_device(device) if fitted else device)
        opened = devices.first
        samples = loaded.content
        if absolute:
            samples = replace(samples, meta={**samples.meta, "absolute": True})
        grid = grid_for(samples, voxels, opened, everything=everything)
        parts = PartSteps(
            folder=files.first.with_name(f"{files.first.name}.parts"), captures=tuple(captures),
            frames=frames, grid=grid, imaging={**imaging.arguments, "tolerance_db": tolerance_db},
        )  # fmt: skip
        where = processes.where(device, captures)
        divided = not fitted and not where.here
        if not fitted and (len(parts.pieces) > 1 or (divided and len(captures) > 1)):
            image_by_parts(parts, samples, files, imaging, depth, opened, where, force=force)
            return
        start_s = perf_counter()
        if len(captures) > 1:
            volume, read = image_of_all(captures, frames, grid, imaging, tolerance_db, opened)
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
            print_line(fit_words(volume.meta))
    title = title_of(capture, volume.meta) if len(captures) == 1 else title_of_several(captures)
    files.draw(volume, title, str(capture), origin, depth.dynamic_range_db, force=force)
