"""Captures and volumes in a folder as frames, also while the folder is written."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import fail
from clradar.files.watched_folder import WatchedFolder, visible
from clradar.model import Capture, Volume
from measurement_io.maroon.folders import FRAMES_FOLDER, find_radar_folder, frame_file

SUFFIXES = (".h5", ".hdf5", ".nxs", ".npy")


class FolderFrames:
    """The files of a folder as a source; `look` takes in what was written since.

    Parameters
    ----------
    path : Path
        A folder of files, a radar folder, or the folder that holds one.
    variant : {"raw", "emptyfiltered"}
        Of a recording's frames.
    read_file : callable
        Opens a file.
    follow : bool
        Whether a view looks at the folder again, see `Follower`.

    Raises
    ------
    MeasurementError
        The folder cannot be read.
    """

    def __init__(
        self,
        path: Path,
        variant: str,
        read_file: Callable[[Path], Capture | Volume],
        *,
        follow: bool = False,
    ) -> None:
        self.follow = follow
        self.name = path.name or path.absolute().name
        self._path = path
        self._folder = _watched(path, variant)
        self._read_file = read_file
        self._lock = threading.Lock()
        self._paths: dict[int, Path] = {}
        self._frames: tuple[int, ...] = ()
        self._looked = self._frames
        self._count = 0
        self.look()
        self.look()  # a file is complete once it has been seen twice

    def frames(self) -> tuple[int, ...]:
        return self._frames

    def label(self, frame: int) -> str:
        path = self._paths.get(frame)
        return "a file that is gone" if path is None else path.name

    def read(self, frame: int) -> Capture | Volume:
        path = self._paths.get(frame)
        if path is None:
            fail(self._path, "the file of a frame", "none: it is gone, or not there yet")
        try:
            return self._read_file(path)
        except ClradarError:
            # Half-written, perhaps: once it has changed it comes again, under another number.
            with self._lock:
                self._paths.pop(frame, None)
                self._frames = tuple(self._paths)
            raise

    def look(self) -> bool:
        """Take in new, rewritten and removed files; return whether the frames are others now.

        Raises
        ------
        MeasurementError
            The folder cannot be read; the frames are those of before.
        """
        found = self._folder.changes()
        names = {path.name for path in found}
        before = self._looked
        with self._lock:
            self._paths = {
                number: path
                for number, path in self._paths.items()
                if path.name not in names and self._folder.is_there(path.name)
            }
            for path in found:
                self._paths[self._count] = path
                self._count += 1
            self._frames = tuple(self._paths)
        return self._frames != before


def _watched(path: Path, variant: str) -> WatchedFolder:
    if not path.is_dir():
        fail(path, "a folder", "a file" if path.exists() else "nothing there")
    try:
        data = find_radar_folder(path) / FRAMES_FOLDER
    except MeasurementError:
        data = path
    if data.is_dir() and data != path:
        return WatchedFolder(data, partial(_is_frame, variant))
    return WatchedFolder(path, lambda name: visible(name) and name.endswith(SUFFIXES))


def _is_frame(variant: str, name: str) -> bool:
    found = frame_file(Path(name))
    return found.frame is not None and found.variant == variant
