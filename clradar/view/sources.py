"""What is viewed: frames of a path or of a Python iterable, read one at a time, and new ones."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import measurement_io
from clradar.dataset.folder import is_dataset
from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import fail
from clradar.files.watched_folder import WatchedFolder, visible
from clradar.model import Capture, Volume, checks
from clradar.view.drawn import Flat
from measurement_io.maroon.folders import FRAMES_FOLDER, find_radar_folder, frame_file
from measurement_io.opening import kind_of

Content: TypeAlias = Capture | Volume | Flat

SUFFIXES = (".h5", ".hdf5", ".nxs", ".npy")

LOOK_S, REST_S = 0.02, 0.5
"""Between looks at a folder while files come, and once none came for ten times the second."""

KEPT_BYTES = 256 * 2**20
"""Of samples of an iterable, to look back at: 29 frames of 94 x 94 pairs and 128 frequencies."""


class Source(Protocol):
    """Frames that are read on access, each under a number of its own.

    A number stands for one content: what is written anew gets a new one. What is remembered of a
    frame under its number stays right. `grows`: frames come while it is viewed, and the newest is
    to be shown.
    """

    name: str
    grows: bool

    def frames(self) -> tuple[int, ...]:
        """Return the numbers of the frames to go through, ascending; they may change."""

    def label(self, frame: int) -> str:
        """Return what a frame is called."""

    def read(self, frame: int) -> Content:
        """Read a frame; errors are those of `measurement_io.open_capture`."""


@runtime_checkable
class Growing(Source, Protocol):
    """A source that is looked at again."""

    def look(self) -> bool:
        """Wait a while for other frames; return whether there are."""

    def came_s(self, frame: int) -> float:
        """Return when a frame came, by `time.perf_counter`."""


@dataclass(slots=True)
class FixedFrames:
    """A source whose frames do not change: 0, 1, ... with these labels, at least one."""

    name: str
    labels: tuple[str, ...]
    read: Callable[[int], Content]
    grows: bool = False

    def frames(self) -> tuple[int, ...]:
        return tuple(range(len(self.labels)))

    def label(self, frame: int) -> str:
        return self.labels[frame]


def open_source(path: Path, variant: str = "raw", *, watch: bool = False) -> Source:
    """Return the frames of a recording, a data set or a folder, or the one of a file."""
    from clradar.view.samples import SampleFrames

    if is_dataset(path):
        return SampleFrames(path, watch=watch)
    if watch or kind_of(path) == "folder":
        return FolderFrames(path, variant, watch=watch)
    name = path.name or path.absolute().name
    content = read_file(path)  # a file that is damaged is refused before there is a page
    return FixedFrames(name, (name,), lambda _: content)


def read_file(path: Path) -> Capture | Volume:
    """Read a capture, a recorded frame or a volume; errors as `measurement_io.open_capture`."""
    found = measurement_io.open(path)  # kind and content in one confined process
    return found if isinstance(found, Capture | Volume) else measurement_io.open_capture(path)


class FolderFrames:
    """The files of a folder; new, rewritten and removed ones are taken in by `look`."""

    def __init__(self, path: Path, variant: str, *, watch: bool) -> None:
        self.name = path.name or path.absolute().name
        self.grows = watch
        self._path = path
        self._is_recording, self._folder = _watched(path, variant)
        self._lock = threading.Lock()
        self._files: dict[int, tuple[Path, float]] = {}
        """With when they came; replaced, never changed, since others read it meanwhile."""
        self._last: dict[int, Capture | Volume] = {}
        self._count, self._changed_s = 0, time.perf_counter()
        self._take_in()
        time.sleep(LOOK_S)  # a file is complete once it is the same in two looks
        self._take_in()
        if not self._files and not watch:
            fail(path, f"a recording, or files ({', '.join(SUFFIXES)}) in the folder", "none")

    def frames(self) -> tuple[int, ...]:
        return tuple(self._files)

    def label(self, frame: int) -> str:
        path, _ = self._files.get(frame, (None, 0.0))
        if path is None:
            return "a file that is gone"
        number = frame_file(path).frame if self._is_recording else None
        return path.name if number is None else f"frame {number}"

    def read(self, frame: int) -> Capture | Volume:
        last = self._last  # the newest is read ahead, while the one before is imaged
        if frame in last:
            return last[frame]
        path, _ = self._files.get(frame, (None, 0.0))
        if path is None:
            fail(self._path, "the file of a frame", "none: it is gone, or not there yet")
        try:
            content = read_file(path)
        except ClradarError:
            # Half-written, perhaps: once it has changed it comes again, under another number.
            with self._lock:
                self._files = {n: file for n, file in self._files.items() if n != frame}
            raise
        self._last = {**dict(list(last.items())[-1:]), frame: content}
        return content

    def came_s(self, frame: int) -> float:
        return self._files.get(frame, (None, time.perf_counter()))[1]

    def look(self) -> bool:
        """Wait a while, take in new, rewritten and removed files; whether the frames are others."""
        frames, count = self.frames(), self._count
        if time.perf_counter() - self._changed_s > 10 * REST_S:
            time.sleep(REST_S)
            self._take_in()
        time.sleep(LOOK_S)
        begun_s = time.perf_counter()
        self._take_in()
        if self._count > count:
            self.grows, self._changed_s = True, time.perf_counter()
        # Where a look takes long, as over a network, there are fewer.
        time.sleep(min(2.0, 4 * (time.perf_counter() - begun_s)))
        return self.frames() != frames

    def _take_in(self) -> None:
        found = self._folder.changes()
        names = {path.name for path in found}
        now_s = time.perf_counter()
        behind_s = time.time() - now_s
        with self._lock:
            files = {
                number: (path, came_s)
                for number, (path, came_s) in self._files.items()
                if path.name not in names and self._folder.is_there(path.name)
            }
            for path in found:
                came_s = now_s
                with suppress(OSError):  # gone again
                    came_s = min(now_s, path.stat().st_mtime - behind_s)
                files[self._count] = path, came_s
                self._count += 1
            self._files = files


def _watched(path: Path, variant: str) -> tuple[bool, WatchedFolder]:
    """Return whether a folder is a recording, and what is looked at."""
    if not path.is_dir():
        fail(path, "a folder", "a file" if path.exists() else "nothing there")
    try:
        data = find_radar_folder(path) / FRAMES_FOLDER
    except MeasurementError:
        data = path
    if data.is_dir() and data != path:

        def is_frame(name: str) -> bool:
            file = frame_file(Path(name))
            return file.frame is not None and file.variant == variant

        return True, WatchedFolder(data, is_frame)
    return False, WatchedFolder(path, lambda name: visible(name) and name.endswith(SUFFIXES))


def viewed(frame: Any) -> Capture | Volume:
    """Return a frame of `clradar.view.show`, or raise `ModelError` if it is none."""
    checks.instance("show: frames", frame, Capture | Volume)
    return frame


class StreamFrames:
    """Captures or volumes of an iterable, gone through in a thread; the last ones are kept."""

    grows = True

    def __init__(self, frames: Iterable[Capture | Volume], name: str) -> None:
        self.name = name
        self.ended = False
        self.error: BaseException | None = None
        """What the iterable raised."""
        self._kept: dict[int, tuple[Capture | Volume, float]] = {}
        self._changed = threading.Condition()
        self._looked = -1
        self._thread = threading.Thread(
            target=self._run, args=(frames,), name="clradar frames", daemon=True
        )
        self._thread.start()

    def frames(self) -> tuple[int, ...]:
        return tuple(self._kept)

    def label(self, frame: int) -> str:
        kept = self._kept.get(frame)
        if kept is None:
            return "a frame that is no longer kept"
        return f"frame {kept[0].meta.get('frame', frame)}"

    def read(self, frame: int) -> Capture | Volume:
        kept = self._kept.get(frame)
        if kept is None:
            raise MeasurementError(f"{self.name}: expected a frame that is kept, got {frame}")
        return kept[0]

    def came_s(self, frame: int) -> float:
        return self._kept.get(frame, (None, time.perf_counter()))[1]

    def look(self) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: max(self._kept, default=-1) > self._looked, REST_S)
            newest, before = max(self._kept, default=-1), self._looked
            self._looked = newest
        return newest > before

    def _run(self, frames: Iterable[Capture | Volume]) -> None:
        try:
            for count, frame in enumerate(frames):
                kept = {**self._kept, count: (viewed(frame), time.perf_counter())}
                left = sum(one.data.nbytes for one, _ in kept.values())
                while left > KEPT_BYTES and len(kept) > 1:
                    left -= kept.pop(next(iter(kept)))[0].data.nbytes
                with self._changed:
                    self._kept = kept  # replaced, since others read it meanwhile
                    self._changed.notify_all()
        except BaseException as error:
            self.error = error
        finally:
            self.ended = True
