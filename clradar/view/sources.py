"""What is viewed: the frames behind a path, read one at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clradar.model import Capture, Volume
from measurement_io import open_capture, open_recording, open_volume
from measurement_io.native.captures_volumes import read_header
from measurement_io.opening import kind_of


@dataclass(frozen=True, slots=True)
class Source:
    """Frames that are read on access.

    Attributes
    ----------
    name : str
        Of the path, to be shown.
    labels : tuple of str
        What the frames are called; at least one.
    read : callable
        Read the frame of an index; errors are those of `measurement_io.open_capture`.
    """

    name: str
    labels: tuple[str, ...]
    read: Callable[[int], Capture | Volume]


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
        return Source(name, labels, recording.__getitem__)
    reader: Callable[[Path], Capture | Volume] = open_capture
    if kind == "native" and read_header(path).format == "volume":
        reader = open_volume
    content = reader(path)  # a file that is damaged is refused before there is a page
    return Source(name, (name,), lambda _: content)
