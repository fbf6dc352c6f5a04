"""Sources of frames: a recording, a folder of captures or volumes, or one that stays the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.inputs import ImageInput
from clradar.errors import MeasurementError

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
    variant : str or None
        Of a recording.
    """

    path: Path
    numbers: tuple[int, ...] | None
    read: Callable[[int], Capture | Volume]
    variant: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Frames.open, (self.path, self.variant)  # another process opens it for itself

    @classmethod
    def open(cls, path: Path, variant: str | None = None) -> Frames:
        """A recording, a folder of captures or volumes (.h5), or a single one."""
        from measurement_io import open_recording

        if not path.is_dir():
            content = ImageInput.open(path).content
            return cls(path, None, lambda _: content)
        files = sorted(path.glob("*.h5"))
        if not files or any(path.glob("radar_*")):
            recording = open_recording(path, variant=variant or "raw")
            numbers = recording.frame_numbers
            return cls(path, numbers, lambda number: recording[numbers.index(number)], variant)
        # As `convert --all-frames` names them; other names count from 0.
        by_number = {int(file.stem): file for file in files if file.stem.isdecimal()}
        by_number = by_number or dict(enumerate(files))
        return cls(
            path, tuple(by_number), lambda number: ImageInput.open(by_number[number]).content
        )

    def check_frames(self, numbers: Sequence[int], recording: Path) -> None:
        """Raise unless all these frames of a recording are there, or one is the same at each."""
        missing = [n for n in numbers if self.numbers is not None and n not in self.numbers]
        if missing:
            listed = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
            raise MeasurementError(
                f"{self.path}: expected the frames of '{recording}', got none of number {listed}"
            )
