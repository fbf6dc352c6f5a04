"""Playing: the next frame as soon as one is shown, or the newest one as soon as it comes."""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque

from clradar.errors import ClradarError
from clradar.model import Capture
from clradar.view.session import Front, Session, Shown, View
from clradar.view.wish import escaped

WINDOW = 30  # frames over which rate and latency are taken
QUIET_S = 1.0  # without a new frame: the last one is imaged anew, as accurately as others
RETRY_S = 1.0  # after a folder could not be read


class Player(Session):
    """A session that plays frames, or shows the newest one of a source that grows.

    It looks in a thread of its own: while a frame is imaged the newest one is read; those between
    are dropped. The front is told whether the newest frame is followed when that or the frames have
    changed, and how fast frames come.
    """

    def __init__(self, view: View, front: Front) -> None:
        self.count = self.dropped = self.bad = 0
        """Frames that were shown, outdated before their turn came, or could not be read."""
        self._latencies: deque[tuple[float, float]] = deque(maxlen=WINDOW)
        """When frames were shown for which no imager was made, and their latencies, seconds."""
        self._last_s = time.perf_counter()
        self._following, self._newest = True, max(view.source.frames(), default=-1)
        """The last one that was shown or dropped."""
        self._asked, self._trouble, self._reason = -1, "", ""
        self._asked_s = self._image_s = self._read_s = 0.0
        """When a frame was asked for, and how long the last ones took the session and a read."""
        self._ended = threading.Event()
        self._looking = threading.Thread(target=self._look, name="clradar follow", daemon=True)
        super().__init__(view, front)

    def start(self) -> None:
        """Begin to look."""
        self._looking.start()

    def close(self) -> None:
        """End both threads."""
        self._ended.set()
        super().close()
        if self._looking.ident is not None:
            self._looking.join()

    def play(self, on: bool) -> None:
        """Begin or stop to follow, or to play what does not grow."""
        super().play(on and not self.source.grows)
        if self.source.grows:
            self._following = on
            if on and self.source.frames():
                self.change(frame=self.source.frames()[-1])
            self._finish()
            self._front.following(on)

    def chosen(self) -> None:
        """Stay at a frame that was chosen by hand."""
        if self._following:
            self._following = False
            self._finish()
            self._front.following(False)

    def _finish(self) -> None:
        """Image the frame of a quick image anew, and no others quickly until one is followed."""
        if self.wish.quick:
            self.change(quick=False)

    def _show(self, shown: Shown) -> None:
        super()._show(shown)
        if shown.wish.frame == self._asked:
            self._asked = -1
            self._image_s = time.perf_counter() - self._asked_s
            self.count, self._last_s = self.count + 1, time.perf_counter()
            if shown.prepared:
                self._latencies.clear()
            else:
                latency_s = self._last_s - self.source.came_s(shown.wish.frame)
                self._latencies.append((self._last_s, latency_s))

    @property
    def quiet_s(self) -> float:
        """Seconds since the last frame."""
        return time.perf_counter() - self._last_s

    def pace(self) -> str:
        """Return rate and latency of the last frames, and what was dropped or bad."""
        parts = [f"{self.count} shown"]
        if self._latencies:
            ends_s, latencies_s = zip(*self._latencies, strict=True)
            if (took_s := ends_s[-1] - ends_s[0]) > 0:
                parts.append(f"{(len(ends_s) - 1) / took_s:.1f} frames/s")
            median_s, most_s = statistics.median(latencies_s), max(latencies_s)
            parts.append(f"latency {1e3 * median_s:.0f} ms (at most {1e3 * most_s:.0f})")
        parts.append(f"{self.dropped} dropped")
        if self.bad:
            parts.append(f"{self.bad} bad, the last: {escaped(self._reason)}")
        first = ""
        if self.source.ended:
            first = "**End.** "
        elif not self._following:
            first = "**Stopped.** "
        elif self.quiet_s > 2.0:
            first = f"**No frame for {self.quiet_s:.0f} s.** "
        return first + ", ".join(parts)

    def look(self) -> bool:
        """Look once, and show the newest frame; whether the source could be read."""
        grew = self.source.grows
        try:
            changed = self.source.look()
        except ClradarError as error:
            # It may come back; until then one error stands for all looks.
            if str(error) != self._trouble:
                self._trouble = str(error)
                self._front.refuse(self._trouble)
            return False
        self._trouble = ""
        if self.source.grows and not grew:  # what was played until now is followed
            super().play(False)
            self._front.following(self._following)
        self._take(changed)
        if self._asked < 0 and self.quiet_s > QUIET_S:
            self._finish()
        if self.source.grows and (changed or self.quiet_s > QUIET_S):
            self._front.paced(self.pace())
        return True

    def _take(self, changed: bool) -> None:
        """Read the newest frame so that it is there when the one before is shown, and show it."""
        new = [frame for frame in self.source.frames() if frame > self._newest]
        if changed and not (self._following and new):
            self.dropped += len(new)
            self._newest = max([self._newest, *new])
            self._front.following(self._following)
            return
        begun_s = time.perf_counter()
        free_s = self._asked_s + self._image_s if self._waiting or self._busy else begun_s
        if not new or begun_s < free_s - self._read_s:
            return
        self._newest = new[-1]
        self.dropped += len(new) - 1
        try:
            content = self.source.read(new[-1])  # which keeps it for the session
        except ClradarError as error:
            self.bad, self._reason = self.bad + 1, str(error)
            return
        self._read_s = time.perf_counter() - begun_s
        self.settle()
        if self._following and not self._ended.is_set():
            self._asked, self._asked_s = new[-1], time.perf_counter()
            self.change(frame=new[-1], quick=isinstance(content, Capture))

    def _look(self) -> None:
        while not self._ended.is_set():
            if not self.look():
                self._ended.wait(RETRY_S)
