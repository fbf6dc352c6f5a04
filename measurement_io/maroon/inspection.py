"""Describe a recording, or read all of it: content, missing parts, contradictions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean, shown
from clradar.files.json_file import read_json_object
from clradar.files.records import is_number
from clradar.model import Capture
from clradar.model.progress import Progress
from measurement_io.maroon import folders
from measurement_io.maroon.alignment import MESH_SOURCE, SensorAlignment, read_alignment
from measurement_io.maroon.depth_map import read_depth_map, read_frequencies
from measurement_io.maroon.folders import (
    ALIGNMENT_FILE,
    CALIBRATION_FILE,
    DISTANCE_FOLDERS,
    MESH_FOLDER,
    METADATA_FILE,
    PRODUCTS,
    VARIANTS,
    RadarFolderName,
    product_files,
    ranges,
)
from measurement_io.maroon.frame import first_time_stamp, read_frame_file
from measurement_io.maroon.recording import Recording, mesh_files, open_recording
from measurement_io.record_facts import Fact, facts_of, mapping_text

Record = TypeVar("Record")

LONG_GAP = 1.8
"""An interval between time stamps this many times the usual one has lost a frame: one lost frame
makes two intervals of one."""

DISTANCE_TOLERANCE_M = 0.02
"""How far `distance_meters` may be from the folder's name: the name is a round number."""


@dataclass(slots=True)
class Findings:
    """What an inspection finds, and what a check finds right."""

    facts: list[Fact] = field(default_factory=list)
    checked: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    def add(self, name: str, text: str, value: Any) -> None:
        self.facts.append(Fact(name, text, value))

    def read(self, name: str, read: Callable[[], Record]) -> Record | None:
        """Return what `read` does; where it fails, that is a problem and `name` a fact."""
        try:
            return read()
        except MeasurementError as error:
            self.add(name, "cannot be read", None)
            self.problems.append(clean(error))
            return None


def inspect_recording(
    folder: Path, found: Findings, *, whole: bool = False, progress: Progress | None = None
) -> None:
    """Describe a recording by its folders and its first raw frame, or read the `whole` of it."""
    radar = folders.find_radar_folder(folder)
    frames = folders.frames(radar)
    raw, filtered = frames["raw"], frames["emptyfiltered"]
    found.add("radar folder", shown(radar.name), shown(radar.absolute().name))
    _add_files(found, "raw frames", raw, raw)
    _add_files(found, "emptyfiltered frames", filtered, raw, "emptyfiltered")
    if not raw:
        found.problems.append("no frame in calibrated_data")
    elif sorted(raw) != list(range(len(raw))):
        found.problems.append(f"frames are not numbered from 0 without a gap: {ranges(raw)}")
    others = folders.ignored_files(radar)
    if others:
        text = clean(", ".join(others[:12])) + (", ..." if len(others) > 12 else "")
        found.add(f"ignored in {folders.FRAMES_FOLDER}", text, others)
    products: dict[str, dict[int, Path]] = {}
    for name in PRODUCTS:
        there = found.read(f"cached {name}", partial(product_files, radar, name))
        if there is not None:
            products[name] = there
            _add_files(found, f"cached {name}", there, raw, name)
    placed = _inspect_calibration(found, radar, raw, products)
    _inspect_placement(found, radar.absolute().parent)
    if whole:
        if not found.problems:
            found.checked.append("numbering, and what lies beside the frames: all of it agrees")
        if raw or filtered:
            recording = open_recording(radar, variant="raw" if raw else "emptyfiltered")
            _check_frames(recording, found, progress)
        _check_depth_maps(radar, products.get("depth", {}), placed, found)
    elif raw:
        capture = found.read(f"frame {min(raw)}", lambda: read_frame_file(raw[min(raw)]))
        if capture is not None:
            found.facts += facts_of(capture)
            _check_total(found, capture, len(raw))


def _check_total(found: Findings, capture: Capture, count: int) -> None:
    number, total = capture.meta["frame"], capture.meta.get("number_of_measurements")
    if total is not None and total != count:
        found.problems.append(
            f"frame {number} names {total} frames for the recording, {count} are there"
        )


def _add_files(
    found: Findings, name: str, files: dict[int, Path], raw: dict[int, Path], short: str = ""
) -> None:
    """Add files by the numbers of their frames, beside the raw ones; `short` names what lacks."""
    text = f"{len(files)} ({ranges(files)})" if files else "none"
    found.add(name, text, {"count": len(files), "numbers": sorted(files)})
    if orphans := set(files) - set(raw):
        found.problems.append(f"{name} without a raw frame: {ranges(orphans)}")
    if short and not files:
        found.missing.append(short)
    elif without := set(raw) - set(files):
        found.missing.append(f"{short} of the frames {ranges(without)}")


