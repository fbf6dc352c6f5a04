"""One thread that carries out wishes; of those that wait, the newest alone."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

W = TypeVar("W")


class Outdated(Exception):
    """Raised to leave work whose result nobody wants any more."""


class NewestWish(Generic[W]):
    """Carries out the newest wish in a thread of its own.

    Parameters
    ----------
    carry_out : callable
        Called with a wish, and with a function that raises `Outdated` once there is a newer one, or
        it is closed. It handles its own errors.
    """

    def __init__(self, carry_out: Callable[[W, Callable[[], None]], None]) -> None:
        self._carry_out = carry_out
        self._changed = threading.Condition()
        self._waiting: list[W] = []
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, name="clradar view", daemon=True)
        self._thread.start()

    def wish(self, wish: W) -> None:
        """Replace the wish that waits; the one being carried out learns that it is outdated."""
        with self._changed:
            self._waiting = [wish]
            self._changed.notify_all()

    def settle(self) -> None:
        """Return when nothing waits and nothing is carried out, or it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not (self._waiting or self._busy))

    def close(self) -> None:
        """Leave what is being done, and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _check(self) -> None:
        if self._waiting or self._closed:
            raise Outdated

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or bool(self._waiting))
                if self._closed:
                    return
                wish = self._waiting.pop()
                self._busy = True
            try:
                self._carry_out(wish, self._check)
            except Outdated:
                continue
