"""Following what is being written: new files or samples become frames, the newest is shown."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from clradar.errors import ClradarError
from clradar.view.session import Session

LOOK_EVERY_S = 1.0


class Followed(Protocol):
    """What can be followed: `FolderFrames`, `SampleFrames`."""

    def frames(self) -> tuple[int, ...]:
        """Return the numbers of the frames."""

    def look(self) -> bool:
        """Take in what was written since; return whether the frames are others now."""


class Follower:
    """Looks at a source in a thread of its own.

    Parameters
    ----------
    source : Followed
    session : Session
    changed : callable
        Told the frame that is shown once there are others.
    refuse : callable
        Told why the folder cannot be read.
    """

    def __init__(
        self,
        source: Followed,
        session: Session,
        changed: Callable[[int], None],
        refuse: Callable[[str], None],
    ) -> None:
        self._source, self._session = source, session
        self._changed, self._refuse = changed, refuse
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="clradar watch", daemon=True)

    def start(self) -> None:
        """Begin to look every second."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        if self._thread.ident is not None:
            self._thread.join()

    def look(self) -> None:
        """Look once. A newer frame is shown, unless an earlier one is being looked at."""
        before = self._source.frames()
        try:
            if not self._source.look():
                return
        except ClradarError as error:
            self._refuse(str(error))
            return
        frames, wished = self._source.frames(), self._session.wish.frame
        self._changed(wished)
        if frames and frames[-1] > wished and (not before or wished >= before[-1]):
            self._session.change(frame=frames[-1])

    def _run(self) -> None:
        while not self._closed.wait(LOOK_EVERY_S):
            self.look()
