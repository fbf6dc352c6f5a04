"""``clradar view``: look at recordings, captures and volumes in a browser."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line
from clradar.cli.options.common import DeviceOption
from clradar.cli.options.groups import REQUIRED, argument, option
from clradar.cli.options.imaging import DepthMapOptions
from clradar.cli.options.recording import Variant


def command(
    path: Path = argument(
        REQUIRED,
        "Recording (radar folder, or the folder that holds one), data set, capture, recorded .npy "
        "frame, volume, or a folder of these files.",
        metavar="PATH",
    ),
    *,
    watch: bool = option(
        False,
        "PATH is a folder that is being written: show the newest file, and each one that comes.",
    ),
    variant: Variant = option("raw", "Variant of a recording's frames."),
    port: int = option(
        8080, "Port at 127.0.0.1, or the next one that is free; 0: any free one.", min=0, max=65535
    ),
    depth: DepthMapOptions,
    device: DeviceOption = None,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    'clradar[view]'. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    from clradar import open_device
    from clradar.view import serve
    from clradar.view.sources import open_source

    serve(
        open_source(path, variant, watch=watch),
        port=port,
        dynamic_range_db=depth.dynamic_range_db,
        device=open_device(device),
        say=print_line,
    )
