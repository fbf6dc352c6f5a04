"""A view as one file: scene and time line, to be opened without a server."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ClradarError
from clradar.files.atomic import refuse_existing, write_file
from clradar.view.scene import LEGEND, SceneView
from clradar.view.server import running
from clradar.view.session import Session, Shown, View
from clradar.view.truth import UNITS_PER_M, draw_truth

MOST_BYTES = 200 * 2**20
"""Of points and colours: what a browser still opens as one page."""

FRAMES_PER_S = 10.0


class _SceneAlone:
    """Shows frames, their names and truth in the scene, and notes what cannot be shown."""

    def __init__(self, server: Any, view: View) -> None:
        self._server, self._source, self._scene = server, view.source, SceneView(server)
        self._truth = view.truth
        if view.mesh is not None:
            self._scene.draw_mesh(view.mesh)
        self.refused: str | None = None
        self.shown_bytes = 0

    def show(self, shown: Shown) -> None:
        self._scene.show(shown, pictures=False)
        ends_m, frame = shown.first.ends_m, shown.wish.frame
        title = f"{self._source.name}, {self._source.label(frame)}"
        if shown.second is not None:
            title += f"; {LEGEND}"
        corner_m = np.array([ends_m[0, 1], ends_m[1, 1], ends_m[2, 0]])  # to the left in front
        self._server.scene.add_label(
            "/frame", title, position=UNITS_PER_M * corner_m, anchor="bottom-left"
        )
        truth = None if self._truth is None else self._truth(frame)
        if truth is not None:
            draw_truth(self._server.scene, truth)
        for drawn in filter(None, (shown.first, shown.second)):
            self.shown_bytes += drawn.cloud.points_m.nbytes + drawn.cloud.colours.nbytes

    def busy(self, text: str) -> None:
        pass

    def refuse(self, text: str) -> None:
        self.refused = text


def write_page(
    view: View, path: Path, *, force: bool = False, warn: Callable[[str], None] = print
) -> int:
    """Write the frames of a view into one HTML file, and return how many there are in it."""
    refuse_existing(path, force=force)  # before the work
    source, written = view.source, 0
    frames = source.frames()
    with running(source.name, port=0) as (server, _):
        front = _SceneAlone(server, view)
        session = Session(view, front)
        try:
            serializer = server.get_scene_serializer()
            for count, frame in enumerate(frames, 1):
                front.refused = None
                if written:  # a single frame needs no time line, whose end builds it anew
                    serializer.insert_sleep(1 / FRAMES_PER_S)
                session.change(frame=frame)
                session.settle()
                if front.refused is not None:
                    warn(f"left out: {front.refused}")
                    continue
                written += 1
                if front.shown_bytes > MOST_BYTES and count < len(frames):
                    warn(f"the first {count} of {len(frames)} frames: more are too many for a page")
                    break
        finally:
            session.close()
        if written > 1:
            serializer.insert_sleep(1 / FRAMES_PER_S)
        if not written:
            raise ClradarError(f"{source.name}: expected a frame that can be shown, got none")
        page = serializer.as_html(dark_mode=True)
    write_file(path, page.encode(), force=force)
    return written
