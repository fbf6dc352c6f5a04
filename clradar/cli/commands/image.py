"""``clradar image``: form the image of a capture, and draw it or a saved one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli.console import print_line
from clradar.cli.images import (
    ImageFiles,
    ImageOptions,
    PartSteps,
    image_by_parts,
    print_fit,
    title_of_image,
)
from clradar.cli.inputs import ImageInput, form_image, grid_for
from clradar.cli.options.common import DEVICE, FORCE, WorkerOptions
from clradar.cli.options.groups import REQUIRED, argument, given, recorded
from clradar.cli.options.measured import DepthMapOptions, FrameOptions, grid_text
from clradar.cli.outputs import provenance, save
from clradar.jobs import open_devices


def command(
    captures: list[Path] = argument(
        "Native capture, recorded .npy frame, or radar folder; or a volume, to be drawn. Several "
        "captures, as those of clusters, make one image.",
        REQUIRED,
        metavar="CAPTURE...",
    ),
    *,
    files: ImageFiles,
    imaging: ImageOptions,
    depth: DepthMapOptions,
    frames: FrameOptions,
    processes: WorkerOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Without --x-mm, --y-mm and --z-mm the grid is that of the paper, 201 x 201 x 81 voxels of
    1 mm, if the object is in it and the radar resolves it there, and larger where it would cut the
    object; else one around the echoes beyond the direct coupling, up to 15 dB below the strongest,
    with voxels of half the resolution at most. The command says which. Of a volume, which is an
    image already, --png and --report are drawn. Several captures, and a grid of more than 2^23
    voxels piece by piece, are imaged by parts: what is done is kept beside the output until all is,
    and the same command resumes. Workers and devices share the parts.
    """
    imaging.grid()  # wrong usage is reported before a file is read
    files.check(force=force, inputs=captures)
    loaded = ImageInput.open(captures[0], frames)
    content, range_db = loaded.content, depth.dynamic_range_db
    imaging.check(loaded, captures, files, {**given(processes), "--device": device})
    title = title_of_image(captures, content.meta)
    if isinstance(content, cl.Volume):
        origin = provenance("image", loaded.files)
        files.draw(content, title, str(captures[0]), origin, range_db, force=force)
        return
    if imaging.absolute:
        content = replace(content, meta={**content.meta, "absolute": True})
    opened = open_devices(device).first
    grid = grid_for(content, imaging, opened, everything=imaging.everything)
    options = recorded(imaging, frames, grid=grid_text(grid))
    steps = PartSteps(
        folder=files.parts, captures=tuple(captures), frames=frames, grid=grid,
        imaging={**imaging.arguments, "tolerance_db": imaging.tolerance_db},
    )  # fmt: skip
    if not imaging.fitted and (len(captures) > 1 or len(steps.pieces) > 1):
        where = processes.where(device, captures)
        image_by_parts(steps, content, files, options, range_db, opened, where, force=force)
        return
    start_s = perf_counter()
    volume = form_image(content, grid, imaging, opened, "imaging", imaging.tolerance_db)
    took_s = perf_counter() - start_s
    origin = provenance("image", loaded.files, **options)
    if files.output is not None:
        save(files.output, volume, origin, force=force)
        print_line(f"{files.output}: {grid_text(grid)}, {took_s:.1f} s on {opened.info.label}")
    if imaging.fitted:
        print_fit(volume)
    files.draw(volume, title, str(captures[0]), origin, range_db, force=force)
