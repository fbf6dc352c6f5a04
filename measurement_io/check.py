"""Verify a file or a recording by reading all of it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from clradar.errors import MeasurementError
from clradar.files.failures import reading, shown
from clradar.model.progress import Progress
from measurement_io.layouts.lab_file import layout_needed
from measurement_io.maroon.folders import find_radar_folder
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import inspect_folders
from measurement_io.maroon.recording_check import check_depth_maps, check_frames
from measurement_io.native import records as native
from measurement_io.native.scheme import SCHEMES
from measurement_io.opening import SUPPORTED, kind_of


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Outcome of a verification.

    Attributes
    ----------
    path : str
    checked : tuple of str
        What was verified and found right.
    problems : tuple of str
        What is wrong; empty if all is well.
    """

    path: str
    checked: tuple[str, ...]
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return not self.problems

    def __str__(self) -> str:
        lines = [f"{self.path}: {'all right' if self.ok else 'not all right'}"]
        lines += [f"  ok: {line}" for line in self.checked]
        lines += [f"  problem: {line}" for line in self.problems]
        return "\n".join(lines)


def check_file(path: str | os.PathLike[str], *, progress: Progress | None = None) -> CheckReport:
    """Verify a native file, a recorded frame or a recording; all of its data is read.

    Of a native file: format and version, types and shapes, checksums of every dataset, finite
    values, axes against the grid. Of a recording: every frame of both variants, all with the same
    frequencies, numbering, time stamps, cached products, `calibration.json`, `alignment.json`,
    `metadata.json`.

    Parameters
    ----------
    path : path-like
    progress : callable, optional
        Called with (frames done, frames) of a recording.

    Returns
    -------
    CheckReport
        A file that cannot be opened is a problem in the report and raises nothing.

    Examples
    --------
    >>> from measurement_io import check_file, save_capture
    >>> save_capture("capture.h5", capture)
    >>> check_file("capture.h5").ok
    True
    >>> with open("capture.h5", "r+b") as file:
    ...     _ = file.truncate(5000)
    >>> report = check_file("capture.h5")
    >>> report.ok, len(report.problems)
    (False, 1)
    """
    source = Path(path)
    checked: list[str] = []
    problems: list[str] = []
    try:
        with reading(source, SUPPORTED):
            kind = kind_of(source)
            if kind == "container":
                raise layout_needed(source)
            if kind == "folder":
                _check_folder(find_radar_folder(source), checked, problems, progress)
            elif kind == "frame":
                read_frame_file(source)
                checked.append("the pickle holds nothing but numbers and text")
                checked.append("keys, shapes, frequencies and the folder's name agree; finite")
            else:
                _check_native(source, checked, problems)
    except MeasurementError as error:
        problems.append(str(error))
    return CheckReport(shown(source), tuple(checked), tuple(problems))


def _check_native(path: Path, checked: list[str], problems: list[str]) -> None:
    header, _ = native.read_native(path)
    noun = SCHEMES[header.format].noun
    checked.append(f"native: {noun}, version {header.version}, text attributes intact")
    checked.append("all data read: types, shapes, stored in full, values finite")
    unchecked = native.unchecked_datasets(path)
    problems += [f"{name}: carries no Fletcher-32 checksum" for name in unchecked]
    if not unchecked:
        checked.append("every dataset has its Fletcher-32 checksums and they are right")


def _check_folder(
    radar: Path, checked: list[str], problems: list[str], progress: Progress | None
) -> None:
    beside = inspect_folders(radar).problems
    problems += beside
    if not beside:
        checked.append("numbering, and what lies beside the frames: all of it agrees")
    check_frames(radar, checked, problems, progress)
    check_depth_maps(radar, checked, problems)
