"""What is viewed: the frames behind a path, read one at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from clradar.model import Capture, Volume
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


def open_source(path: Path, variant: str = "raw") -> Source:
    """Return the frames of a recording, or the one of a capture, a frame or a volume.

    Parameters
    ----------
    path : Path
        A radar folder, or the folder that holds one; or a file.
    variant : {"raw", "emptyfiltered"}
        Of a recording's frames.

    Raises
    ------
    MeasurementError
        Missing, unreadable, or of another kind.
    """
    name = path.name or path.absolute().name
    kind = kind_of(path)
    if kind == "folder":
        recording = open_recording(path, variant=variant)
        labels = tuple(f"frame {number}" for number in recording.frame_numbers)
        return FixedFrames(name, labels, recording.__getitem__)
    reader: Callable[[Path], Capture | Volume] = open_capture
    if kind == "native" and read_header(path).format == "volume":
        reader = open_volume
    content = reader(path)  # a file that is damaged is refused before there is a page
    return FixedFrames(name, (name,), lambda _: content)
