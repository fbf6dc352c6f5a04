"""Serving a view on this machine until it is stopped, or writing it into a file."""

from __future__ import annotations

import contextlib
import getpass
import io
import logging
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from clradar.backproject import METHODS, WINDOWS
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClradarError, MissingPackage
from clradar.files.atomic import refuse_existing, write_file
from clradar.model import Capture, Scene, Volume, VoxelGrid, checks
from clradar.opencl import Device, open_device
from clradar.view.gate import HOST, gate, hidden_host, listen
from clradar.view.panel import Panel
from clradar.view.scene import UNITS_PER_M, SceneView
from clradar.view.session import Front, Session, View
from clradar.view.sources import Source, StreamFrames
from clradar.view.wish import Wish

MOST_BYTES = 200 * 2**20  # of points and colours: what a browser still opens as one page
PAGE_HZ = 10.0  # frames per second of such a page
QUIET = ("websockets.server", "asyncio")  # whose logs are of what others send, no fault of ours


@contextmanager
def running(label: str, port: int) -> Iterator[tuple[Any, int]]:
    """Run a server of viser during the block, and yield it with the port of its page.

    viser itself cannot be told whom to serve: it listens where no page knows, and the page is at
    127.0.0.1 behind a `gate`. Errors as `serving`.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingPackage(f"view: expected viser, got {error}; pip install viser") from error

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            """A page could ask for a tunnel to a server of others: nothing leaves this machine."""

    host, silent = hidden_host(), logging.NullHandler()
    with listen(port) as listening:
        with listen(0, host) as free:
            hidden = int(free.getsockname()[1])
        for name in QUIET:
            logging.getLogger(name).addHandler(silent)
        # Its banner is not shown: the caller prints the address.
        with contextlib.redirect_stdout(io.StringIO()):
            server = Server(host=host, port=hidden, label=label, verbose=False)
        try:
            target, protocol = (host, server.get_port()), f"viser-v{viser.__version__}"
            with gate(listening, target, protocol, server.get_event_loop()):
                yield server, listening.getsockname()[1]
        finally:
            with contextlib.redirect_stdout(io.StringIO()):
                server.stop()
            for name in QUIET:
                logging.getLogger(name).removeHandler(silent)


@contextmanager
def serving(view: View, port: int = 8080) -> Iterator[tuple[int, Session]]:
    """Serve a view during the block, and yield its port and session.

    At first the newest frame is shown where they come, else the first.
    """
    with running(view.source.name, port) as (server, served):
        panel, frames = Panel(server, view), view.source.frames()
        with contextlib.closing(panel.session) as session:
            panel.busy("reading" if frames else "waiting for a first frame")
            if frames:
                session.change(frame=frames[-1 if view.source.grows else 0])
            session.start()
            yield served, session


def serve(view: View, port: int = 8080, say: Callable[[str], None] = print) -> None:
    """Serve a view until Ctrl-C, print where it is, and raise what its source raises."""
    with suppress(KeyboardInterrupt), serving(view, port) as (served, _):
        for line in address_lines(served):
            say(line)
        while True:
            if view.source.error is not None:
                raise view.source.error
            time.sleep(0.5)


def write_page(
    view: View, path: Path, *, force: bool = False, warn: Callable[[str], None] = print
) -> int:
    """Write the frames of a view into one HTML file, and return how many there are in it."""
    refuse_existing(path, force=force)  # before the work
    source, written, drawn_bytes = view.source, 0, 0
    frames = source.frames()
    with running(source.name, port=0) as (server, _):
        scene = SceneView(server, view)
        with contextlib.closing(Session(view, Front())) as session:
            serializer = server.get_scene_serializer()
            for count, frame in enumerate(frames, 1):
                session.change(frame=frame, layout="3-D")
                session.settle()
                shown = session.shown
                if session.refused or shown is None:
                    warn(f"left out: {session.refused}")
                    continue
                if written:  # a single frame needs no time line, whose end builds it anew
                    serializer.insert_sleep(1 / PAGE_HZ)
                scene.show(shown)
                # To the left in front of the box; the frame of a file has its name.
                title = ", ".join(dict.fromkeys((source.name, source.label(frame))))
                legend = "; orange: measured, cyan: simulated" if shown.second else ""
                corner = UNITS_PER_M * shown.first.ends_m[[0, 1, 2], [1, 1, 0]]
                server.scene.add_label(
                    "/frame", title + legend, position=corner, anchor="bottom-left"
                )
                written += 1
                for drawn in filter(None, (shown.first, shown.second)):
                    drawn_bytes += drawn.points_m.nbytes + drawn.colours.nbytes
                if drawn_bytes > MOST_BYTES and count < len(frames):
                    warn(f"the first {count} of {len(frames)} frames: more are too many for a page")
                    break
        if written > 1:
            serializer.insert_sleep(1 / PAGE_HZ)
        if not written:
            raise ClradarError(f"{source.name}: expected a frame that can be shown, got none")
        page = serializer.as_html(dark_mode=True)
    write_file(path, page.encode(), force=force)
    return written


def show(
    frames: Iterable[Capture | Volume] | Capture | Volume,
    *,
    title: str = "frames",
    grid: VoxelGrid | None = None,
    method: str = "fast",
    window: str = "rect",
    tolerance_db: float | None = None,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    mesh: Scene | None = None,
    port: int = 8080,
    device: Device | str | None = None,
) -> None:
    """Show captures or volumes in a browser, until Ctrl-C; print the page's address.

    A slider goes through a sequence, such as a recording. Any other iterable, such as a generator
    that waits for a radar, is read in a thread of its own: the newest frame is shown, those that
    came meanwhile are dropped and counted, and the last 256 MiB of samples can be looked back at.
    What the iterable raises is raised here.

    `grid` is that of the images of captures, by default around what the first of them shows; the
    other settings are those of `clradar.backproject` and `Volume.depth_map`. A `mesh` is drawn as a
    surface. The page is at 127.0.0.1, at `port` or the next one that is free.

    Examples
    --------
    A radar of one's own, whose function `measure` waits for its next samples:

    >>> def frames():  # doctest: +SKIP
    ...     while True:
    ...         yield clradar.Capture(measure(), array, waveform)
    >>> clradar.view.show(frames())  # doctest: +SKIP
    """
    checks.one_of("show: method", method, METHODS)
    checks.one_of("show: window", window, WINDOWS)
    wish = Wish(-1, grid, method, window, tolerance_db, dynamic_range_db=dynamic_range_db)
    frames = [frames] if isinstance(frames, Capture | Volume) else frames
    if isinstance(frames, Sequence):
        if not frames:
            raise ClradarError("show: expected at least one frame, got none")
        numbers = getattr(frames, "frame_numbers", None)
        if numbers is None:  # which a recording has: it is not read for its labels
            for one in frames:
                checks.instance("show: frames", one, Capture | Volume)
            numbers = [one.meta.get("frame", i) for i, one in enumerate(frames)]
        source = Source(title, tuple(f"frame {n}" for n in numbers), frames.__getitem__)
    else:
        source = StreamFrames(frames, title)
    serve(View(source=source, wish=wish, mesh=mesh, device=open_device(device)), port)


def address_lines(port: int) -> list[str]:
    """Where the page is, and how to get to it from another machine."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # an account without a name, as in containers
        user = "USER"
    return [
        f"http://{HOST}:{port} shows it in a browser here; Ctrl-C ends it",
        f"from another machine: ssh -L {port}:{HOST}:{port} {user}@{socket.gethostname()}, "
        "then the same address there",
    ]
