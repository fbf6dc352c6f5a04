"""The newest frame that has arrived: what nobody took in time is dropped."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from clradar.model import Capture


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A frame, and when it began to arrive.

    Attributes
    ----------
    capture : Capture
    label : str
        What the source calls it.
    since_s : float, seconds
        By `time.perf_counter`.
    """

    capture: Capture
    label: str
    since_s: float


@dataclass(frozen=True, slots=True)
class Counts:
    """Frames so far.

    Attributes
    ----------
    arrived : int
        Complete and valid.
    dropped : int
        Of them, or of those that were to be read, how many were outdated before their turn came.
    bad : int
        Damaged, incomplete, or by a sender that does not keep to the form.
    reason : str
        Of the last bad one.
    """

    arrived: int = 0
    dropped: int = 0
    bad: int = 0
    reason: str = ""


class Inbox:
    """Holds one frame between the thread of a source and that of the images."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: Arrived | None = None
        self._counts = Counts()
        self._ended = False

    @property
    def counts(self) -> Counts:
        with self._changed:
            return self._counts

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames, and the last one was taken."""
        with self._changed:
            return self._ended and self._frame is None

    def put(self, frame: Arrived) -> None:
        """Bring a frame, in place of one that nobody took."""
        with self._changed:
            self._count(arrived=1, dropped=int(self._frame is not None))
            self._frame = frame

    def drop(self, n: int) -> None:
        """Say that n frames were outdated before they were read."""
        with self._changed:
            self._count(dropped=n)

    def refuse(self, reason: str) -> None:
        """Say that a frame was bad, and why."""
        with self._changed:
            self._count(bad=1, reason=reason)

    def end(self) -> None:
        """Say that no more frames come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def take(self, timeout_s: float | None = None) -> Arrived | None:
        """Wait for a frame and take it; None where none came in time, or the source has ended."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._ended, timeout_s)
            taken, self._frame = self._frame, None
            return taken

    def wait_for(self, condition: Callable[[Counts], bool]) -> Counts:
        """Wait until the counts meet a condition, and return them."""
        with self._changed:
            self._changed.wait_for(lambda: condition(self._counts))
            return self._counts

    def _count(
        self, arrived: int = 0, dropped: int = 0, bad: int = 0, reason: str | None = None
    ) -> None:
        now = self._counts
        self._counts = Counts(
            now.arrived + arrived,
            now.dropped + dropped,
            now.bad + bad,
            now.reason if reason is None else reason,
        )
        self._changed.notify_all()
