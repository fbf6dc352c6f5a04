"""The panel in the browser: controls that become wishes, tabs, and a line of state."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any, Protocol

from clradar.model import Capture
from clradar.view.beside import Beside
from clradar.view.controls import Controls, assign
from clradar.view.session import Session, Shown
from clradar.view.sources import Source
from clradar.view.tabs import ChannelsTab, PicturesTab, SlicesTab, add_imaging, add_simulation
from clradar.view.wish import Wish

KEYS = "Keys: space plays, arrows go to the next frame or back, V shows voxels"

SIDES = {"Both": "both", "Measured": "measured", "Simulated": "simulated"}


class Plays(Protocol):
    """What the control that plays and stops acts on."""

    def play(self, on: bool) -> None:
        """Begin or stop to play."""


class Panel:
    """Controls of a view.

    Parameters
    ----------
    server : viser.ViserServer
    source : Source
    wish : Wish
        What the controls show at first; those of captures come with the first of them.
    beside : Beside or None
        Of the second image.
    mesh : handle of viser or None
        Of the mesh in the scene.
    live : bool
        The frames come by themselves, at their own rate.
    """

    def __init__(
        self,
        server: Any,
        source: Source,
        wish: Wish,
        beside: Beside | None = None,
        mesh: Any = None,
        *,
        live: bool = False,
    ) -> None:
        gui = server.gui
        self._controls = Controls(gui)
        self._source, self._beside, self._mesh = source, beside, mesh
        self.state = gui.add_markdown("")
        self.pace = gui.add_markdown("", visible=live)
        self.frame = gui.add_slider("Frame", 0, 1, 1, 0)
        self.play = gui.add_checkbox("Play", live)
        self.rate = gui.add_slider("Frames/s at most", 1, 30, 1, 10, visible=False)
        self._of_many = (self.frame, self.play) if live else (self.frame, self.play, self.rate)
        self.follow_frames(wish.frame)
        self.range_db = gui.add_slider(
            "Dynamic range (dB)", 3.0, 60.0, 0.5, min(60.0, max(3.0, wish.dynamic_range_db))
        )
        self.voxels = gui.add_checkbox("Voxels", wish.voxels)
        if beside is not None:
            self.side = gui.add_dropdown("Show", tuple(SIDES))
            if len(beside.labels) > 1:
                self.other = gui.add_dropdown("Beside", numbered(beside.labels))
        if mesh is not None:
            self.mesh = gui.add_checkbox("Mesh", True)
        self._tabs = gui.add_tab_group()
        keys = KEYS + (", B blinks" if beside else "") + (", M shows the mesh" if mesh else "")
        gui.add_markdown(f"{keys}.")
        self._shows: list[Any] = []
        self._of_captures = False

    def connect(self, session: Session, player: Plays) -> None:
        """Turn changes of the controls into wishes."""
        self._session, controls = session, self._controls
        controls.on(self.range_db, lambda: session.change(dynamic_range_db=self.range_db.value))
        controls.on(self.voxels, lambda: session.change(voxels=self.voxels.value))
        controls.key("V", "Points or voxels", lambda: controls.toggle(self.voxels))
        controls.on(self.frame, lambda: self._choose_frame(session))
        controls.on(self.play, lambda: player.play(self.play.value))
        controls.on(self.rate, lambda: setattr(player, "per_second", float(self.rate.value)))
        controls.key("space", "Play or stop", lambda: controls.toggle(self.play))
        controls.key("arrowright", "Next frame", lambda: session.step(1))
        controls.key("arrowleft", "Previous frame", lambda: session.step(-1))
        with self._tabs.add_tab("Image"):
            self._shows.append(PicturesTab(controls))
        with self._tabs.add_tab("Slices"):
            self._shows.append(SlicesTab(controls, session))
        if self._beside is not None:
            self._connect_beside(session, self._beside)
        if self._mesh is not None:
            controls.on(self.mesh, lambda: setattr(self._mesh, "visible", self.mesh.value))
            controls.key("M", "Mesh", lambda: controls.toggle(self.mesh))

    def _connect_beside(self, session: Session, beside: Beside) -> None:
        controls = self._controls
        controls.on(self.side, lambda: session.change(side=SIDES[self.side.value]))
        controls.key("B", "Blink between measured and simulated", lambda: blink(session))
        if len(beside.labels) > 1:
            labels = numbered(beside.labels)
            controls.on(self.other, lambda: session.change(other=labels.index(self.other.value)))

    def show(self, shown: Shown) -> None:
        """Show the images and the state of a result."""
        if isinstance(shown.content, Capture) and not self._of_captures:
            self._add_tabs_of_captures(shown.content, shown)
        for tab in self._shows:
            tab.show(shown)
        self.follow_frames(shown.wish.frame)
        if self._beside is not None:
            label = next(label for label, side in SIDES.items() if side == shown.wish.side)
            assign(self.side, "value", label)
        self.state.content = state_words(shown, self._source.label(shown.wish.frame))

    def _add_tabs_of_captures(self, capture: Capture, shown: Shown) -> None:
        self._of_captures = True
        with self._tabs.add_tab("Channels"):
            self._shows.append(ChannelsTab(self._controls, self._session, capture))
        with self._tabs.add_tab("Settings"):
            if self._beside is not None and self._beside.simulates:
                add_simulation(self._controls, self._session)
            add_imaging(self._controls, self._session, shown.first.volume.grid, self.refuse)

    def follow_frames(self, frame: int) -> None:
        """Let slider and playing span the frames that the source has now, and show this one."""
        frames = self._source.frames()
        for control in self._of_many:
            assign(control, "visible", len(frames) > 1)
        assign(self.frame, "max", max(1, len(frames) - 1))
        assign(self.frame, "value", max(0, bisect_right(frames, frame) - 1))

    def _choose_frame(self, session: Session) -> None:
        frames = self._source.frames()  # there may be fewer than when the slider was drawn
        if frames:
            session.change(frame=frames[min(int(self.frame.value), len(frames) - 1)])

    def busy(self, words: str) -> None:
        """Say what is being done."""
        self.state.content = f"*{words} …*"

    def refuse(self, words: str) -> None:
        """Say why a wish is not carried out."""
        self.state.content = f"**Not shown:** {escaped(words)}"


def blink(session: Session) -> None:
    """Show the measured image instead of the simulated one, or the other way round."""
    measured = session.wish.side == "simulated"
    session.change(side="measured" if measured else "simulated")


def numbered(labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return labels that differ."""
    return tuple(f"{i}: {label}" for i, label in enumerate(labels, 1))


def state_words(shown: Shown, label: str) -> str:
    """What is shown, in a line of Markdown."""
    counts = " x ".join(str(n) for n in shown.first.volume.grid.counts)
    kind = "image" if isinstance(shown.content, Capture) else "volume"
    drawn = f"{len(shown.first.cloud.points_m)} {'voxels' if shown.wish.voxels else 'points'} drawn"
    if shown.second is not None:
        drawn += f", {len(shown.second.cloud.points_m)} simulated"
    return f"{escaped(label)}: {kind} of {counts} voxels, {drawn}"


def escaped(text: str) -> str:
    """Return text of a file so that Markdown and HTML show it as it is."""
    return "".join(f"&#{ord(c)};" if c in "\\`*_{}[]<>()#+!|&~$" else c for c in text)
