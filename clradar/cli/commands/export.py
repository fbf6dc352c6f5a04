"""``clradar export``: captures, volumes and depth maps in files that other programs open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli import options as opt, parse
from clradar.cli.console import print_line
from clradar.cli.inputs import ImageInput
from clradar.cli.outputs import provenance


def command(
    source: Path = opt.argument("Volume or capture, recorded .npy frame, or radar folder."),
    *,
    output: Path = opt.output_option(
        "File to write; its ending decides: .vti, .ply, .mat or .npz."
    ),
    depth_map: bool = opt.option("Of a volume its depth map; to .ply it is that anyway.", False),
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
) -> None:
    """A volume goes to .vti (ParaView), its depth map to .ply (MeshLab, Blender: the amplitude as
    grey), and either of them or a capture to .mat (MATLAB) or .npz (numpy), in metres and hertz.
    """
    from measurement_io import export_file
    from measurement_io.export import FORMATS

    parse.ends_in(*FORMATS)("-o", output)
    loaded = ImageInput.open(source, frames)
    content: Any = loaded.content
    if depth_map and isinstance(content, cl.Capture):
        raise opt.wrong_usage("--depth-map", f"expected a volume, got a capture: {source}")
    if depth_map or (output.suffix.lower() == ".ply" and not isinstance(content, cl.Capture)):
        content = content.depth_map(depth.dynamic_range_db)
    else:
        content = replace(content, meta={**content.meta, **provenance()})
    export_file(output, content, force=opt.call.force)
    kind = {cl.Capture: "capture", cl.Volume: "volume"}.get(type(content), "depth map")
    shape = content.__array__().shape[:: 1 if kind == "capture" else -1]  # x first, as everywhere
    print_line(f"{output}: {kind}, {' x '.join(map(str, shape))}")
