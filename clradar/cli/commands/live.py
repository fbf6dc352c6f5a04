"""``clradar live``: image frames as they come, and show them in the terminal."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from clradar.cli.console import print_line, print_warning
from clradar.cli.options.common import DeviceOption, ForceOption
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option
from clradar.cli.options.imaging import DepthMapOptions, GridOptions
from clradar.cli.options.recording import Variant
from clradar.cli.outputs import check_folder, made_folder

LOCAL = ("127.", "localhost", "::1")


def command(
    source: str = argument(
        REQUIRED,
        "A recording, to be played; any other folder, for files that are written into it; or "
        "tcp:PORT or tcp:HOST:PORT, to listen there.",
        metavar="SOURCE",
    ),
    *,
    output: Path | None = output_option(
        None, "Folder for what is shown: the depth map of every frame, 000000.npz and so on."
    ),
    voxels: GridOptions,
    tolerance_db: float | None = option(
        None, "Error of images, RMS over RMS, -80 to -30. [default: -50]", metavar="DB"
    ),
    window: Literal["rect", "hann", "taylor"] = option("rect", "Weights over frequency."),
    depth: DepthMapOptions,
    variant: Variant = option("raw", "Variant of a recording's frames."),
    watch: bool = option(False, "Wait for files in a folder that is a recording, too."),
    frames: int | None = option(None, "End after so many frames.", metavar="N", min=1),
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Shows the newest frame; those that come meanwhile are dropped. Ends with the recording, or by
    Ctrl-C. A stream has the form of docs/live.md: `clradar replay` sends one.
    """
    from clradar import open_device
    from clradar.live import LiveImages, Shown, open_source, run
    from clradar.live.screen import screen, state_words
    from clradar.live.sources import StreamSource
    from clradar.measurement_io import export_file

    grid = voxels.grid() if given(voxels) else None
    if output is not None:
        check_folder(output, force=force)
    opened = open_device(device)
    images = LiveImages(grid, window, tolerance_db, depth.dynamic_range_db, opened)
    opened_source = open_source(source, variant=variant, watch=watch)
    if isinstance(opened_source, StreamSource) and not opened_source.host.startswith(LOCAL):
        print_warning(f"{opened_source.host}: every machine that reaches this address can send")
    print_line(opened_source.words)

    with ExitStack() as stack:
        if output is not None:
            stack.enter_context(made_folder(output))
        shows = stack.enter_context(screen(opened_source.words, print_line))

        def show(shown: Shown) -> None:
            if output is not None:
                path = output / f"{shown.pace.shown - 1:06d}.npz"
                export_file(path, shown.image, force=force)
            shows.show(shown)

        state = run(opened_source, images, show, shows.waiting, most=frames)
    print_line(f"end: {state_words(*state)}")
