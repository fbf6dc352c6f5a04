"""Captures from files and from recordings, one frame of them or the mean of all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.images import recording_files
from clradar.cli.output import print_warning, progress_bar

if TYPE_CHECKING:
    from clradar import Capture


def load_frame(
    path: Path, *, frame: int | None = None, variant: str | None = None
) -> tuple[Capture, list[Path]]:
    """Return one capture of a file or a recording, and the file that it comes from."""
    from measurement_io import open_capture

    capture = open_capture(path, frame=frame, variant=variant)
    return capture, recording_files(path, capture.meta)


def load_mean(
    path: Path, *, variant: str | None = None, align_phase: bool = False
) -> tuple[Capture, list[Path]]:
    """Return the coherent mean of all frames of a recording, and their files.

    Frames that are not there are left out; a warning says how many the recording was to have.
    """
    from calibration import average_frames

    with progress_bar("averaging") as progress:
        files = _frame_files(path, variant or "raw")

        def frames() -> Iterator[Capture]:
            for done, number in enumerate(files, start=1):
                yield load_frame(path, frame=number, variant=variant)[0]
                if progress is not None:
                    progress(done, len(files))

        mean = average_frames(frames(), align_phase=align_phase)
    expected = mean.meta.get("number_of_measurements")
    if isinstance(expected, int) and expected != len(files):
        print_warning(f"{path}: {len(files)} of {expected} frames are there; averaged those")
    return mean, list(files.values())


def _frame_files(path: Path, variant: str) -> dict[int, Path]:
    """Return the files of a recording's frames by their number; an error if there are none."""
    from measurement_io.failures import fail
    from measurement_io.maroon.folders import find_radar_folder, frames

    files = frames(find_radar_folder(path))[variant]
    if not files:
        fail(path, f"frames of variant {variant}", "none")
    return dict(sorted(files.items()))
