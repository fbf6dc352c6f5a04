"""The page in the browser: its scene, controls that become wishes, tabs, and lines of state."""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any

from clradar.backproject import METHODS, WINDOWS
from clradar.compare.metrics import METRIC_TABLE
from clradar.model import Capture, Volume
from clradar.model.length_unit import unit_for
from clradar.plot.drawing import typeset
from clradar.view.beside import MATERIALS
from clradar.view.pictures import overview_picture, pair_curves
from clradar.view.playing import Player
from clradar.view.scene import SceneView
from clradar.view.session import Front, Shown, View
from clradar.view.wish import LAYOUTS, SIDES, escaped, grid_mm

PANEL_PX = 350.0

FOLLOWED_S = 1.0  # between two drawings of the channels of frames that are followed


class Panel(Front):
    """Controls of a view beside its scene; shows the results of a session."""

    def __init__(self, server: Any, view: View) -> None:
        gui, source, wish, beside = server.gui, view.source, view.wish, view.beside
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        gui.main_panel.dock_right()  # beside the scene, instead of upon it
        gui.main_panel.set_width(PANEL_PX)
        self.session = session = Player(view, self)
        self._scene = scene = SceneView(server, view)
        self._server, self.gui, self._source, self._beside = server, gui, source, beside
        self.state = gui.add_markdown("")
        self.pace = gui.add_markdown("", visible=source.grows)
        self.frame = self.on(gui.add_slider("Frame", 0, 1, 1, 0), self._choose_frame)
        self.play = self.switch("Play", source.grows, session.play, "space")
        self.follow_frames(wish.frame)
        self.key("N", "Next frame", lambda: self.step(1))
        self.key("P", "Previous frame", lambda: self.step(-1))
        self.layout = self.choice("Layout", LAYOUTS, "layout", "L")
        self.slider("Dynamic range (dB)", 3.0, 60.0, 0.5, "dynamic_range_db")
        self.switch("Voxels", wish.voxels, lambda on: session.change(voxels=on), "V")
        if beside is not None:
            self.side = self.choice("Show", SIDES, "side", "B")
            labels = tuple(f"{i}: {label}" for i, label in enumerate(beside.labels, 1))
            if len(labels) > 1:
                other = gui.add_dropdown("Beside", labels)
                self.on(other, lambda label: session.change(other=labels.index(label)))
            self.metrics = gui.add_markdown("")
        if scene.mesh is not None:
            self.switch("Mesh", True, lambda on: setattr(scene.mesh, "visible", on), "M")
        server.scene.on_click()(lambda event: self.attempt(self._choose_place, event))
        self._tabs = gui.add_tab_group()
        self._tabs_of_captures = False
        self._shows: list[Callable[[Shown], None]] = []
        if source.truth is not None:
            self._add_truth()
        with self._tabs.add_tab("Place"):
            self._add_place()
        several = source.grows or len(source.frames()) > 1
        keys = {
            "space plays, N and P go to the next frame and back": several,
            "L changes the layout, V shows voxels": True,
            "B shows both, measured, simulated in turn": beside is not None,
            "M shows the mesh": scene.mesh is not None,
        }
        gui.add_markdown(f"Keys: {', '.join(text for text, there in keys.items() if there)}.")

    def on(self, control: Any, act: Callable[[Any], None]) -> Any:
        """Call `act` with the value of a control when a user changes it; return the control."""

        def changed(event: Any) -> None:
            # A value that was set here to follow the state is no wish.
            if event.client is not None:
                self.attempt(act, control.value)

        control.on_update(changed)
        return control

    def slider(self, label: str, low: Any, high: Any, step: Any, field: str) -> Any:
        """Add the slider of a field of the wish."""
        now = min(high, max(low, getattr(self.session.wish, field)))
        control = self.gui.add_slider(label, low, high, step, now)
        return self.on(control, lambda value: self.session.change(**{field: type(low)(value)}))

    def choice(self, label: str, known: Sequence[str], field: str, key: str = "") -> Any:
        """Add the choice of a field of the wish, with a key for the next one."""

        def choose(value: Any) -> None:
            if value not in known:  # a page could send any other
                raise ValueError(f"expected one of {', '.join(known)}")
            self.session.change(**{field: value})

        session = self.session
        if key:
            self.key(
                key, f"{label}: {', '.join(known)}",
                lambda: choose(known[(known.index(getattr(session.wish, field)) + 1) % len(known)]),
            )  # fmt: skip
        now = getattr(session.wish, field)
        return self.on(self.gui.add_dropdown(label, known, initial_value=now), choose)

    def switch(self, label: str, on: bool, act: Callable[[bool], None], key: str = "") -> Any:
        """Add a checkbox, perhaps with a key."""
        control = self.on(self.gui.add_checkbox(label, on), lambda value: act(bool(value)))

        def turn() -> None:
            control.value = not control.value
            act(control.value)

        if key:
            self.key(key, label, turn)
        return control

    def attempt(self, act: Callable[..., None], *given: Any) -> None:
        """Do what a message of a page asks for; one that makes no sense is refused."""
        try:
            act(*given)
        except Exception as error:  # whatever a page sends must not print a traceback
            self.refuse(str(error))

    def key(self, key: str, label: str, act: Callable[[], None]) -> None:
        """Call `act` when a key is pressed."""
        self.gui.add_command(label, hotkey=key).on_trigger(lambda _: self.attempt(act))

    def show(self, shown: Shown) -> None:
        with self._server.atomic():
            self._scene.show(shown)
            if isinstance(shown.content, Capture) and not self._tabs_of_captures:
                self._tabs_of_captures = True
                self._add_tabs(shown.content, shown.first.volume)
            for show in self._shows:
                show(shown)
            self.follow_frames(shown.wish.frame)
            assign(self.layout, "value", shown.wish.layout)
            if self._beside is not None:
                assign(self.side, "value", shown.wish.side)
                text = ""
                if shown.metrics is not None:
                    found = [(one.name, one.text(shown.metrics)) for one in METRIC_TABLE[:2]]
                    text = ", ".join(f"{name} **{value}**" for name, value in found)
                assign(self.metrics, "content", text)
            assign(self.state, "content", state_text(shown, self._source.label(shown.wish.frame)))

    def follow_frames(self, frame: int) -> None:
        """Let slider and playing span the frames that the source has now, and show this one."""
        frames, grows = self._source.frames(), self._source.grows
        assign(self.frame, "visible", len(frames) > 1)
        assign(self.play, "visible", len(frames) > 1 or grows)
        assign(self.pace, "visible", grows)
        assign(self.frame, "max", max(1, len(frames) - 1))
        assign(self.frame, "value", max(0, bisect_right(frames, frame) - 1))

    def _choose_place(self, event: Any) -> None:
        shown = self.session.shown
        at_m = None if shown is None else self._scene.clicked_m(shown, event)
        if at_m is not None:
            self.session.change(at_m=at_m)

    def step(self, by: int) -> None:
        """Go on by some frames, and stay there."""
        self.session.chosen()
        self.session.step(by)

    def _choose_frame(self, number: int) -> None:
        self.session.chosen()
        frames = self._source.frames()  # there may be fewer than when the slider was drawn
        if frames:
            self.session.change(frame=frames[min(int(number), len(frames) - 1)])

    def following(self, on: bool) -> None:
        if self._source.grows:
            assign(self.play, "value", on)
        if self.session.shown is not None:
            self.follow_frames(self.session.shown.wish.frame)

    def paced(self, text: str) -> None:
        assign(self.pace, "content", text)

    def busy(self, text: str) -> None:
        # While frames are followed it would come and go with each.
        if self.session.shown is None or not self._source.grows:
            self.state.content = f"*{text} …*"

    def refuse(self, text: str) -> None:
        self.state.content = f"**Not shown:** {escaped(text)}"

    def _add_place(self) -> None:
        """Add the place where the slices meet, and the values there."""
        gui, session = self.gui, self.session
        place = gui.add_vector3("x, y, z (mm)", (0.0, 0.0, 0.0), step=0.1)
        gui.add_button("Strongest voxel").on_click(lambda _: session.change(at_m=None))
        values = gui.add_markdown("")
        gui.add_markdown("A click on a picture, or on a point of the scene, chooses a place.")

        def typed(place_mm: Any) -> None:
            x, y, z = (1e-3 * float(value) for value in place_mm)
            if not all(map(math.isfinite, (x, y, z))):
                raise ValueError("place: expected finite numbers")
            session.change(at_m=(x, y, z))

        def show(shown: Shown) -> None:
            at_m = shown.wish.at_m or shown.chosen.strongest_m()
            assign(place, "value", tuple(round(1e3 * value, 3) for value in at_m))
            lines = []
            for name, drawn in (("", shown.first), ("simulated: ", shown.second)):
                if drawn is not None:
                    depth_m, depth = drawn.depth_m(at_m), "no depth"
                    if not math.isnan(depth_m):
                        unit = unit_for(depth_m)
                        depth = f"depth {unit.per_m * depth_m:.4g} {unit.name}"
                    below_db = round(-drawn.level_db(at_m), 1) + 0.0  # not -0.0
                    lines.append(f"{name}{below_db:.1f} dB below the maximum, {depth}")
            assign(values, "content", typeset("\n\n".join(lines)))

        self.on(place, typed)
        self._shows.append(show)

    def _add_truth(self) -> None:
        """Add what a frame was made of, and whether it is drawn."""
        node = self._scene.truth_node
        with self.gui.add_folder("Truth"):
            self.switch("Shown", True, lambda on: setattr(node, "visible", on))
            text = self.gui.add_markdown("")

        def show(_: Shown) -> None:
            truth = self._scene.truth
            lines = ("not known of this frame",) if truth is None else truth.lines
            assign(text, "content", "\n\n".join(map(escaped, lines)))

        self._shows.append(show)

    def _add_tabs(self, capture: Capture, image: Volume | None) -> None:
        """Add channels, and controls of the mesh's surface, and of grid, method and window."""
        gui, session = self.gui, self.session
        with self._tabs.add_tab("Channels"):
            self._add_channels(capture)
        with self._tabs.add_tab("Settings"):
            if self._beside is not None and self._beside.simulates:
                with gui.add_folder("Simulation"):
                    self.slider("\N{GREEK SMALL LETTER ALPHA}", 0.0, 1.0, 0.01, "alpha")
                    self.choice("Material", MATERIALS, "material")
            if image is None:
                return
            with gui.add_folder("Image"):
                step_mm = round(1e3 * float(image.grid.spacing_m[0]), 6)
                step = gui.add_number("Voxel size (mm)", step_mm, min=0.1, step=0.1)
                ends = []
                for name in "xyz":
                    axis_m = getattr(image.grid, f"{name}_m")
                    ends_mm = tuple(round(1e3 * float(axis_m[i]), 6) for i in (0, -1))
                    ends.append(gui.add_vector2(f"{name} (mm)", ends_mm, step=1.0))
                self.choice("Method", METHODS, "method")
                self.choice("Window", WINDOWS, "window")

        def again(_: Any) -> None:
            x_mm, y_mm, z_mm = (control.value for control in ends)
            session.change(grid=grid_mm(x_mm, y_mm, z_mm, step.value))

        for control in (step, *ends):
            self.on(control, again)

    def _add_channels(self, capture: Capture) -> None:
        """Add the channel data of all pairs, and of a chosen one."""
        gui, session, array = self.gui, self.session, capture.array
        # The end of a slider has to be above its begin.
        tx = self.slider("Tx", 0, max(1, array.n_tx - 1), 1, "tx")
        rx = self.slider("Rx", 0, max(1, array.n_rx - 1), 1, "rx")
        last, drawn_s = (capture, session.wish.tx, session.wish.rx), time.monotonic()
        with gui.add_folder("Pair"):
            overview = gui.add_image(overview_picture(*last).pixels, jpeg_quality=90)
            curves = {
                name: gui.add_uplot(
                    (x, y), ({"label": x_name}, {"label": name, "stroke": "#35a0e0", "width": 1}),
                    title=f"{name} over {x_name}", scales={"x": {"time": False}},
                    legend={"show": True}, aspect=1.6,
                )
                for name, (x_name, x, y) in pair_curves(*last).items()
            }  # fmt: skip

        def show(shown: Shown) -> None:
            nonlocal last, drawn_s
            content, pair = shown.content, (shown.wish.tx, shown.wish.rx)
            if not isinstance(content, Capture) or (last[0] is content and last[1:] == pair):
                return
            if shown.wish.quick and time.monotonic() - drawn_s < FOLLOWED_S:
                return
            drawn_s, last = time.monotonic(), (content, *pair)
            for control, n in ((tx, content.array.n_tx), (rx, content.array.n_rx)):
                assign(control, "max", max(1, n - 1))
            overview.image = overview_picture(*last).pixels
            for name, (_, x, y) in pair_curves(*last).items():
                curves[name].data = (x, y)

        self._shows.append(show)


def assign(control: Any, name: str, value: Any) -> None:
    """Set a property unless it has that value: each assignment is sent to every browser."""
    if getattr(control, name) != value:
        setattr(control, name, value)


def state_text(shown: Shown, label: str) -> str:
    """Return what is shown, in a line of Markdown."""
    first = shown.first
    if first.volume is None:
        arrays = {"projection": "maximum projection", "depth": "depth map"}
        kind = " and ".join(arrays[name] for name in first.known)
        counts = f"{len(first.image.x_m)} x {len(first.image.y_m)} pixels"
    else:
        kind = "image" if isinstance(shown.content, Capture) else "volume"
        counts = f"{' x '.join(str(n) for n in first.volume.grid.counts)} voxels"
    drawn = f"{len(first.points_m)} {'voxels' if shown.wish.voxels else 'points'} drawn"
    if shown.second is not None:
        drawn += f", {len(shown.second.points_m)} simulated"
    return f"{escaped(label)}: {kind} of {counts}, {drawn}"
