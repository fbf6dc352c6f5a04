"""What `clradar live --view` shows: the newest frame in the panels of `clradar view`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from clradar.errors import ClradarError, MeasurementError
from clradar.live.inbox import Arrived, Counts
from clradar.live.loop import KeptImager, Pace
from clradar.live.loop import Shown as LiveShown
from clradar.live.screen import state_words
from clradar.model import Capture, DepthMap, Volume, VoxelGrid
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.view.controls import assign
from clradar.view.page import Page
from clradar.view.panel import escaped
from clradar.view.server import running
from clradar.view.session import Session, Shown
from clradar.view.wish import Wish

if TYPE_CHECKING:
    from clradar.view.local_server import Clicks

KEPT_BYTES = 256 * 2**20
"""Of samples, to look back at: 29 frames of 94 x 94 pairs and 128 frequencies."""


class LiveFrames:
    """The last frames that were shown, as a source of the view."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._count = 0
        self._kept: dict[int, Arrived] = {}

    def frames(self) -> tuple[int, ...]:
        return tuple(self._kept)

    def label(self, frame: int) -> str:
        arrived = self._kept.get(frame)
        return "a frame that is no longer kept" if arrived is None else arrived.label

    def read(self, frame: int) -> Capture:
        arrived = self._kept.get(frame)
        if arrived is None:
            raise MeasurementError(f"{self.name}: expected a frame that is kept, got {frame}")
        return arrived.capture

    def put(self, arrived: Arrived) -> int:
        """Take in a frame, and return its number."""
        kept = {**self._kept, self._count: arrived}
        left = sum(one.capture.data.nbytes for one in kept.values())
        while left > KEPT_BYTES and len(kept) > 1:
            left -= kept.pop(next(iter(kept))).capture.data.nbytes
        self._kept = kept  # replaced, since others read it meanwhile
        self._count += 1
        return self._count - 1


class _Front:
    """What the session of a live page shows its results with."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.shown: Shown | None = None
        self.refused: str | None = None

    def show(self, shown: Shown) -> None:
        self._page.show(shown)
        self.shown = shown

    def busy(self, words: str) -> None:
        if self.shown is None:  # after that it would come and go with every frame
            self._page.busy(words)

    def refuse(self, words: str) -> None:
        self._page.refuse(words)
        self.refused = words


class LivePage:
    """Images and shows frames in a page: the `Images` and the `Screen` of `clradar.live.run`.

    A frame is done when the page has been told to show it. While an earlier frame is looked at, or
    playing is stopped, those that come are left out.

    Parameters
    ----------
    server : viser.ViserServer
    clicks : Clicks
    words : str
        What the source is.
    wish : Wish
    tolerance_db : float or None
    device : Device

    Attributes
    ----------
    port : int
        Where it is served.
    """

    def __init__(
        self,
        server: Any,
        clicks: Clicks,
        words: str,
        wish: Wish,
        tolerance_db: float | None,
        device: Device,
    ) -> None:
        self.port: int = server.get_port()
        self._grid = wish.grid
        self._frames = LiveFrames(words)
        self._imager = KeptImager(tolerance_db, device)
        self._page = Page(server, clicks, self._frames, wish, live=True)
        self._front = _Front(self._page)
        self._session = Session(self._frames, wish, self._front, device, self._form)
        self._playing = True
        self._shown_s = time.perf_counter()
        self._page.connect(self._session, self)
        self._page.busy(escaped(words))

    def close(self) -> None:
        """End the thread and free the device's memory."""
        self._session.close()
        self._imager.close()

    def image(self, frame: Arrived) -> DepthMap | None:
        """Image and show a frame, unless another one is looked at.

        Raises
        ------
        ClradarError
            It cannot be imaged.
        """
        there = self._frames.frames()
        if there and self._session.wish.frame != there[-1]:
            self._playing = False
            assign(self._page.panel.play, "value", False)
        if not self._playing:
            return None
        changes: dict[str, Any] = {"frame": self._frames.put(frame)}
        if there and not _same_radar(self._frames.read(there[-1]), frame.capture):
            changes["grid"] = self._grid
        self._front.shown = self._front.refused = None
        self._session.change(**changes)
        self._session.settle()
        if self._front.refused is not None:
            raise ClradarError(self._front.refused)
        shown = self._front.shown
        if shown is None or shown.wish.frame != changes["frame"]:
            return None
        return shown.first.picture.image

    def play(self, on: bool) -> None:
        """Go on with the newest frame, or stay at this one."""
        self._playing = on
        there = self._frames.frames()
        if on and there:
            self._session.change(frame=there[-1])

    def show(self, shown: LiveShown) -> None:
        """Say how fast frames are shown; the frame itself is."""
        self._shown_s = time.perf_counter()
        self._say("", shown.pace, shown.counts)

    def waiting(self, pace: Pace, counts: Counts) -> None:
        """Say that no frame is shown, and why."""
        silent_s = time.perf_counter() - self._shown_s
        words = f"**No frame for {silent_s:.0f} s.** " if self._playing else "**Stopped.** "
        self._say(words, pace, counts)

    def end(self, pace: Pace, counts: Counts) -> None:
        """Say that no more frames come."""
        self._say("**End.** ", pace, counts)

    def _say(self, words: str, pace: Pace, counts: Counts) -> None:
        self._page.panel.pace.content = words + escaped(state_words(pace, counts))

    def _form(
        self, capture: Capture, grid: VoxelGrid, *, method: str, window: str, progress: Progress,
        **_: Any,
    ) -> Volume:  # fmt: skip
        imager = self._imager.of(capture, grid, window, method)
        imager.form(capture, progress)
        return imager.volume()


def _same_radar(one: Capture, other: Capture) -> bool:
    return one.array.same_positions(other.array) and one.waveform.same_frequencies(other.waveform)


@contextmanager
def live_page(
    words: str, wish: Wish, tolerance_db: float | None, device: Device, port: int
) -> Iterator[LivePage]:
    """Serve a live page during the block; arguments as `LivePage`, errors as those of
    `clradar.view.server.serving`.
    """
    with running("clradar live", port) as (server, clicks):
        page = LivePage(server, clicks, words, wish, tolerance_db, device)
        try:
            yield page
        finally:
            page.close()
