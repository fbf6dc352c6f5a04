"""Verify a file or a recording by reading all of it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import reading, shown
from clradar.model.progress import Progress
from measurement_io.layouts.lab_file import layout_needed
from measurement_io.maroon import folders
from measurement_io.maroon.depth_map import read_depth_map, read_frequencies
from measurement_io.maroon.folders import VARIANTS, ranges
from measurement_io.maroon.frame import first_time_stamp, read_frame_file
from measurement_io.maroon.inspection import Findings, inspect_folders
from measurement_io.maroon.recording import open_recording
from measurement_io.native import records as native
from measurement_io.native.scheme import SCHEMES
from measurement_io.opening import SUPPORTED, kind_of

LONG_GAP = 1.8
"""An interval between time stamps this many times the usual one has lost a frame: one lost frame
makes two intervals of one."""


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Outcome of a verification; `ok` without problems.

    Attributes
    ----------
    path : str
    checked : tuple of str
        What was found right.
    problems : tuple of str
        What is wrong.
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

    Of a native file: format, types, shapes, checksums, finite values, axes against the grid. Of a
    recording: frames of both variants, frequencies, numbering, time stamps, images and JSON files.
    What cannot be opened is a problem in the report and raises nothing.

    Examples
    --------
    >>> measurement_io.save_capture("capture.h5", capture)
    >>> measurement_io.check_file("capture.h5").ok
    True
    >>> with open("capture.h5", "r+b") as file:
    ...     _ = file.truncate(5000)
    >>> report = measurement_io.check_file("capture.h5")
    >>> report.ok, len(report.problems)
    (False, 1)
    """
    source = Path(path)
    found = Findings()
    try:
        with reading(source, SUPPORTED):
            kind = kind_of(source)
            if kind == "container":
                raise layout_needed(source)
            if kind == "folder":
                _check_folder(folders.find_radar_folder(source), found, progress)
            elif kind == "frame":
                read_frame_file(source)
                found.checked.append("the pickle holds nothing but numbers and text")
                found.checked.append("keys, shapes, frequencies, the folder's name agree; finite")
            else:
                _check_native(source, found)
    except MeasurementError as error:
        found.problems.append(str(error))
    return CheckReport(shown(source), tuple(found.checked), tuple(found.problems))


def _check_native(path: Path, found: Findings) -> None:
    header, _ = native.read_native(path)
    noun = SCHEMES[header.format].noun
    found.checked.append(f"native: {noun}, version {header.version}, text attributes intact")
    found.checked.append("all data read: types, shapes, stored in full, values finite")
    found.problems += [
        f"/entry/data/{name}: carries no Fletcher-32 checksum" for name in header.unchecked
    ]
    if not header.unchecked:
        found.checked.append("every dataset has its Fletcher-32 checksums and they are right")


def _check_folder(radar: Path, found: Findings, progress: Progress | None) -> None:
    found.problems += inspect_folders(radar).problems
    if not found.problems:
        found.checked.append("numbering, and what lies beside the frames: all of it agrees")
    _check_frames(radar, found, progress)
    _check_depth_maps(radar, found)


def _check_frames(radar: Path, found: Findings, progress: Progress | None) -> None:
    """Read every frame of both variants; list the checks that pass, and the problems."""
    there = {variant: files for variant, files in folders.frames(radar).items() if files}
    if not there:
        return
    done, total = 0, sum(map(len, there.values()))
    recording = open_recording(radar, variant=next(iter(there)))
    stamps_us: dict[str, dict[int, int | float]] = {}
    for variant, files in there.items():
        frames, stamps = recording.with_variant(variant), stamps_us.setdefault(variant, {})
        read, zero, named = 0, [], None
        for i, number in enumerate(frames.frame_numbers):
            done += 1
            if progress is not None:
                progress(done, total)
            try:
                capture = frames[i]
            except MeasurementError as error:
                found.problems.append(str(error))
                continue
            read += 1
            named = capture.meta.get("number_of_measurements") if read == 1 else named
            if not capture.data.any():
                zero.append(number)
            if (stamp := first_time_stamp(capture.meta)) is not None:
                stamps[number] = stamp
            del capture  # before the next one is read
        if not read:
            continue
        found.checked.append(f"{read} of {len(files)} {variant} frames read, values finite")
        if variant == "raw" and named is not None and named != len(files):
            found.problems.append(
                f"the frames name {named} of the recording, {len(files)} are there"
            )
        if zero:
            found.problems.append(f"{variant} frames that are zero everywhere: {ranges(zero)}")
        _check_stamps(variant, stamps, read, found)
    raw, filtered = (stamps_us.get(variant, {}) for variant in VARIANTS)
    if other := [n for n, stamp in filtered.items() if raw.get(n, stamp) != stamp]:
        found.problems.append(
            f"emptyfiltered frames with another time stamp than the raw one: {ranges(other)}"
        )


def _check_depth_maps(radar: Path, found: Findings) -> None:
    """Read every depth map; list the checks that pass, and the problems that are new."""
    calibration = radar / folders.CALIBRATION_FILE
    try:
        files = folders.product_files(radar, "depth")
        placed = read_frequencies(calibration)[1] if calibration.exists() else set()
    except MeasurementError:  # a problem of the folder, or of calibration.json
        return
    good = 0
    for number in sorted(set(files) & placed):  # others are a problem of calibration.json
        try:
            read_depth_map(radar, number)
        except MeasurementError as error:
            if str(error) not in found.problems:
                found.problems.append(str(error))
        else:
            good += 1
    if good:
        found.checked.append(f"{good} of {len(files)} cached depth read")


def _check_stamps(variant: str, stamps: dict[int, int | float], read: int, found: Findings) -> None:
    if not any(stamps.values()):  # none, or zeros where there was no clock
        return
    if len(stamps) < read:
        found.problems.append(f"{read - len(stamps)} of {read} {variant} frames have no time stamp")
    if len(stamps) < 2:
        return
    numbers = np.array(sorted(stamps))
    steps_us = np.array([float(stamps[b] - stamps[a]) for a, b in pairwise(numbers.tolist())])
    # Where numbers are missing the interval is that much longer.
    per_frame_us = steps_us / np.diff(numbers)
    usual_us = float(np.median(per_frame_us))
    before = numbers[1:][steps_us <= 0].tolist()
    late = numbers[1:][per_frame_us > LONG_GAP * usual_us].tolist() if usual_us > 0 else []
    if before:
        found.problems.append(
            f"{variant} frames whose time stamp is not after that of the frame before: "
            f"{ranges(before)}"
        )
    if late:
        found.problems.append(
            f"{variant} frames that come late, where {usual_us / 1e3:.6g} ms are usual: "
            f"{ranges(late)}"
        )
    if not before and not late:
        found.checked.append(
            f"time stamps of {variant} frames ascend, {usual_us / 1e3:.6g} ms apart (median)"
        )
