"""Inspect the folders of a recording: content, missing parts, contradictions."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from clradar.errors import MeasurementError
from clradar.files.failures import clean, shown
from measurement_io.maroon import folders
from measurement_io.maroon.folders import (
    CALIBRATION_FILE,
    PRODUCTS,
    RadarFolderName,
    product_files,
    ranges,
)
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.placement import inspect_placement
from measurement_io.record_facts import Fact, capture_facts


@dataclass(slots=True)
class Findings:
    """The findings of an inspection."""

    facts: list[Fact] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def inspect_recording(folder: Path) -> Findings:
    """Describe a recording by its folders and its first raw frame; no other frame is opened."""
    radar = folders.find_radar_folder(folder)
    found = inspect_folders(radar)
    frames = folders.frames(radar)
    for variant, files in frames.items():
        _note_irregular(found, variant, files)
    raw = frames["raw"]
    first = next((number for number in sorted(raw) if os.path.isfile(raw[number])), None)
    if first is None:
        return found
    try:
        capture = read_frame_file(raw[first])
    except MeasurementError as error:
        found.problems.append(clean(error))
        return found
    found.facts += capture_facts(capture)
    total = capture.meta.get("number_of_measurements")
    if total is not None and total != len(raw):
        found.problems.append(
            f"frame {first} names {total} frames for the recording, {len(raw)} are there"
        )
    return found


def inspect_folders(radar: Path) -> Findings:
    """Inspect a radar folder and the files beside it; no frame is read."""
    found = Findings()
    frames = folders.frames(radar)
    raw, filtered = frames["raw"], frames["emptyfiltered"]
    found.facts.append(Fact("radar folder", shown(radar.name), shown(radar.absolute().name)))
    for variant, files in frames.items():
        found.facts.append(_files_fact(f"{variant} frames", files))
    if not raw:
        found.problems.append("no frame in calibrated_data")
    elif sorted(raw) != list(range(len(raw))):
        found.problems.append(f"frames are not numbered from 0 without a gap: {ranges(raw)}")
    orphans = sorted(set(filtered) - set(raw))
    if orphans:
        found.problems.append(f"emptyfiltered frames without a raw one: {ranges(orphans)}")
    _note_missing(found, "emptyfiltered", filtered, raw)
    others = folders.ignored_files(radar)
    if others:
        words = clean(", ".join(others[:12])) + (", ..." if len(others) > 12 else "")
        found.facts.append(Fact(f"ignored in {folders.FRAMES_FOLDER}", words, others))
    products = {}
    for name in PRODUCTS:
        try:
            products[name] = files = product_files(radar, name)
        except MeasurementError as error:  # the folder itself, such as one without permission
            found.facts.append(Fact(f"cached {name}", "cannot be read", None))
            found.problems.append(clean(error))
            continue
        found.facts.append(_files_fact(f"cached {name}", files, f" .{PRODUCTS[name]}"))
        without = sorted(set(files) - set(raw))
        if without:
            found.problems.append(f"{name} of frames that are not there: {ranges(without)}")
        _note_missing(found, name, files, raw)
    _inspect_calibration(found, radar, raw, products)
    inspect_placement(radar.absolute().parent, found.facts, found.problems, found.missing)
    return found


def _files_fact(name: str, files: dict[int, Path], kind: str = "") -> Fact:
    words = f"{len(files)}{kind} ({ranges(files)})" if files else "none"
    return Fact(name, words, {"count": len(files), "numbers": sorted(files)})


def _note_irregular(found: Findings, variant: str, files: dict[int, Path]) -> None:
    """Note frames that no reader would open; a check reads them and finds each by itself."""
    irregular = [number for number, path in files.items() if not os.path.isfile(path)]
    dangling = [n for n in irregular if os.path.islink(files[n]) and not os.path.exists(files[n])]
    if dangling:
        found.problems.append(f"{variant} frames that are links to nothing: {ranges(dangling)}")
    others = set(irregular) - set(dangling)
    if others:
        found.problems.append(f"{variant} frames that are no regular file: {ranges(others)}")


def _note_missing(found: Findings, name: str, files: dict[int, Path], raw: dict[int, Path]) -> None:
    without = sorted(set(raw) - set(files))
    if not files:
        found.missing.append(name)
    elif without:
        found.missing.append(f"{name} of the frames {ranges(without)}")


def _inspect_calibration(
    found: Findings, radar: Path, raw: dict[int, Path], products: dict[str, dict[int, Path]]
) -> None:
    path = radar / CALIBRATION_FILE
    if not path.exists():
        found.facts.append(Fact(CALIBRATION_FILE, "none", None))
        without = ", without which depth cannot be read" if products.get("depth") else ""
        found.problems.append(f"no {CALIBRATION_FILE}{without}")
        return
    from measurement_io.maroon.depth_map import read_frequencies

    try:
        calibration, numbered = read_frequencies(path)
    except MeasurementError as error:
        found.facts.append(Fact(CALIBRATION_FILE, "cannot be read", None))
        found.problems.append(clean(error))
        return
    low, high = calibration.frequency_low_ghz, calibration.frequency_high_ghz
    points, entries = calibration.frequency_points, sorted(numbered)
    words = f"{low} to {high} GHz in {points} points; " + (
        f"entries of {len(entries)} frames ({ranges(entries)})"
        if entries
        else "no entry of a frame"
    )
    value = {"low_ghz": low, "high_ghz": high, "points": points, "frames": entries}
    found.facts.append(Fact(CALIBRATION_FILE, words, value))
    _compare_with_name(found, radar, low, high, points)
    strangers = sorted(set(entries) - set(raw))
    if strangers:
        found.problems.append(
            f"{CALIBRATION_FILE} names frames that are not there: {ranges(strangers)}"
        )
    unplaced = sorted(set(products.get("depth", ())) - set(entries))
    if unplaced:
        found.problems.append(
            f"{CALIBRATION_FILE} lacks its pixels for depth of the frames {ranges(unplaced)}"
        )


def _compare_with_name(
    found: Findings, radar: Path, low: float | None, high: float | None, points: int | None
) -> None:
    if low is None or high is None or points is None:
        found.problems.append(
            f"{CALIBRATION_FILE}: frequency_low_ghz, _high_ghz or _points is missing"
        )
        return
    name = RadarFolderName.parse(radar.absolute().name)
    if name is None or (points == name.points and name.agrees_hz(low * 1e9, high * 1e9)):
        return
    found.problems.append(
        f"{CALIBRATION_FILE} has {low} to {high} GHz in {points} points, the folder's name "
        f"{name.low_ghz} to {name.high_ghz} GHz in {name.points}"
    )
