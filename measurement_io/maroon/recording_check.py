"""Verify a recording by reading all of its frames and depth maps, one at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.confined.process import Companion
from clradar.files.failures import clean
from clradar.model import Waveform
from clradar.model.progress import Progress
from measurement_io.maroon import folders
from measurement_io.maroon.frame import first_time_stamp, read_frame_file

LONG_GAP = 1.8
"""An interval between time stamps this many times the usual one has lost a frame: one lost frame
makes two intervals of one."""


@dataclass(slots=True)
class _Variant:
    """The frames read of one variant: time stamp and `number_of_measurements` of each."""

    stamps_us: dict[int, int | float] = field(default_factory=dict)
    totals: dict[int, int] = field(default_factory=dict)
    zero: list[int] = field(default_factory=list)
    read: list[int] = field(default_factory=list)

    @property
    def good(self) -> int:
        return len(self.read)

    @property
    def total(self) -> int | None:
        """`number_of_measurements` of the first frame that has it."""
        return self.totals[min(self.totals)] if self.totals else None


def check_frames(
    radar: Path, checked: list[str], problems: list[str], progress: Progress | None = None
) -> None:
    """Read every frame of both variants; list the checks that pass, and the problems."""
    frames = folders.frames(radar)
    waveform: Waveform | None = None
    read: dict[str, _Variant] = {}
    companion = Companion()
    done, total_files = 0, sum(map(len, frames.values()))
    for variant, files in frames.items():
        read[variant] = seen = _Variant()
        for number, path in sorted(files.items()):
            done += 1
            if progress is not None:
                progress(done, total_files)
            try:
                capture = read_frame_file(path, companion=companion)
            except MeasurementError as error:
                problems.append(str(error))
                continue
            seen.read.append(number)
            if waveform is None:
                waveform = capture.waveform
            elif not waveform.same_frequencies(capture.waveform):
                problems.append(f"{clean(path.name)}: other frequencies than the frames before")
            total = capture.meta.get("number_of_measurements")
            if total is not None:
                seen.totals[number] = total
            if not capture.data.any():
                seen.zero.append(number)
            stamp = first_time_stamp(capture)
            if stamp is not None:
                seen.stamps_us[number] = stamp
            del capture  # before the next one is read
        if seen.good:
            checked.append(f"{seen.good} of {len(files)} {variant} frames read, values finite")
            _check_totals(variant, min(files), seen, problems)
            if seen.zero:
                zero = folders.ranges(seen.zero)
                problems.append(f"{variant} frames that are zero everywhere: {zero}")
            _check_stamps(variant, seen, checked, problems)
    raw, filtered = read["raw"], read["emptyfiltered"]
    if raw.total is not None and raw.total != len(frames["raw"]):
        problems.append(
            f"the first frame names {raw.total} frames for the recording, "
            f"{len(frames['raw'])} are there"
        )
    other = [n for n, stamp in filtered.stamps_us.items() if raw.stamps_us.get(n, stamp) != stamp]
    if other:
        problems.append(
            "emptyfiltered frames with another time stamp than the raw one: "
            f"{folders.ranges(other)}"
        )


def check_depth_maps(radar: Path, checked: list[str], problems: list[str]) -> None:
    """Read every depth map; list the checks that pass, and the problems.

    Problems that `inspect_folders` reports are not repeated.
    """
    from measurement_io.maroon.depth_map import read_depth_map, read_frequencies

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
            if str(error) not in problems:
                problems.append(str(error))
        else:
            good += 1
    if good:
        checked.append(f"{good} of {len(files)} cached depth read")


def _check_totals(variant: str, first: int, seen: _Variant, problems: list[str]) -> None:
    if first in seen.read and first not in seen.totals:
        # The dataset's program asks this one how many there are.
        problems.append(f"{variant} frame {first} has no number_of_measurements")
    by_number: dict[int, list[int]] = {}
    for number, total in seen.totals.items():
        by_number.setdefault(total, []).append(number)
    usual = max(by_number, key=lambda total: len(by_number[total]), default=None)
    for total, numbers in by_number.items():
        if total != usual:
            problems.append(
                f"{variant} frames with number_of_measurements {total} where the rest have "
                f"{usual}: {folders.ranges(numbers)}"
            )


def _check_stamps(variant: str, seen: _Variant, checked: list[str], problems: list[str]) -> None:
    numbers = np.array(sorted(seen.stamps_us))
    if not any(seen.stamps_us.values()):  # none, or zeros where there was no clock
        return
    without = seen.good - len(numbers)
    if without:
        problems.append(f"{without} of {seen.good} {variant} frames have no time stamp")
    if len(numbers) < 2:
        return
    stamps = [seen.stamps_us[n] for n in numbers.tolist()]
    steps_us = np.array([float(b - a) for a, b in pairwise(stamps)])
    after = numbers[1:]
    found = len(problems)
    if (steps_us == 0).any():
        same = folders.ranges(after[steps_us == 0].tolist())
        problems.append(f"{variant} frames with the time stamp of the frame before: {same}")
    if (steps_us < 0).any():
        back = folders.ranges(after[steps_us < 0].tolist())
        problems.append(
            f"{variant} frames with a time stamp before that of the frame before: {back}"
        )
    # Where numbers are missing the interval is that much longer.
    per_frame_us = steps_us / np.diff(numbers)
    usual_us = float(np.median(per_frame_us))
    late = per_frame_us > LONG_GAP * usual_us
    if usual_us > 0 and late.any():
        longest = float(steps_us[late].max())
        problems.append(
            f"time stamps of {variant} frames that come late, up to {longest / 1e3:.6g} ms after "
            f"the frame before where {usual_us / 1e3:.6g} ms are usual: "
            f"{folders.ranges(after[late].tolist())}"
        )
    if len(problems) == found:
        checked.append(
            f"time stamps of {variant} frames ascend, {usual_us / 1e3:.6g} ms apart (median)"
        )
