"""``clradar image``: form the image of a capture, and draw it or a saved one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli import images, options as opt
from clradar.cli.inputs import ImageInput, form_image, grid_for
from clradar.cli.outputs import write


def command(
    captures: list[Path] = opt.argument(
        "Native capture, recorded .npy frame, or radar folder; or a volume, to be drawn. Several "
        "captures, as those of clusters, make one image.",
    ),
    *,
    files: images.ImageFiles,
    imaging: images.ImageOptions,
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
    content, range_db = ImageInput.open(captures[0], frames).content, depth.dynamic_range_db
    imaging.check(content, captures, files, {**opt.given(processes), "--device": device})
    if isinstance(content, cl.Volume):
        images.draw(files, content, captures, range_db)
        return
    if imaging.absolute:
        content = replace(content, meta={**content.meta, "absolute": True})
    where = processes.where(device)
    grid = grid_for(content, imaging, where.first, everything=imaging.everything)
    steps = images.PartSteps(
        folder=folder, captures=tuple(captures), n_samples=(content.data.size,), frames=frames,
        grid=grid, imaging=imaging.arguments,
    )  # fmt: skip
    if not imaging.iterated and (len(captures) > 1 or len(steps.pieces) > 1):
        images.image_by_parts(steps, content, files, where, range_db)
        return
    start_s, text = perf_counter(), opt.grid_text(grid)
    volume = form_image(content, grid, imaging, where.first)
    took = f"{perf_counter() - start_s:.1f} s on {where.first.info.label}"
    write(files.output, volume, f"{text}, {took}", grid=text)
    if imaging.iterated:
        images.print_fit(volume)
    images.draw(files, volume, captures, range_db, grid=text)
