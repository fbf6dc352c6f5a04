"""Sources of frames: a recording, a folder of captures or volumes, or one that stays the same."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.inputs import ImageInput
from clradar.errors import warn
from clradar.files.failures import fail

if TYPE_CHECKING:
    from clradar import Capture, Volume


@dataclass(frozen=True, slots=True)
class Frames:
    """What is compared at each frame.

    Attributes
    ----------
    path : Path
    numbers : tuple of int or None
        Frames that are there; None: a single capture or volume, the same at every frame.
    read : callable
        Read the frame of a number.
    files : callable
        The files that it is read from.
    variant : str or None
    """

    path: Path
    numbers: tuple[int, ...] | None
    read: Callable[[int], Capture | Volume]
    files: Callable[[int], list[Path]]
    variant: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Frames.open, (self.path, self.variant)  # another process opens it for itself

    @classmethod
    def open(cls, path: Path, variant: str | None = None) -> Frames:
        """A recording, a folder of captures or volumes (.h5), or a single one."""
        if not path.is_dir():
            content = ImageInput.open(path).content
            return cls(path, None, lambda _: content, lambda _: [path])
        if not any(path.glob("*.h5")) or any(path.glob("radar_*")):
            return cls._of_recording(path, variant)
        by_number = _captures_by_number(path, variant)

        def read(number: int) -> Capture | Volume:
            return ImageInput.open(by_number[number]).content

        return cls(path, tuple(by_number), read, lambda number: [by_number[number]], variant)

    @classmethod
    def _of_recording(cls, path: Path, variant: str | None) -> Frames:
        from measurement_io import open_recording
        from measurement_io.maroon.folders import ANTENNAS_FILE, frames

        recording = open_recording(path, variant=variant or "raw")
        numbers, paths = recording.frame_numbers, frames(recording.path)[recording.variant]
        antennas = recording.path / ANTENNAS_FILE
        beside = [antennas] if antennas.is_file() else []
        return cls(
            path, numbers, lambda number: recording[numbers.index(number)],
            lambda number: [paths[number], *beside], variant,
        )  # fmt: skip

    def check_frames(self, numbers: Sequence[int], recording: Path) -> None:
        """Raise unless all these frames of a recording are there, or one is the same at each."""
        missing = [n for n in numbers if self.numbers is not None and n not in self.numbers]
        if missing:
            got = f"none of number {listed(missing)}"
            fail(self.path, f"the frames of '{recording}'", got)


_FRAME = re.compile(r"([0-9]+)(?:_(emptyfiltered))?\Z")


def _captures_by_number(folder: Path, variant: str | None) -> dict[int, Path]:
    """Files of captures as `convert --all-frames` names them; other names count from 0.

    Without a variant raw ones, if there are any.
    """
    files = sorted(folder.glob("*.h5"))
    found: dict[str, dict[int, Path]] = {"raw": {}, "emptyfiltered": {}}
    others = []
    for path in files:
        match = _FRAME.match(path.stem)
        if match is None:
            others.append(path.name)
        else:
            found[match[2] or "raw"][int(match[1])] = path
    if len(others) == len(files) and variant != "emptyfiltered":
        return dict(enumerate(files))
    chosen = found[variant or ("raw" if found["raw"] else "emptyfiltered")]
    if not chosen:
        there = listed(path.name for path in files)
        fail(folder, f"frames of the variant {variant} by their names", there)
    if others:
        warn(f"{folder}: left out, as they are not named like frames: {listed(others)}")
    return dict(sorted(chosen.items()))


def listed(items: Iterable[object]) -> str:
    """The first five of some, and that there are more."""
    texts = [str(item) for item in items]
    return ", ".join(texts[:5]) + (", ..." if len(texts) > 5 else "")


def files_of(numbers: Sequence[int], source: Frames, others: Sequence[Frames]) -> list[Path]:
    """The files that a group of frames is made from, which has the number of its first frame."""
    beside = [one.files(numbers[0]) for one in others if one.numbers is not None]
    return [path for files in (*map(source.files, numbers), *beside) for path in files]


def all_files(path: Path) -> list[Path]:
    """The files of all frames of a folder, or the one file that a path is."""
    if not path.is_dir():
        return [path]
    source = Frames.open(path)
    return [file for number in source.numbers or () for file in source.files(number)]
