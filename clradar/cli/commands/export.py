"""``clradar export``: captures, volumes and depth maps in files that other programs open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli.console import print_line
from clradar.cli.inputs import ImageInput
from clradar.cli.options.common import FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, output_option, wrong_usage
from clradar.cli.options.measured import DepthMapOptions, FrameOptions
from clradar.cli.outputs import check_outputs, check_suffix, provenance


def command(
    source: Path = argument(
        "Volume or capture, recorded .npy frame, or radar folder.", REQUIRED, metavar="SOURCE"
    ),
    *,
    output: Path = output_option(
        "File to write; its ending decides: .vti, .ply, .mat or .npz.", REQUIRED
    ),
    depth_map: bool = option("Of a volume its depth map; to .ply it is that anyway.", False),
    depth: DepthMapOptions,
    frames: FrameOptions,
    force: bool = FORCE,
) -> None:
    """A volume goes to .vti (ParaView, VTK: amplitude, and real and imaginary part), its depth map
    to .ply (MeshLab, Blender: a surface with the amplitude as grey), and either of them or a
    capture to .mat (MATLAB) or .npz (numpy). Lengths are metres, frequencies hertz, in the antenna
    frame.
    """
    from measurement_io import export_file
    from measurement_io.export import FORMATS, check_export

    check_suffix(output, tuple(FORMATS))
    check_outputs([output], force=force, inputs=[source])
    loaded = ImageInput.open(source, frames)
    content: Any = loaded.content
    if depth_map and isinstance(content, cl.Capture):
        raise wrong_usage("--depth-map", f"expected a volume, got a capture: {source}")
    if depth_map or (output.suffix.lower() == ".ply" and not isinstance(content, cl.Capture)):
        content = content.depth_map(depth.dynamic_range_db)
    else:
        origin = provenance("export", loaded.files, frames)
        content = replace(content, meta={**content.meta, **origin})
    check_export(output, type(content))
    export_file(output, content, force=force)
    shape = " x ".join(str(n) for n in content.__array__().shape)
    print_line(f"{output}: {type(content).__name__}, {shape}")
