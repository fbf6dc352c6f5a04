"""A folder that is written while it is read: which files are new, rewritten or gone."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from clradar.files.failures import reading

RECHECKED = 16
"""Files that were complete and are looked at again each time, in turn: there can be fifty looks a
second. The names of all are read each time."""


def visible(name: str) -> bool:
    """Whether a file is not hidden, as temporary ones are that get their name when complete."""
    return not name.startswith(".")


class WatchedFolder:
    """Files of a folder whose names count, looked at when asked."""

    def __init__(self, folder: Path, accepts: Callable[[str], bool] = visible) -> None:
        self.folder = folder
        self._accepts = accepts
        # Size and time of each file at the last look; complete ones in the order of their looks.
        self._growing: dict[str, tuple[int, int]] = {}
        self._complete: dict[str, tuple[int, int]] = {}

    def changes(self) -> list[Path]:
        """Return the files that are new or rewritten and complete since the last call, by name.

        Complete is a file with the same size, not 0, and time in two calls. Numbers in names count
        as numbers: 9 comes before 10.
        """
        with reading(self.folder, "a readable folder"), os.scandir(self.folder) as entries:
            names = {e.name for e in entries if self._accepts(e.name) and not e.is_dir()}
        for known in (self._growing, self._complete):
            for name in known.keys() - names:
                del known[name]
        again = list(islice(self._complete, RECHECKED))
        new = names - self._growing.keys() - self._complete.keys()
        found = []
        for name in (*self._growing, *new, *again):
            stamp = _stamp(self.folder / name)
            before = self._growing.pop(name, None) or self._complete.pop(name, None)
            if stamp is None:
                continue
            if stamp != before or not stamp[0]:
                self._growing[name] = stamp
                continue
            self._complete[name] = stamp
            if name not in again:
                found.append(name)
        return [self.folder / name for name in sorted(found, key=_by_number)]

    def is_there(self, name: str) -> bool:
        """Whether the last call found a file of this name, complete or not."""
        return name in self._complete or name in self._growing


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_size, found.st_mtime_ns) if stat.S_ISREG(found.st_mode) else None


def _by_number(name: str) -> list[tuple[int, str]]:
    parts = re.split("([0-9]+)", name)  # the second and every other one are digits
    return [(int(part), "") if at % 2 else (0, part) for at, part in enumerate(parts)]
