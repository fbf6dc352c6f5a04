"""Say in words what a file or a folder holds."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.model import Capture, Volume
from measurement_io import native
from measurement_io.failures import clean, fail, read_bytes, reading, shown
from measurement_io.layouts.containers import open_container
from measurement_io.maroon import folders
from measurement_io.maroon.folders import ranges
from measurement_io.maroon.frame import read_frame_file
from measurement_io.opening import SUPPORTED, kind_of
from measurement_io.provenance import MAX_TEXT_BYTES

PRODUCTS = {"depth": "png", "maxproj": "png", "volume": "ply", "xyz": "ply"}
"""Cached products of a radar folder and their extension."""

_META_LINES = 40


@dataclass(frozen=True, slots=True)
class Description:
    """What a file or folder holds.

    Attributes
    ----------
    path : str
    kind : str
        "native capture", "native volume", "recorded frame", "recording", or the container that a
        file of another program is, such as "a MATLAB v5 file".
    facts : tuple of (str, str)
        What, and its value in words.
    problems : tuple of str
        What is missing or contradicts itself; empty for a file that can be opened.
    """

    path: str
    kind: str
    facts: tuple[tuple[str, str], ...]
    problems: tuple[str, ...] = ()

    def __str__(self) -> str:
        width = max((len(name) for name, _ in self.facts), default=0)
        lines = [f"{self.path}: {self.kind}"]
        lines += [f"  {name:<{width}}  {value}" for name, value in self.facts]
        lines += [f"  problem: {problem}" for problem in self.problems]
        return "\n".join(lines)


def describe(path: str | os.PathLike[str]) -> Description:
    """Return what a native file, a recorded frame or a recording holds, in words.

    Raises
    ------
    MeasurementError
        The file cannot be opened. Of a folder, what is missing or contradictory is listed in
        `problems` instead.
    """
    source = Path(path)
    with reading(source, SUPPORTED):
        return _describe(source)


def _describe(source: Path) -> Description:
    kind = kind_of(source)
    if kind == "folder":
        return _describe_folder(source)
    if kind == "container":
        return _describe_container(source)
    if kind == "frame":
        capture = read_frame_file(source)
        return Description(shown(source), "recorded frame", tuple(_capture_facts(capture)))
    header = native.read_header(source)
    facts = [("created", clean(header.created)), ("file version", str(header.version))]
    if header.format == "capture":
        facts += _capture_facts(native.read_capture(source)[1])
    else:
        facts += _volume_facts(native.read_volume(source)[1])
    return Description(shown(source), f"native {header.format}", tuple(facts))


def _describe_container(source: Path) -> Description:
    with open_container(source) as container:
        facts = [(clean(key.name)[:80], key.description) for key in container.keys.values()]
        problem = "it needs a layout, which says which key and which axis is what"
        return Description(shown(source), container.kind, tuple(facts), (problem,))


def folder_problems(radar: Path) -> list[str]:
    """Return what is missing or contradictory in a radar folder, without reading its frames."""
    problems = []
    frames = folders.frames(radar)
    raw, filtered = frames["raw"], frames["emptyfiltered"]
    if not raw:
        problems.append("no frame in calibrated_data")
    elif sorted(raw) != list(range(len(raw))):
        problems.append(f"frames are not numbered from 0 without a gap: {ranges(raw)}")
    orphans = {n: p for n, p in filtered.items() if n not in raw}
    if orphans:
        problems.append(f"emptyfiltered frames without a raw one: {ranges(orphans)}")
    for product in PRODUCTS:
        without = {n: p for n, p in _products(radar, product).items() if n not in raw}
        if without:
            problems.append(f"{product} of frames that are not there: {ranges(without)}")
    return problems + _calibration_problems(radar, raw)


def _calibration_problems(radar: Path, raw: dict[int, Path]) -> list[str]:
    path = radar / "calibration.json"
    if not path.exists():
        return ["no calibration.json"]
    try:
        calibration = read_json(path)
    except ValueError as error:
        return [clean(error)]
    problems = []
    name = folders.RadarFolderName.parse(radar.absolute().name)
    entries = [calibration.get(f"frequency_{key}") for key in ("low_ghz", "high_ghz", "points")]
    low, high, points = (v if isinstance(v, int | float) else None for v in entries)
    if low is None or high is None or points is None:
        problems.append("calibration.json: frequency_low_ghz, _high_ghz or _points is missing")
    elif name is not None and not (
        points == name.points and name.agrees_hz(float(low) * 1e9, float(high) * 1e9)
    ):
        problems.append(
            f"calibration.json says {low} to {high} GHz in {points} points, the folder's name "
            f"{name.low_ghz} to {name.high_ghz} GHz in {name.points}"
        )
    named = {int(k) for k in calibration if re.fullmatch("[0-9]{6}", k)}
    if named - set(raw):
        lost = dict.fromkeys(named - set(raw), path)
        problems.append(f"calibration.json names frames that are not there: {ranges(lost)}")
    return problems


def read_json(path: Path) -> dict[str, Any]:
    """Return a JSON object; raises `MeasurementError` (a ValueError) for anything else."""
    content = read_bytes(path, "a JSON file", MAX_TEXT_BYTES)
    with reading(path, "a JSON object in UTF-8"):
        value = json.loads(content.decode("utf-8-sig"))
        if not isinstance(value, dict):
            fail(path, "a JSON object", type(value).__name__)
    return value


def _describe_folder(folder: Path) -> Description:
    radar = folders.find_radar_folder(folder)
    frames = folders.frames(radar)
    problems = folder_problems(radar)
    facts = [("radar folder", shown(radar.name))]
    for variant, found in frames.items():
        facts.append((f"{variant} frames", f"{len(found)} ({ranges(found) or 'none'})"))
    for product, extension in PRODUCTS.items():
        have = _products(radar, product)
        text = f"{len(have)} .{extension} ({ranges(have)})" if have else "none"
        facts.append((f"cached {product}", text))
    distance = radar.absolute().parent
    for name in ("metadata.json", "alignment.json"):
        facts.append((name, "there" if (distance / name).is_file() else "none"))
    meshes = sorted(p.name for p in (distance / "photogrammetry").glob("*.obj"))
    facts.append(("photogrammetry", ", ".join(clean(m) for m in meshes[:8]) or "none"))
    if frames["raw"]:
        first = frames["raw"][min(frames["raw"])]
        try:
            capture = read_frame_file(first)
        except ValueError as error:
            problems.append(clean(error))
        else:
            facts += _capture_facts(capture)
            total = capture.meta.get("number_of_measurements")
            if total is not None and total != len(frames["raw"]):
                problems.append(
                    f"frame {min(frames['raw'])} says that the recording has {total} frames, "
                    f"{len(frames['raw'])} are there"
                )
    return Description(shown(folder), "recording", tuple(facts), tuple(problems))


def _products(radar: Path, product: str) -> dict[int, Path]:
    folder = radar / product
    if not folder.is_dir():
        return {}
    pattern = re.compile(rf"([0-9]{{6}})\.{PRODUCTS[product]}")
    matches = ((pattern.fullmatch(p.name), p) for p in folders.entries(folder))
    return {int(match[1]): p for match, p in matches if match is not None}


def _capture_facts(capture: Capture) -> list[tuple[str, str]]:
    array, waveform = capture.array, capture.waveform
    low, high = waveform.frequencies_hz[[0, -1]] / 1e9
    amplitude = np.abs(capture.data)
    return [
        ("array", f"{clean(array.name)}: {array.n_tx} Tx, {array.n_rx} Rx"),
        ("aperture", _extent(np.concatenate([array.tx_m, array.rx_m]))),
        ("frequencies", f"{waveform.n_freq} from {low:.6g} to {high:.6g} GHz"),
        ("data", f"{capture.data.shape} complex64 [tx, rx, freq]"),
        *_amplitude_facts(amplitude),
        *_meta_facts(dict(capture.meta)),
    ]


def _volume_facts(volume: Volume) -> list[tuple[str, str]]:
    grid = volume.grid
    facts = []
    for axis, values, step in zip(
        "xyz", (grid.x_m, grid.y_m, grid.z_m), grid.spacing_m, strict=True
    ):
        facts.append(
            (
                f"{axis} axis",
                f"{len(values)} voxels from {values[0] * 1e3:.6g} to {values[-1] * 1e3:.6g} mm, "
                f"every {step * 1e3:.6g} mm",
            )
        )
    amplitude = np.abs(volume.data)
    z, y, x = np.unravel_index(int(amplitude.argmax()), amplitude.shape)
    peak = f"x {grid.x_m[x] * 1e3:.6g}, y {grid.y_m[y] * 1e3:.6g}, z {grid.z_m[z] * 1e3:.6g} mm"
    return [
        *facts,
        ("data", f"{volume.data.shape} complex64 [z, y, x]"),
        *_amplitude_facts(amplitude),
        ("strongest voxel", peak),
        *_meta_facts(dict(volume.meta)),
    ]


def _amplitude_facts(amplitude: np.ndarray) -> list[tuple[str, str]]:
    rms = float(np.sqrt(np.mean(np.square(amplitude, dtype=np.float64))))
    zeros = int(amplitude.size - np.count_nonzero(amplitude))
    return [
        (
            "amplitude",
            f"min {amplitude.min():.4g}, mean {amplitude.mean(dtype=np.float64):.4g}, "
            f"RMS {rms:.4g}, max {amplitude.max():.4g}; {zeros} of {amplitude.size} are zero",
        )
    ]


def _meta_facts(meta: dict[str, Any]) -> list[tuple[str, str]]:
    facts = []
    for key, value in list(meta.items())[:_META_LINES]:
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        facts.append((f"provenance {clean(key)[:40]}", clean(text)))
    if len(meta) > _META_LINES:
        facts.append(("provenance", f"and {len(meta) - _META_LINES} more entries"))
    return facts


def _extent(points_m: np.ndarray) -> str:
    size = np.ptp(points_m, axis=0) * 1e3
    return " x ".join(f"{s:.6g}" for s in size) + " mm (x, y, z)"
