"""Serving a view on this machine until it is stopped."""

from __future__ import annotations

import contextlib
import io
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from clradar.errors import ClradarError
from clradar.model import Scene
from clradar.opencl import Device
from clradar.view.beside import Beside
from clradar.view.folder_frames import FolderFrames
from clradar.view.follower import Follower
from clradar.view.panel import Panel
from clradar.view.player import Player
from clradar.view.samples import SampleFrames
from clradar.view.scene import SceneView
from clradar.view.session import Session, Shown
from clradar.view.sources import Source
from clradar.view.truth import TruthView
from clradar.view.wish import Wish

HOST = "127.0.0.1"
"""This machine alone: who may log in may look, through ssh."""

PANEL_PX = 350.0

INSTALL = "pip install 'clradar[view]'"


class MissingViser(ClradarError, ImportError):
    """The package that serves the page is not installed."""


class _Front:
    def __init__(
        self, scene: SceneView, panel: Panel, server: Any, truth: TruthView | None
    ) -> None:
        self._scene, self._panel, self._server, self._truth = scene, panel, server, truth

    def show(self, shown: Shown) -> None:
        with self._server.atomic():
            self._scene.show(shown)
            self._panel.show(shown)
            if self._truth is not None:
                self._truth.show(shown)

    def busy(self, words: str) -> None:
        self._panel.busy(words)

    def refuse(self, words: str) -> None:
        self._panel.refuse(words)


@contextmanager
def running(label: str, port: int) -> Iterator[Any]:
    """Run a server of viser on this machine alone during the block; errors as `serving`."""
    try:
        import viser

        from clradar.view.local_server import listen, taking_over
    except ImportError as error:
        raise MissingViser(f"view: expected viser, got {error}; {INSTALL}") from error
    listening = listen(HOST, port)
    port = listening.getsockname()[1]
    # Its banner is not shown: the caller prints the address.
    with contextlib.redirect_stdout(io.StringIO()), taking_over(listening) as is_taken_over:
        server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
    try:
        if not is_taken_over():
            listening.close()
            raise ClradarError(
                f"viser {viser.__version__}: expected a version that lets clradar check who "
                "connects, as 1.1.1 does; pages of others could read what is shown"
            )
        yield server
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
    with running(source.name, port) as server:
        server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        server.gui.main_panel.dock_right()  # beside the scene, instead of upon it
        server.gui.main_panel.set_width(PANEL_PX)
        # A page could still ask for a tunnel to a server of others: nothing leaves this machine.
        server.request_share_url = lambda verbose=True: None
        scene = SceneView(server)
        drawn_mesh = None if mesh is None else scene.draw_mesh(mesh)
        panel = Panel(server, source, wish, beside, drawn_mesh)
        truth = TruthView(server, source) if isinstance(source, SampleFrames) else None
        front = _Front(scene, panel, server, truth)
        session = Session(source, wish, front, device, beside=beside)
        player = Player(session, per_second=10.0)
        follower = None
        if isinstance(source, (FolderFrames, SampleFrames)) and source.follow:
            follower = Follower(source, session, panel.follow_frames, front.refuse)
        try:
            panel.connect(session, player)
            if truth is not None:
                truth.connect(session, panel)
            scene.on_click(lambda at_m: session.change(at_m=at_m))
            if source.frames():
                session.change()
            else:
                front.busy("waiting for a first file")
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
    before = {
        number: signal.signal(number, lambda *_: stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        frames = source.frames()
        newest = isinstance(source, (FolderFrames, SampleFrames)) and source.follow
        frame = frames[-1 if newest else 0] if frames else -1
        wish = replace(wish, frame=frame)
        shown = serving(source, wish, beside=beside, mesh=mesh, port=port, device=device)
        with shown as (server, _):
            for line in address_lines(server.get_port()):
                say(line)
            stop.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
