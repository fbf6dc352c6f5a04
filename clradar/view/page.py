"""The page of a view: scene and panel, and of data sets the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clradar.model import Scene
from clradar.view.beside import Beside
from clradar.view.panel import Panel, Plays
from clradar.view.samples import SampleFrames
from clradar.view.scene import SceneView
from clradar.view.session import Session, Shown
from clradar.view.slices import pointed_m, strongest_m
from clradar.view.sources import Source
from clradar.view.truth import TruthView
from clradar.view.wish import Wish

if TYPE_CHECKING:
    from clradar.view.local_server import Clicks

PANEL_PX = 350.0


class Page:
    """Shows the results of a session; arguments as `clradar.view.server.serve`.

    Parameters
    ----------
    server : viser.ViserServer
    clicks : Clicks
        On its drawings.
    source : Source
    wish : Wish
    beside : Beside or None
    mesh : Scene or None
    live : bool
        The frames come by themselves, at their own rate.
    """

    def __init__(
        self,
        server: Any,
        clicks: Clicks,
        source: Source,
        wish: Wish,
        beside: Beside | None = None,
        mesh: Scene | None = None,
        *,
        live: bool = False,
    ) -> None:
        self._server, self._clicks = server, clicks
        self._shown: Shown | None = None
        server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        server.gui.main_panel.dock_right()  # beside the scene, instead of upon it
        server.gui.main_panel.set_width(PANEL_PX)
        # A page could still ask for a tunnel to a server of others: nothing leaves this machine.
        server.request_share_url = lambda verbose=True: None
        self._scene = SceneView(server)
        drawn_mesh = None if mesh is None else self._scene.draw_mesh(mesh)
        self.panel = Panel(server, source, wish, beside, drawn_mesh, live=live)
        self._truth = TruthView(server, source) if isinstance(source, SampleFrames) else None

    def connect(self, session: Session, player: Plays) -> None:
        """Turn what is changed or clicked into wishes."""
        self.panel.connect(session, player)
        if self._truth is not None:
            self._truth.connect(session, self.panel)
        self._scene.on_click(lambda at_m: session.change(at_m=at_m))

        def clicked(drawing: str, across: float, down: float) -> None:
            if self._shown is not None:
                volume = self._shown.chosen.volume
                now_m = self._shown.wish.at_m or strongest_m(volume)
                session.change(at_m=pointed_m(volume, now_m, drawing, across, down))

        self._clicks.act = clicked

    def show(self, shown: Shown) -> None:
        """Draw a result."""
        self._shown = shown
        with self._server.atomic():
            self._scene.show(shown)
            self.panel.show(shown)
            if self._truth is not None:
                self._truth.show(shown)

    def busy(self, words: str) -> None:
        """Say what is being done."""
        self.panel.busy(words)

    def refuse(self, words: str) -> None:
        """Say why a wish is not carried out."""
        self.panel.refuse(words)
