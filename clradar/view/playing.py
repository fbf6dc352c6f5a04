"""Playing: the next frame as soon as one is shown, or the newest one as soon as it comes."""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from clradar.errors import ClradarError
from clradar.model import Capture
from clradar.view.session import Session, Shown
from clradar.view.sources import Growing, Source
from clradar.view.wish import escaped

WINDOW = 30
"""Frames over which rate and latency are taken."""

QUIET_S = 1.0
"""Without a new frame: the last one is imaged anew, as accurately as others."""

PLAYED_HZ = 10.0
"""At most, of frames that do not come by themselves."""

RETRY_S = 1.0
"""After a folder could not be read."""


@dataclass
class Pace:
    """Frames shown, and how fast of late; those for which an imager was made are left out.

    Dropped are those that were outdated before their turn came; `reason` is of the last bad one.
    """

    shown: int = 0
    dropped: int = 0
    bad: int = 0
    reason: str = ""
    _ends_s: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _latencies_s: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _last_s: float = field(default_factory=time.perf_counter)

    @property
    def quiet_s(self) -> float:
        """Seconds since the last frame."""
        return time.perf_counter() - self._last_s

    @property
    def rate_hz(self) -> float:
        """Over the last 30 frames; 0 before the second."""
        took_s = self._ends_s[-1] - self._ends_s[0] if self._ends_s else 0.0
        return (len(self._ends_s) - 1) / took_s if took_s > 0 else 0.0

    def count(self, came_s: float, *, prepared: bool) -> None:
        """Count a frame that came at a time of `time.perf_counter`, and is shown now."""
        self.shown += 1
        self._last_s = time.perf_counter()
        if prepared:
            self._ends_s.clear()
            self._latencies_s.clear()
            return
        self._ends_s.append(self._last_s)
        self._latencies_s.append(self._last_s - came_s)

    def text(self, following: bool, ended: bool) -> str:
        """Return rate, latency, and what was dropped or bad."""
        parts = [f"{self.shown} shown"]
        if self.rate_hz:
            parts.append(f"{self.rate_hz:.1f} frames/s")
        if self._latencies_s:
            median_s, most_s = statistics.median(self._latencies_s), max(self._latencies_s)
            parts.append(f"latency {1e3 * median_s:.0f} ms (at most {1e3 * most_s:.0f})")
        parts.append(f"{self.dropped} dropped")
        if self.bad:
            parts.append(f"{self.bad} bad, the last: {escaped(self.reason)}")
        first = ""
        if ended:
            first = "**End.** "
        elif not following:
            first = "**Stopped.** "
        elif self.quiet_s > 2.0:
            first = f"**No frame for {self.quiet_s:.0f} s.** "
        return first + ", ".join(parts)


class Player:
    """Steps through a session while it plays, or shows the newest frame of a source that grows.

    Each in a thread of its own. While a frame is imaged the newest one is read; those between are
    dropped. `front` is told whether the newest frame is followed when that or the frames have
    changed (`following`), how fast frames come (`paced`), and what went wrong (`refuse`).
    """

    def __init__(self, session: Session, source: Source, front: Any) -> None:
        self.pace = Pace()
        self._session, self._source = session, source
        self._growing = source if isinstance(source, Growing) else None
        self._front = front
        self._following, self._newest = True, max(source.frames(), default=-1)
        """The last one that was shown or dropped."""
        self._asked, self._trouble = -1, ""
        self._asked_s = self._image_s = self._read_s = 0.0
        """When the session was asked for a frame, and how long the last ones took it and a read."""
        self._changed = threading.Condition()
        self._playing = False
        self._closed = threading.Event()
        runs = {"clradar play": self._play}
        if self._growing is not None:
            runs["clradar follow"] = self._follow
        self._threads = [
            threading.Thread(target=run, name=name, daemon=True) for name, run in runs.items()
        ]

    def start(self) -> None:
        """Begin to look."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the threads; the session has to be closed first, or to settle."""
        with self._changed:
            self._closed.set()
            self._changed.notify_all()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()

    def play(self, on: bool) -> None:
        """Begin or stop to play, or to follow."""
        if self._source.grows:
            self._following = on
            if on and self._source.frames():
                self._session.change(frame=self._source.frames()[-1])
            self._finish()
            self._front.following(on)
        with self._changed:
            self._playing = on and not self._source.grows
            self._changed.notify_all()

    def chosen(self) -> None:
        """Stay at a frame that was chosen by hand."""
        if self._growing is not None and self._following:
            self._following = False
            self._finish()
            self._front.following(False)

    def step(self, by: int) -> None:
        """Go on by some frames, and stay there."""
        self.chosen()
        self._session.step(by)

    def _finish(self) -> None:
        """Image the frame of a quick image anew, and no others quickly until one is followed."""
        if self._session.wish.quick:
            self._session.change(quick=False)

    def shown(self, shown: Shown) -> None:
        """Count a frame that has just been shown."""
        if self._growing is not None and shown.wish.frame == self._asked:
            self._asked = -1
            self._image_s = time.perf_counter() - self._asked_s
            self.pace.count(self._growing.came_s(shown.wish.frame), prepared=shown.prepared)

    def look(self, growing: Growing) -> bool:
        """Look once, and show the newest frame; whether the source could be read."""
        try:
            changed = growing.look()
        except ClradarError as error:
            # It may come back; until then one error stands for all looks.
            if str(error) != self._trouble:
                self._trouble = str(error)
                self._front.refuse(self._trouble)
            return False
        self._trouble = ""
        self._take(growing, changed)
        if self._asked < 0 and self.pace.quiet_s > QUIET_S:
            self._finish()
        if growing.grows and (changed or self.pace.quiet_s > QUIET_S):
            self._front.paced(self.pace.text(self._following, getattr(growing, "ended", False)))
        return True

    def _take(self, growing: Growing, changed: bool) -> None:
        """Read the newest frame so that it is there when the one before is shown, and show it."""
        new = [frame for frame in growing.frames() if frame > self._newest]
        if changed and not (self._following and new):
            self.pace.dropped += len(new)
            self._newest = max([self._newest, *new])
            self._front.following(self._following)
            return
        begun_s = time.perf_counter()
        free_s = self._asked_s + self._image_s if self._session.busy else begun_s
        if not new or begun_s < free_s - self._read_s:
            return
        self._newest = new[-1]
        self.pace.dropped += len(new) - 1
        try:
            content = growing.read(new[-1])  # which keeps it for the session
        except ClradarError as error:
            self.pace.bad, self.pace.reason = self.pace.bad + 1, str(error)
            return
        self._read_s = time.perf_counter() - begun_s
        self._session.settle()
        if self._following and not self._closed.is_set():
            self._asked, self._asked_s = new[-1], time.perf_counter()
            self._session.change(frame=new[-1], quick=isinstance(content, Capture))

    def _follow(self) -> None:
        assert self._growing is not None
        while not self._closed.is_set():
            if not self.look(self._growing):
                self._closed.wait(RETRY_S)

    def _play(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed.is_set() or self._playing)
            if self._closed.is_set():
                return
            start_s = time.monotonic()
            self._session.step(1)
            self._session.settle()
            left_s = 1 / PLAYED_HZ - (time.monotonic() - start_s)
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed.is_set() or not self._playing, timeout=max(0.0, left_s)
                )
