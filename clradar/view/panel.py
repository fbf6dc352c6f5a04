"""The panel in the browser: controls that become wishes, images, and a line of state."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np

from clradar.backproject import METHODS, WINDOWS
from clradar.errors import ModelError
from clradar.model import Capture, VoxelGrid
from clradar.view.grids import extents_mm, grid_mm
from clradar.view.player import Player
from clradar.view.session import Session, Shown, Wish
from clradar.view.sources import Source

KEYS = "Keys: space plays, arrows go to the next frame or back, V shows voxels."

BLANK = np.zeros((8, 8, 3), np.uint8)


class Panel:
    """Controls of a view.

    Parameters
    ----------
    server : viser.ViserServer
    source : Source
    wish : Wish
        What the controls show at first; those of imaging come with the first image of a capture.
    """

    def __init__(self, server: Any, source: Source, wish: Wish) -> None:
        self._gui = gui = server.gui
        self._source = source
        self._session: Session | None = None
        self._connected: list[tuple[Any, Callable[[], None]]] = []
        self.state = gui.add_markdown("")
        self.frame = gui.add_slider("Frame", 0, 1, 1, 0)
        self.play = gui.add_checkbox("Play", False)
        self.rate = gui.add_slider("Frames/s at most", 1, 30, 1, 10)
        self.follow_frames(wish.frame)
        self.range_db = gui.add_slider(
            "Dynamic range (dB)", 3.0, 60.0, 0.5, min(60.0, max(3.0, wish.dynamic_range_db))
        )
        self.voxels = gui.add_checkbox("Voxels", wish.voxels)
        self.projection = gui.add_image(BLANK, label="Maximum along z", format="png")
        self.depth = gui.add_image(BLANK, label="Depth", format="png")
        self.imaging: list[Any] = []
        self.again = gui.add_folder("Image again", visible=False)
        gui.add_markdown(KEYS)

    def _add_imaging(self, wish: Wish, grid: VoxelGrid) -> None:
        self.again.visible = True
        with self.again:
            step_mm = round(1e3 * float(grid.spacing_m[0]), 6)
            self.step = self._gui.add_number("Voxel size (mm)", step_mm, min=0.1, step=0.1)
            self.ends = [
                self._gui.add_vector2(f"{name} (mm)", ends, step=1.0)
                for name, ends in zip("xyz", extents_mm(grid), strict=True)
            ]
            self.method = self._gui.add_dropdown("Method", METHODS, initial_value=wish.method)
            self.window = self._gui.add_dropdown("Window", WINDOWS, initial_value=wish.window)
        self.imaging = [self.step, *self.ends, self.method, self.window]
        for control in self.imaging:
            self._on(control, self._image_again)

    def connect(self, session: Session, player: Player) -> None:
        """Turn changes of the controls into wishes."""
        self._on(self.range_db, lambda: session.change(dynamic_range_db=self.range_db.value))
        self._on(self.voxels, lambda: session.change(voxels=self.voxels.value))
        self._session = session
        self._key("V", "Points or voxels", lambda: self._toggle(self.voxels))
        self._on(self.frame, lambda: self._choose_frame(session))
        self._on(self.play, lambda: player.play(self.play.value))
        self._on(self.rate, lambda: setattr(player, "per_second", float(self.rate.value)))
        self._key("space", "Play or stop", lambda: self._toggle(self.play))
        self._key("arrowright", "Next frame", lambda: session.step(1))
        self._key("arrowleft", "Previous frame", lambda: session.step(-1))

    def _image_again(self) -> None:
        x_mm, y_mm, z_mm = (control.value for control in self.ends)
        try:
            grid = grid_mm(x_mm, y_mm, z_mm, self.step.value)
        except ModelError as error:
            self.refuse(str(error))
            return
        assert self._session is not None
        self._session.change(grid=grid, method=self.method.value, window=self.window.value)

    def show(self, shown: Shown) -> None:
        """Show the images and the state of a result."""
        picture = shown.picture
        self.projection.image = picture.amplitude
        self.depth.image = picture.depth
        near_mm, far_mm = picture.depth_mm
        self.depth.label = (
            "Depth: nothing seen" if np.isnan(near_mm) else f"Depth: {near_mm:g} to {far_mm:g} mm"
        )
        self.follow_frames(shown.wish.frame)
        if shown.wish.grid is not None and not self.imaging:
            self._add_imaging(shown.wish, shown.wish.grid)
        self.state.content = state_words(shown, self._source.label(shown.wish.frame))

    def follow_frames(self, frame: int) -> None:
        """Let slider and playing span the frames that the source has now, and show this one."""
        frames = self._source.frames()
        for control in (self.frame, self.play, self.rate):
            self._assign(control, "visible", len(frames) > 1)
        self._assign(self.frame, "max", max(1, len(frames) - 1))
        self._set(self.frame, max(0, bisect_right(frames, frame) - 1))

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

    def _on(self, control: Any, act: Callable[[], None]) -> None:
        def changed(event: Any) -> None:
            # A value that was set here to follow the state is no wish.
            if event.client is not None:
                act()

        control.on_update(changed)
        self._connected.append((control, act))

    def _set(self, control: Any, value: Any) -> None:
        self._assign(control, "value", value)

    def _assign(self, control: Any, name: str, value: Any) -> None:
        if getattr(control, name) != value:  # each assignment is sent to every browser
            setattr(control, name, value)

    def _toggle(self, control: Any) -> None:
        control.value = not control.value
        next(act for one, act in self._connected if one is control)()

    def _key(self, key: str, label: str, act: Callable[[], None]) -> None:
        self._gui.add_command(label, hotkey=key).on_trigger(lambda _: act())


def state_words(shown: Shown, label: str) -> str:
    """What is shown, in a line of Markdown."""
    counts = " x ".join(str(n) for n in shown.volume.grid.counts)
    kind = "image" if isinstance(shown.content, Capture) else "volume"
    cloud = f"{len(shown.cloud.points_m)} {'voxels' if shown.wish.voxels else 'points'}"
    return f"{escaped(label)}: {kind} of {counts} voxels, {cloud} drawn"


def escaped(text: str) -> str:
    """Return text of a file so that Markdown and HTML show it as it is."""
    return "".join(f"&#{ord(c)};" if c in "\\`*_{}[]<>()#+!|&~$" else c for c in text)
