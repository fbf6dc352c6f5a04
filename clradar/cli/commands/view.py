"""``clradar view``: look at recordings, captures and volumes in a browser."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line, print_warning
from clradar.cli.opening import open_written, require_picture
from clradar.cli.options.common import DeviceOption, ForceOption, OpenOption
from clradar.cli.options.groups import REQUIRED, argument, option
from clradar.cli.options.imaging import DepthMapOptions
from clradar.cli.options.recording import Variant
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs, check_suffix


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
        "PATH is a folder or data set that is being written: show the newest file or sample, and "
        "each one that comes.",
    ),
    variant: Variant = option("raw", "Variant of a recording's frames."),
    html: Path | None = option(
        None,
        "Write scene and time line of all frames into this .html file, and serve nothing.",
        metavar="FILE",
    ),
    force: ForceOption = False,
    show: OpenOption = False,
    port: int = option(
        8080, "Port at 127.0.0.1, or the next one that is free; 0: any free one.", min=0, max=65535
    ),
    depth: DepthMapOptions,
    device: DeviceOption = None,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    'clradar[view]'. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    check_suffix(html, (".html", ".htm"))
    check_outputs([html], force=force, inputs=[path])
    require_picture(show, "--html", html)
    if watch and html is not None:
        raise wrong_usage("--watch", "expected without --html, which ends once it is written")
    from clradar import open_device
    from clradar.view import serve
    from clradar.view.sources import open_source

    source = open_source(path, variant, watch=watch)
    if html is not None:
        from clradar.view.page_file import write_page

        count = write_page(
            source,
            html,
            dynamic_range_db=depth.dynamic_range_db,
            device=open_device(device),
            force=force,
            warn=print_warning,
        )
        print_line(f"{html}: {count} {'frame' if count == 1 else 'frames'}, for any browser")
        open_written(show, html)
        return
    serve(
        source,
        port=port,
        dynamic_range_db=depth.dynamic_range_db,
        device=open_device(device),
        say=print_line,
    )
