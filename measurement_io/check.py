"""Verify a file or a recording by reading all of it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from clradar.errors import MeasurementError
from measurement_io import native
from measurement_io.describe import folder_problems
from measurement_io.failures import clean, reading, shown
from measurement_io.layouts.skeleton import layout_needed
from measurement_io.maroon import folders
from measurement_io.maroon.frame import read_frame_file
from measurement_io.opening import SUPPORTED, kind_of


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What was verified, and what is wrong.

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


def check_file(path: str | os.PathLike[str]) -> CheckReport:
    """Verify a native file, a recorded frame or a recording; all of its data is read.

    Of a native file: format and version, types and shapes, checksums of every dataset, finite
    values, axes against the grid, NeXus attributes. Of a recording: every frame of both variants,
    all with the same frequencies, numbering, `calibration.json`.

    Returns
    -------
    CheckReport
        A file that cannot be opened is a problem in the report and raises nothing.
    """
    source = Path(path)
    checked: list[str] = []
    problems: list[str] = []
    try:
        with reading(source, SUPPORTED):
            _check(source, checked, problems)
    except MeasurementError as error:
        problems.append(str(error))
    return CheckReport(shown(source), tuple(checked), tuple(problems))


def _check(source: Path, checked: list[str], problems: list[str]) -> None:
    kind = kind_of(source)
    if kind == "container":
        raise layout_needed(source)
    if kind == "folder":
        _check_folder(source, checked, problems)
    elif kind == "frame":
        read_frame_file(source)
        checked.append("the pickle holds nothing but numbers and text")
        checked.append("keys, shapes, frequencies and the folder's name agree; values finite")
    else:
        _check_native(source, checked, problems)


def _check_native(path: Path, checked: list[str], problems: list[str]) -> None:
    header = native.read_header(path)
    checked.append(f"a native {header.format}, version {header.version}, text attributes intact")
    if header.format == "capture":
        native.read_capture(path)
    else:
        native.read_volume(path)
    checked.append("all data read: types, shapes, stored in full, values finite")
    found = native.nexus_problems(path)
    problems += found
    if not found:
        checked.append("every dataset has its Fletcher-32 checksums and they are right")
        checked.append("NeXus attributes are there")


def _check_folder(folder: Path, checked: list[str], problems: list[str]) -> None:
    radar = folders.find_radar_folder(folder)
    problems += folder_problems(radar)
    reference = None
    total: object = None
    all_frames = folders.frames(radar)
    for variant, found in all_frames.items():
        good = 0
        for number, path in sorted(found.items()):
            try:
                capture = read_frame_file(path)
            except MeasurementError as error:
                problems.append(str(error))
                continue
            good += 1
            if reference is None:
                reference = capture.waveform
                total = capture.meta.get("number_of_measurements")
            elif not reference.same_frequencies(capture.waveform):
                problems.append(f"{clean(path.name)}: other frequencies than the frames before")
            if number == 0 and variant == "raw":
                total = capture.meta.get("number_of_measurements")
        if good:
            checked.append(f"{good} of {len(found)} {variant} frames read, values finite")
    if total is not None and total != len(all_frames["raw"]):
        problems.append(
            f"frame 0 says that the recording has {total} frames, {len(all_frames['raw'])} are "
            "there"
        )
