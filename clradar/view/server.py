"""Serving a view on this machine until it is stopped."""

from __future__ import annotations

import contextlib
import io
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clradar.errors import ClradarError
from clradar.model import Scene
from clradar.opencl import Device
from clradar.view.beside import Beside
from clradar.view.folder_frames import FolderFrames
from clradar.view.follower import Follower
from clradar.view.page import Page
from clradar.view.player import Player
from clradar.view.samples import SampleFrames
from clradar.view.session import Session
from clradar.view.sources import Source
from clradar.view.wish import Wish

if TYPE_CHECKING:
    from clradar.view.local_server import Clicks

HOST = "127.0.0.1"
"""This machine alone: who may log in may look, through ssh."""

INSTALL = "pip install 'clradar[view]'"


class MissingViser(ClradarError, ImportError):
    """The package that serves the page is not installed."""


@contextmanager
def running(label: str, port: int) -> Iterator[tuple[Any, Clicks]]:
    """Run a server of viser on this machine alone during the block; errors as `serving`."""
    try:
        import viser

        from clradar.view.local_server import Clicks, listen, taking_over
    except ImportError as error:
        raise MissingViser(f"view: expected viser, got {error}; {INSTALL}") from error
    listening, clicks = listen(HOST, port), Clicks()
    port = listening.getsockname()[1]
    # Its banner is not shown: the caller prints the address.
    with contextlib.redirect_stdout(io.StringIO()), taking_over(listening, clicks) as is_taken_over:
        server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
    try:
        if not is_taken_over():
            listening.close()
            raise ClradarError(
                f"viser {viser.__version__}: expected a version that lets clradar check who "
                "connects, as 1.1.1 does; pages of others could read what is shown"
            )
        yield server, clicks
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


@contextmanager
def serving(
    source: Source,
    wish: Wish,
    *,
    beside: Beside | None = None,
    mesh: Scene | None = None,
    port: int = 8080,
    device: Device | None = None,
) -> Iterator[tuple[Any, Session]]:
    """Serve a view during the block; arguments as `serve`.

    Yields
    ------
    viser.ViserServer, Session
        On `port`, or the next one that is free.

    Raises
    ------
    MissingViser
        viser is not installed.
    ClradarError
        No port is free, or this viser cannot be told whom to serve.
    """
    with running(source.name, port) as (server, clicks):
        page = Page(server, clicks, source, wish, beside, mesh)
        session = Session(source, wish, page, device, beside=beside)
        player = Player(session, per_second=10.0)
        follower = None
        if isinstance(source, (FolderFrames, SampleFrames)) and source.follow:
            follower = Follower(source, session, page.panel.follow_frames, page.refuse)
        try:
            page.connect(session, player)
            if source.frames():
                session.change()
            else:
                page.busy("waiting for a first file")
            if follower is not None:
                follower.start()
            yield server, session
        finally:
            if follower is not None:
                follower.close()
            session.close()
            player.close()


def serve(
    source: Source,
    *,
    beside: Beside | None = None,
    mesh: Scene | None = None,
    port: int = 8080,
    wish: Wish,
    device: Device | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Serve a view until SIGINT or SIGTERM, and print where it is.

    Parameters
    ----------
    source : Source
    beside : Beside or None
        A second image of each frame.
    mesh : Scene or None
        Drawn as a surface.
    port : int
        Or the next one that is free.
    wish : Wish
        What is shown at first, but for its frame.
    device : Device or None
    say : callable
        Called with the lines to print.

    Raises
    ------
    MissingViser
        viser is not installed.
    """
    stop = threading.Event()
    frames = source.frames()
    newest = isinstance(source, (FolderFrames, SampleFrames)) and source.follow
    wish = replace(wish, frame=frames[-1 if newest else 0] if frames else -1)
    with (
        signals(lambda *_: stop.set()),
        serving(source, wish, beside=beside, mesh=mesh, port=port, device=device) as (server, _),
    ):
        for line in address_lines(server.get_port()):
            say(line)
        stop.wait()


@contextmanager
def signals(handler: Callable[..., Any]) -> Iterator[None]:
    """Let SIGINT and SIGTERM call this during the block."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, restored in zip(numbers, before, strict=True):
            signal.signal(number, restored)


def address_lines(port: int) -> list[str]:
    """Where the page is, and how to get to it from another machine."""
    import getpass
    import socket

    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # an account without a name, as in containers
        user = "USER"
    return [
        f"http://{HOST}:{port} shows it in a browser here; Ctrl-C ends it",
        f"from another machine: ssh -L {port}:{HOST}:{port} {user}@{socket.gethostname()}, "
        "then the same address there",
    ]
