"""What is viewed: the frames behind a path, read one at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from clradar.dataset.store.folder import is_dataset
from clradar.errors import MeasurementError
from clradar.model import Capture, Volume
from clradar.view.folder_frames import SUFFIXES, FolderFrames
from clradar.view.samples import SampleFrames
from measurement_io import open_capture, open_recording, open_volume
from measurement_io.native.captures_volumes import read_header
from measurement_io.opening import kind_of


class Source(Protocol):
    """Frames that are read on access, each under a number of its own.

    A number stands for one content: what is written anew gets a new one. What is remembered of a
    frame under its number stays right.
    """

    @property
    def name(self) -> str:
        """Of the path, to be shown."""

    def frames(self) -> tuple[int, ...]:
        """Return the numbers of the frames to go through, ascending; they may change."""

    def label(self, frame: int) -> str:
        """Return what a frame is called."""

    def read(self, frame: int) -> Capture | Volume:
        """Read a frame; errors are those of `measurement_io.open_capture`."""


@dataclass(frozen=True, slots=True)
class FixedFrames:
    """A source whose frames do not change: 0, 1, ... with these labels.

    Attributes
    ----------
    name : str
    labels : tuple of str
        At least one.
    reader : callable
        Reads a frame.
    """

    name: str
    labels: tuple[str, ...]
    reader: Callable[[int], Capture | Volume]

    def frames(self) -> tuple[int, ...]:
        return tuple(range(len(self.labels)))

    def label(self, frame: int) -> str:
        return self.labels[frame]

    def read(self, frame: int) -> Capture | Volume:
        return self.reader(frame)


def open_source(path: Path, variant: str = "raw", *, watch: bool = False) -> Source:
    """Return the frames of a recording, a data set or a folder, or the one of a file.

    Parameters
    ----------
    path : Path
        A radar folder, the folder that holds one, a data set, or a folder of files; or a capture, a
        frame or a volume.
    variant : {"raw", "emptyfiltered"}
        Of a recording's frames.
    watch : bool
        The folder is being written: it may be empty, and the source can be followed.

    Raises
    ------
    MeasurementError
        Missing, unreadable, or of another kind.
    """
    if is_dataset(path):
        return SampleFrames(path, follow=watch)
    if watch:
        return FolderFrames(path, variant, read_file, follow=True)
    name = path.name or path.absolute().name
    if kind_of(path) != "folder":
        content = read_file(path)  # a file that is damaged is refused before there is a page
        return FixedFrames(name, (name,), lambda _: content)
    try:
        recording = open_recording(path, variant=variant)
    except MeasurementError as error:
        files = FolderFrames(path, variant, read_file)
        if not files.frames():
            suffixes = ", ".join(SUFFIXES)
            raise MeasurementError(f"{error}; nor are files ({suffixes}) in it") from error
        return files
    labels = tuple(f"frame {number}" for number in recording.frame_numbers)
    return FixedFrames(name, labels, recording.__getitem__)


def read_file(path: Path) -> Capture | Volume:
    """Read a capture, a recorded frame or a volume; errors as `measurement_io.open_capture`."""
    if kind_of(path) == "native" and read_header(path).format == "volume":
        return open_volume(path)
    return open_capture(path)
