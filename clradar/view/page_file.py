"""A view as one file: scene and time line, to be opened without a server."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ClradarError
from clradar.files.atomic import refuse_existing, write_file
from clradar.view.scene import LEGEND, SceneView
from clradar.view.server import running
from clradar.view.session import Front, Session, Shown, View
from clradar.view.truth import UNITS_PER_M

MOST_BYTES = 200 * 2**20
"""Of points and colours: what a browser still opens as one page."""

FRAMES_PER_S = 10.0


def write_page(
    view: View, path: Path, *, force: bool = False, warn: Callable[[str], None] = print
) -> int:
    """Write the frames of a view into one HTML file, and return how many there are in it."""
    refuse_existing(path, force=force)  # before the work
    source, written, drawn_bytes = view.source, 0, 0
    frames = source.frames()
    with running(source.name, port=0) as (server, _):
        scene = SceneView(server, view)
        with closing(Session(view, Front())) as session:
            serializer = server.get_scene_serializer()
            for count, frame in enumerate(frames, 1):
                session.change(frame=frame, layout="3-D")
                session.settle()
                shown = session.shown
                if session.refused or shown is None:
                    warn(f"left out: {session.refused}")
                    continue
                if written:  # a single frame needs no time line, whose end builds it anew
                    serializer.insert_sleep(1 / FRAMES_PER_S)
                scene.show(shown)
                _draw_title(server, shown, source.name, source.label(frame))
                written += 1
                for drawn in filter(None, (shown.first, shown.second)):
                    drawn_bytes += drawn.points_m.nbytes + drawn.colours.nbytes
                if drawn_bytes > MOST_BYTES and count < len(frames):
                    warn(f"the first {count} of {len(frames)} frames: more are too many for a page")
                    break
        if written > 1:
            serializer.insert_sleep(1 / FRAMES_PER_S)
        if not written:
            raise ClradarError(f"{source.name}: expected a frame that can be shown, got none")
        page = serializer.as_html(dark_mode=True)
    write_file(path, page.encode(), force=force)
    return written


def _draw_title(server: Any, shown: Shown, *names: str) -> None:
    """Draw the name of a frame to the left in front of the box."""
    ends_m = shown.first.ends_m
    corner_m = np.array([ends_m[0, 1], ends_m[1, 1], ends_m[2, 0]])
    legend = "" if shown.second is None else f"; {LEGEND}"
    title = ", ".join(dict.fromkeys(names)) + legend  # the frame of a file has its name
    server.scene.add_label("/frame", title, position=UNITS_PER_M * corner_m, anchor="bottom-left")