def _inspect_calibration(
    found: Findings, radar: Path, raw: dict[int, Path], products: dict[str, dict[int, Path]]
) -> set[int]:
    """Return the frames that `calibration.json` has entries of."""
    path = radar / CALIBRATION_FILE
    if not path.exists():
        found.add(CALIBRATION_FILE, "none", None)
        without = ", without which depth cannot be read" if products.get("depth") else ""
        found.problems.append(f"no {CALIBRATION_FILE}{without}")
        return set()
    content = found.read(CALIBRATION_FILE, lambda: read_frequencies(path))
    if content is None:
        return set()
    calibration, numbers = content
    low, high = calibration.frequency_low_ghz, calibration.frequency_high_ghz
    points, entries = calibration.frequency_points, sorted(numbers)
    text = f"{low} to {high} GHz in {points} points; entries of {len(entries)} frames"
    value = {"low_ghz": low, "high_ghz": high, "points": points, "frames": entries}
    found.add(CALIBRATION_FILE, text, value)
    name = RadarFolderName.parse(radar.absolute().name)
    if low is None or high is None or points is None:
        found.problems.append(
            f"{CALIBRATION_FILE}: frequency_low_ghz, _high_ghz or _points is missing"
        )
    elif name and not (points == name.points and name.agrees_hz(low * 1e9, high * 1e9)):
        found.problems.append(
            f"{CALIBRATION_FILE} has {low} to {high} GHz in {points} points, the folder's name "
            f"{name.low_ghz} to {name.high_ghz} GHz in {name.points}"
        )
    if strangers := numbers - set(raw):
        found.problems.append(
            f"{CALIBRATION_FILE} names frames that are not there: {ranges(strangers)}"
        )
    if unplaced := set(products.get("depth", ())) - numbers:
        found.problems.append(
            f"{CALIBRATION_FILE} lacks its pixels for depth of the frames {ranges(unplaced)}"
        )
    return numbers


def _inspect_placement(found: Findings, distance: Path) -> None:
    """Add what lies in an `<object>/<distance>` folder."""
    metadata = _beside(found, distance / METADATA_FILE, read_json_object, "")
    if metadata is not None:
        found.add(METADATA_FILE, mapping_text(metadata) or "nothing in it", metadata)
        given = metadata.get("distance_meters")
        if given is not None and distance.name in DISTANCE_FOLDERS:
            named_m = int(distance.name) / 100
            if not is_number(given) or abs(given - named_m) > DISTANCE_TOLERANCE_M:
                found.problems.append(
                    f"{METADATA_FILE} has a distance of {clean(given)[:40]} m, the folder's name "
                    f"{distance.name} cm"
                )
    lost = ", without which no mesh can be placed"
    alignment = _beside(found, distance / ALIGNMENT_FILE, read_alignment, lost)
    if alignment is not None:
        _add_transforms(found, alignment)
    meshes = found.read("meshes", lambda: mesh_files(distance))
    if meshes is None:
        return
    found.add("meshes", ", ".join(map(clean, sorted(meshes))) or "none", sorted(meshes))
    if not meshes:
        found.missing.append(f"{MESH_FOLDER}/*.obj")
    elif alignment is not None:
        try:
            alignment.to_antenna(MESH_SOURCE)
        except MeasurementError as error:
            found.problems.append(clean(error))


def _beside(
    found: Findings, path: Path, read: Callable[[Path], Record], lost: str
) -> Record | None:
    if path.exists():
        return found.read(path.name, lambda: read(path))
    found.add(path.name, "none", None)
    found.missing.append(f"{path.name}{lost}")
    return None


def _add_transforms(found: Findings, alignment: SensorAlignment) -> None:
    lines, values = [], {}
    for (source, target), matrix in sorted(alignment.given.items()):
        name = clean(f"{source}2{target}")
        scale = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        mirrors = ", mirrors" if np.linalg.det(matrix[:3, :3]) < 0 else ""
        lines.append(f"{name}: scale {' x '.join(f'{s:.6g}' for s in scale)}{mirrors}")
        values[name] = matrix.tolist()
    found.add(ALIGNMENT_FILE, "\n".join(lines) or "no transform in it", {"transforms": values})


def _check_frames(recording: Recording, found: Findings, progress: Progress | None) -> None:
    """Read every frame of both variants; list the checks that pass, and the problems."""
    views = [recording.with_variant(variant) for variant in recording.variants]
    done, stamps_us = 0, dict[str, dict[int, int | float]]()
    for view in views:
        variant, stamps = view.variant, stamps_us.setdefault(view.variant, {})
        read, zero = 0, []
        for i, number in enumerate(view.frame_numbers):
            done += 1
            if progress is not None:
                progress(done, sum(map(len, views)))
            try:
                capture = view[i]
            except MeasurementError as error:
                found.problems.append(str(error))
                continue
            read += 1
            if read == 1 and variant == "raw":
                _check_total(found, capture, len(view))
            if not capture.data.any():
                zero.append(number)
            if (stamp := first_time_stamp(capture.meta)) is not None:
                stamps[number] = stamp
            del capture  # before the next one is read
        if not read:
            continue
        found.checked.append(f"{read} of {len(view)} {variant} frames read, values finite")
        if zero:
            found.problems.append(f"{variant} frames that are zero everywhere: {ranges(zero)}")
        _check_stamps(variant, stamps, read, found)
    raw, filtered = (stamps_us.get(variant, {}) for variant in VARIANTS)
    if other := [n for n, stamp in filtered.items() if raw.get(n, stamp) != stamp]:
        found.problems.append(
            f"emptyfiltered frames with another time stamp than the raw one: {ranges(other)}"
        )


def _check_depth_maps(
    radar: Path, files: dict[int, Path], placed: set[int], found: Findings
) -> None:
    """Read every depth map; list the checks that pass, and the problems that are new."""
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
