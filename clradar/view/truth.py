"""The truth of a sample in the browser: mesh and joints in the scene, labels, its number."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.errors import ClradarError
from clradar.view.panel import Panel, escaped
from clradar.view.samples import ALL, SampleFrames, Truth
from clradar.view.scene import UNITS_PER_M
from clradar.view.session import Session, Shown

COLOUR = (90, 200, 255)

FIRST_OF_DIGITS = (1, 5, 10, 15, 20)
"""Joints that begin at the wrist, joint 0; each other one begins at the joint before."""

BONES = np.array([(0 if i in FIRST_OF_DIGITS else i - 1, i) for i in range(1, 25)])


class TruthView:
    """Controls of a data set, and what the shown sample was made of.

    Parameters
    ----------
    server : viser.ViserServer
    source : SampleFrames
    """

    def __init__(self, server: Any, source: SampleFrames) -> None:
        self._server, self._source = server, source
        self._nodes: list[Any] = []
        gui = server.gui
        with gui.add_folder("Sample"):
            self.number = gui.add_number("Number", 0, min=0, step=1)
            poses = (ALL, *source.poses)
            self.pose = gui.add_dropdown("Pose", poses, visible=len(poses) > 2)
            self.hand = gui.add_dropdown("Hand", (ALL, "right", "left"))
            self.drawn = gui.add_checkbox("Truth", True)
            self.words = gui.add_markdown("")

    def connect(self, session: Session, panel: Panel) -> None:
        """Turn changes of the controls into wishes."""

        def go_to(event: Any) -> None:
            if event.client is not None:
                session.change(frame=int(self.number.value))

        def choose(event: Any) -> None:
            try:
                self._source.choose(self.pose.value, self.hand.value)
            except ClradarError as error:
                panel.refuse(str(error))
                return
            frames = self._source.frames()
            panel.follow_frames(session.wish.frame)
            if not frames:
                panel.refuse("no sample has this pose and hand")
            elif session.wish.frame not in frames:
                session.change(frame=frames[0])

        self.number.on_update(go_to)
        self.pose.on_update(choose)
        self.hand.on_update(choose)
        self.drawn.on_update(lambda _: self._set_visible())

    def show(self, shown: Shown) -> None:
        """Draw the truth of the frame that is shown."""
        truth = self._source.truth(shown.wish.frame)
        if self.number.value != shown.wish.frame:
            self.number.value = shown.wish.frame
        self.words.content = "\n\n".join(escaped(line) for line in truth.lines)
        for node in self._nodes:
            node.remove()
        self._nodes = draw_truth(self._server.scene, truth)
        self._set_visible()

    def _set_visible(self) -> None:
        for node in self._nodes:
            node.visible = self.drawn.value


def draw_truth(scene: Any, truth: Truth) -> list[Any]:
    """Draw mesh and joints, where they are known, into the scene of viser; return its nodes."""
    nodes = []
    if truth.vertices_m is not None:
        nodes.append(
            scene.add_mesh_simple(
                "/truth/mesh",
                vertices=UNITS_PER_M * truth.vertices_m,
                faces=truth.faces,
                color=COLOUR,
                opacity=0.4,
                side="double",
            )
        )
    if truth.joints_m is not None:
        ends = (UNITS_PER_M * truth.joints_m[BONES]).astype(np.float32)
        nodes.append(
            scene.add_line_segments(
                "/truth/joints",
                points=ends[np.isfinite(ends).all(axis=(1, 2))],
                colors=COLOUR,
                thickness=3.0,
                thickness_units="screen",
            )
        )
    return nodes
