"""Playing: the next frame as soon as one is shown, but not faster than a rate."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Played(Protocol):
    """What is played: a `Session`."""

    def step(self, by: int) -> None:
        """Wish for the next frame."""

    def settle(self) -> None:
        """Return when it is shown."""


class Player:
    """Steps through a session in a thread of its own while it plays."""

    def __init__(self, session: Played, per_second: float) -> None:
        self.per_second = per_second
        self._session = session
        self._changed = threading.Condition()
        self._playing = self._closed = False
        self._thread = threading.Thread(target=self._run, name="clradar play", daemon=True)
        self._thread.start()

    @property
    def playing(self) -> bool:
        """Whether it plays."""
        return self._playing

    def play(self, on: bool) -> None:
        """Begin or stop to play."""
        with self._changed:
            self._playing = on
            self._changed.notify_all()

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
