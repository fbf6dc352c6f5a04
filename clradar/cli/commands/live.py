"""``clradar live``: image frames as they come, and show them in the terminal or a browser."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clradar.cli.console import print_line, print_warning
from clradar.cli.options.common import DeviceOption, ForceOption
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option
from clradar.cli.options.imaging import DepthMapOptions, GridOptions
from clradar.cli.options.recording import Variant
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_folder, made_folder

if TYPE_CHECKING:
    from clradar import Device, VoxelGrid
    from clradar.live.page import LivePage

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
    view: bool = option(
        False, "Show them in a browser, by the panels of `clradar view`, until Ctrl-C."
    ),
    port: int | None = option(
        None,
        "With --view: port at 127.0.0.1, or the next one that is free; 0: any. [default: 8080]",
        min=0,
        max=65535,
    ),
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Shows the newest frame; those that come meanwhile are dropped. Ends with the recording, or by
    Ctrl-C. A stream has the form of docs/live.md: `clradar replay` sends one.
    """
    if port is not None and not view:
        raise wrong_usage("--port", "expected --view with it")
    from clradar import open_device
    from clradar.live import LiveImages, Shown, open_source, run
    from clradar.live.loop import Images
    from clradar.live.screen import Screen, screen, state_words
    from clradar.live.sources import StreamSource
    from clradar.measurement_io import export_file

    grid = voxels.grid() if given(voxels) else None
    if output is not None:
        check_folder(output, force=force)
    opened = open_device(device)
    opened_source = open_source(source, variant=variant, watch=watch)
    words = opened_source.words
    if isinstance(opened_source, StreamSource) and not opened_source.host.startswith(LOCAL):
        print_warning(f"{opened_source.host}: every machine that reaches this address can send")
    print_line(words)

    with ExitStack() as stack:
        if output is not None:
            stack.enter_context(made_folder(output))
        images: Images
        shows: Screen
        page: LivePage | None = None
        if view:
            page = stack.enter_context(
                served_page(words, grid, window, tolerance_db, depth, opened, port)
            )
            images = shows = page
        else:
            images = LiveImages(grid, window, tolerance_db, depth.dynamic_range_db, opened)
            stack.enter_context(closing(images))
            shows = stack.enter_context(screen(words, print_line))

        def show(shown: Shown) -> None:
            if output is not None:
                path = output / f"{shown.pace.shown - 1:06d}.npz"
                export_file(path, shown.image, force=force)
            shows.show(shown)

        state = run(opened_source, images, show, shows.waiting, most=frames)
        print_line(f"end: {state_words(*state)}")
        if page is not None:
            page.end(*state)
            while True:  # what was shown last can be looked at
                time.sleep(3600)


@contextmanager
def served_page(
    words: str,
    grid: VoxelGrid | None,
    window: str,
    tolerance_db: float | None,
    depth: DepthMapOptions,
    device: Device,
    port: int | None,
) -> Iterator[LivePage]:
    """The page of the frames, with lines of where it is; Ctrl-C or SIGTERM ends it."""
    from clradar.live.page import live_page
    from clradar.view.server import address_lines, signals
    from clradar.view.wish import Wish

    wish = Wish(-1, grid, window=window, dynamic_range_db=depth.dynamic_range_db)
    with (
        suppress(KeyboardInterrupt),
        signals(signal.default_int_handler),
        live_page(words, wish, tolerance_db, device, 8080 if port is None else port) as page,
    ):
        for line in address_lines(page.port):
            print_line(line)
        yield page
