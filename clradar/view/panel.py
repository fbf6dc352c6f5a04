"""The panel in the browser: controls that become wishes, images, and a line of state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clradar.backproject import METHODS, WINDOWS
from clradar.errors import ModelError
from clradar.model import Capture, VoxelGrid
from clradar.view.grids import extents_mm, grid_mm
from clradar.view.player import Player
from clradar.view.session import Session, Shown, Wish

KEYS = "Keys: space plays, arrows go to the next frame or back, V shows voxels."

BLANK = np.zeros((8, 8, 3), np.uint8)


class Panel:
    """Controls of a view.

    Parameters
    ----------
    server : viser.ViserServer
    labels : tuple of str
        Of the frames.
    wish : Wish
        What the controls show at first; without a grid there are none of imaging.
    """

    def __init__(self, server: Any, labels: tuple[str, ...], wish: Wish) -> None:
        self._gui = gui = server.gui
        self._labels = labels
        self._connected: list[tuple[Any, Callable[[], None]]] = []
        self.state = gui.add_markdown("")
        self.frame: Any = None
        if len(labels) > 1:
            self.frame = gui.add_slider("Frame", 0, len(labels) - 1, 1, wish.frame)
            self.play = gui.add_checkbox("Play", False)
            self.rate = gui.add_slider("Frames/s at most", 1, 30, 1, 10)
        self.range_db = gui.add_slider(
            "Dynamic range (dB)", 3.0, 60.0, 0.5, min(60.0, max(3.0, wish.dynamic_range_db))
        )
        self.voxels = gui.add_checkbox("Voxels", wish.voxels)
        self.projection = gui.add_image(BLANK, label="Maximum along z", format="png")
        self.depth = gui.add_image(BLANK, label="Depth", format="png")
        self.imaging: list[Any] = []
        if wish.grid is not None:
            self._add_imaging(wish, wish.grid)
        gui.add_markdown(KEYS)

    def _add_imaging(self, wish: Wish, grid: VoxelGrid) -> None:
        with self._gui.add_folder("Image again"):
            step_mm = round(1e3 * float(grid.spacing_m[0]), 6)
            self.step = self._gui.add_number("Voxel size (mm)", step_mm, min=0.1, step=0.1)
            self.ends = [
                self._gui.add_vector2(f"{name} (mm)", ends, step=1.0)
                for name, ends in zip("xyz", extents_mm(grid), strict=True)
            ]
            self.method = self._gui.add_dropdown("Method", METHODS, initial_value=wish.method)
            self.window = self._gui.add_dropdown("Window", WINDOWS, initial_value=wish.window)
        self.imaging = [self.step, *self.ends, self.method, self.window]

    def connect(self, session: Session, player: Player) -> None:
        """Turn changes of the controls into wishes."""
        self._on(self.range_db, lambda: session.change(dynamic_range_db=self.range_db.value))
        self._on(self.voxels, lambda: session.change(voxels=self.voxels.value))
        for control in self.imaging:
            self._on(control, lambda: self._image_again(session))
        self._key("V", "Points or voxels", lambda: self._toggle(self.voxels))
        if self.frame is None:
            return
        self._on(self.frame, lambda: session.change(frame=int(self.frame.value)))
        self._on(self.play, lambda: player.play(self.play.value))
        self._on(self.rate, lambda: setattr(player, "per_second", float(self.rate.value)))
        self._key("space", "Play or stop", lambda: self._toggle(self.play))
        self._key("arrowright", "Next frame", lambda: session.step(1))
        self._key("arrowleft", "Previous frame", lambda: session.step(-1))

    def _image_again(self, session: Session) -> None:
        x_mm, y_mm, z_mm = (control.value for control in self.ends)
        try:
            grid = grid_mm(x_mm, y_mm, z_mm, self.step.value)
        except ModelError as error:
            self.refuse(str(error))
            return
        session.change(grid=grid, method=self.method.value, window=self.window.value)

    def show(self, shown: Shown) -> None:
        """Show the images and the state of a result."""
        picture = shown.picture
        self.projection.image = picture.amplitude
        self.depth.image = picture.depth
        near_mm, far_mm = picture.depth_mm
        self.depth.label = (
            "Depth: nothing seen" if np.isnan(near_mm) else f"Depth: {near_mm:g} to {far_mm:g} mm"
        )
        if self.frame is not None:
            self._set(self.frame, shown.wish.frame)
        self.state.content = state_words(shown, self._labels)

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
        control.value = value

    def _toggle(self, control: Any) -> None:
        control.value = not control.value
        next(act for one, act in self._connected if one is control)()

    def _key(self, key: str, label: str, act: Callable[[], None]) -> None:
        self._gui.add_command(label, hotkey=key).on_trigger(lambda _: act())


def state_words(shown: Shown, labels: tuple[str, ...]) -> str:
    """What is shown, in a line of Markdown."""
    counts = " x ".join(str(n) for n in shown.volume.grid.counts)
    kind = "image" if isinstance(shown.content, Capture) else "volume"
    cloud = f"{len(shown.cloud.points_m)} {'voxels' if shown.wish.voxels else 'points'}"
    return f"{escaped(labels[shown.wish.frame])}: {kind} of {counts} voxels, {cloud} drawn"


def escaped(text: str) -> str:
    """Return text of a file so that Markdown and HTML show it as it is."""
    return "".join(f"&#{ord(c)};" if c in "\\`*_{}[]<>()#+!|&~$" else c for c in text)
