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
    from clradar.files.failures import fail
    from measurement_io import open_recording

    chosen = variant or "raw"
    recording = open_recording(path, variant=chosen)
    if not len(recording):
        fail(path, f"frames of variant {chosen}", "none")
    files: list[Path] = []

    with progress_bar("averaging") as progress:

        def frames() -> Iterator[Capture]:
            for capture in recording:
                files.extend(recording_files(path, capture.meta))
                yield capture
                if progress is not None:
                    progress(len(files), len(recording))

        mean = average_frames(frames(), align_phase=align_phase)
    expected = mean.meta.get("number_of_measurements")
    if isinstance(expected, int) and expected != len(recording):
        print_warning(f"{path}: {len(recording)} of {expected} frames are there; averaged those")
    return mean, files
