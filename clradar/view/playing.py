"""Playing: the next frame as soon as one is shown, or the newest one as soon as it comes."""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, cast

from clradar.errors import ClradarError
from clradar.view.panel import escaped
from clradar.view.session import Session, Shown
from clradar.view.sources import Growing, Source

WINDOW = 30
"""Frames over which rate and latency are taken."""

RETRY_S = 1.0
"""After a folder could not be read."""


class Played(Protocol):
    """What is played: a `Session`."""

    def step(self, by: int) -> None:
        """Wish for the next frame."""

    def settle(self) -> None:
        """Return when it is shown."""


class Player:
    """Steps through a session in a thread of its own while it plays; or follows what comes."""

    def __init__(
        self, session: Played, per_second: float, follower: Follower | None = None
    ) -> None:
        self.per_second = per_second
        self._session, self._follower = session, follower
        self._changed = threading.Condition()
        self._playing = self._closed = False
        self._thread = threading.Thread(target=self._run, name="clradar play", daemon=True)
        self._thread.start()

    def play(self, on: bool) -> None:
        """Begin or stop to play."""
        follows = self._follower is not None and self._follower.source.grows
        if self._follower is not None:
            self._follower.follow(on and follows)
        with self._changed:
            self._playing = on and not follows
            self._changed.notify_all()

    def chosen(self) -> None:
        """Stay at a frame that was chosen by hand, unless it is the newest."""
        if self._follower is not None:
            self._follower.stay()

    def close(self) -> None:
        """End the thread; the session has to be closed first, or to settle."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._playing)
                if self._closed:
                    return
            start_s = time.monotonic()
            self._session.step(1)
            self._session.settle()
            left_s = 1 / self.per_second - (time.monotonic() - start_s)
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or not self._playing, timeout=max(0.0, left_s)
                )


class Follower:
    """Shows the newest frame of a source that grows, in a thread of its own.

    Once a frame is shown, the newest one is read and imaged; those between are dropped.
    """

    def __init__(
        self,
        source: Source,
        session: Session,
        changed: Callable[[bool], None],
        say: Callable[[str], None],
        refuse: Callable[[str], None],
    ) -> None:
        self.source = cast(Growing, source)
        self._session = session
        self._changed, self._say, self._refuse = changed, say, refuse
        self.following = True
        self.pace = Pace()
        self._newest = max(source.frames(), default=-1)
        """The last one that was shown or dropped."""
        self._asked, self._trouble = -1, ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="clradar follow", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; the session has to be closed first."""
        self._closed.set()
        if self._thread.ident is not None:
            self._thread.join()

    def follow(self, on: bool) -> None:
        """Go on with the newest frame, or stay at this one."""
        frames = self.source.frames()
        self.following = on
        if on and frames:
            self._session.change(frame=frames[-1])
        self._changed(on)

    def stay(self) -> None:
        """Stay at a frame that was chosen by hand."""
        if self.following:
            self.following = False
            self._changed(False)

    def shown(self, shown: Shown) -> None:
        """Count a frame that has just been shown."""
        if shown.wish.frame == self._asked:
            self._asked = -1
            self.pace.count(self.source.came_s(shown.wish.frame), prepared=shown.prepared)

    def look(self) -> bool:
        """Look once, and show the newest frame; whether the source could be read."""
        try:
            changed = self.source.look()
        except ClradarError as error:
            # It may come back; until then one error stands for all looks.
            if str(error) != self._trouble:
                self._trouble = str(error)
                self._refuse(self._trouble)
            return False
        self._trouble = ""
        if changed:
            self._take()
        if self.source.grows and (changed or self.pace.quiet_s > 1.0):
            self._say(self.pace.text(self.following, getattr(self.source, "ended", False)))
        return True

    def _run(self) -> None:
        while not self._closed.is_set():
            if not self.look():
                self._closed.wait(RETRY_S)

    def _take(self) -> None:
        new = [frame for frame in self.source.frames() if frame > self._newest]
        if not self.following or not new:
            self.pace.dropped += len(new)
            self._newest = max(self._newest, *new) if new else self._newest
            self._changed(self.following)
            return
        self._newest = new[-1]
        self.pace.dropped += len(new) - 1
        try:
            self.source.read(new[-1])  # which keeps it for the session
        except ClradarError as error:
            self.pace.bad, self.pace.reason = self.pace.bad + 1, str(error)
            return
        if self.following and not self._closed.is_set():
            self._asked = new[-1]
            self._session.change(frame=new[-1])
            self._session.settle()


@dataclass
class Pace:
    """Frames shown, and how fast of late; those for which an imager was made are left out.

    Attributes
    ----------
    shown, dropped, bad : int
        Dropped are those that were outdated before their turn came.
    reason : str
        Of the last bad one.
    """

    shown: int = 0
    dropped: int = 0
    bad: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        self._ends_s: deque[float] = deque(maxlen=WINDOW)
        self._latencies_s: deque[float] = deque(maxlen=WINDOW)
        self._last_s = time.perf_counter()

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
            parts.append(
                f"latency {1e3 * statistics.median(self._latencies_s):.0f} ms "
                f"(at most {1e3 * max(self._latencies_s):.0f})"
            )
        parts.append(f"{self.dropped} dropped")
        if self.bad:
            parts.append(f"{self.bad} bad, the last: {escaped(self.reason)}")
        if ended:
            first = "End"
        elif not following:
            first = "Stopped"
        elif self.quiet_s > 2.0:
            first = f"No frame for {self.quiet_s:.0f} s"
        else:
            first = ""
        return (f"**{first}.** " if first else "") + ", ".join(parts)


def can_follow(source: Any) -> bool:
    """Whether a source can be looked at again."""
    return hasattr(source, "look")
