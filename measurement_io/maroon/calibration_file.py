"""`calibration.json` of a radar folder: its frequencies, and the grid of each frame's products.

All positions in it are in the dataset's radar space, x_radar = -x_antenna.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.atomic import write_file
from clradar.files.failures import shown
from clradar.files.json_file import read_json_object
from clradar.files.table import StrictTable

CALIBRATION_FILE = "calibration.json"
MAX_POSITION_M = 1e3
"""Farthest end of a grid; anything beyond is not in metres."""

_AMPLITUDES = ("min_abs", "max_abs", "min_amplitude", "max_amplitude")
_FILTER = ("amplitude_filter_kernel_size", "amplitude_filter_threshold_dB")
_FRAME_KEY = re.compile("[0-9]{6}")

Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class GridBox:
    """A grid of points in radar space, both ends included.

    Attributes
    ----------
    low_m, high_m : tuple of float, metres
        `bb_min`, `bb_max`: first and last point along x, y (and z).
    counts : tuple of int
        `grid_size`: number of points along x, y (and z).
    """

    low_m: tuple[float, ...]
    high_m: tuple[float, ...]
    counts: tuple[int, ...]

    def axis_m(self, axis: int) -> np.ndarray:
        """Return the points along x (0), y (1) or z (2), radar space, ascending, metres."""
        return np.linspace(self.low_m[axis], self.high_m[axis], self.counts[axis])


@dataclass(frozen=True, slots=True)
class VolumeEntry:
    """`volume` of a frame: the grid of its image, and the range of its amplitudes.

    Attributes
    ----------
    box : GridBox or None
        x, y, z; None where `bb_min`, `bb_max` or `grid_size` is missing.
    min_abs, max_abs : float or None
        Range of the amplitude.
    min_amplitude, max_amplitude : float or None
        Amplitudes at 0 and 255 in `volume/*.ply`.
    """

    box: GridBox | None = None
    min_abs: float | None = None
    max_abs: float | None = None
    min_amplitude: float | None = None
    max_amplitude: float | None = None


@dataclass(frozen=True, slots=True)
class AmplitudeEntry:
    """`amplitude` of a frame: how its depth map was cut.

    Attributes
    ----------
    filter_kernel_size : float or None
    filter_threshold_db : float or None
        Pixels this far below the maximum have no depth; as the file has it, of either sign.
    """

    filter_kernel_size: float | None = None
    filter_threshold_db: float | None = None


@dataclass(frozen=True, slots=True)
class DepthEntry:
    """`depth` of a frame: the pixels of its depth map.

    Attributes
    ----------
    intrinsics : 4 x 4 tuple of float or None
        Between radar space and (column, row, millimetres, 1).
    has_transform : bool
        The older entry `transform` is there: row 0 of the depth map is the smallest y.
    box : GridBox or None
        x, y (and z, if it is given); None where a part of it is missing.
    """

    intrinsics: Matrix | None = None
    has_transform: bool = False
    box: GridBox | None = None


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """The entry of one frame in `calibration.json`; None for each missing part."""

    volume: VolumeEntry | None = None
    amplitude: AmplitudeEntry | None = None
    depth: DepthEntry | None = None


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """`calibration.json`; None for what it leaves out, other keys are passed over.

    Attributes
    ----------
    frequency_low_ghz, frequency_high_ghz : float or None
    frequency_points : int or None
    frames : mapping of int to FrameEntry
    """

    frequency_low_ghz: float | None = None
    frequency_high_ghz: float | None = None
    frequency_points: int | None = None
    frames: Mapping[int, FrameEntry] = field(default_factory=dict)


def read_calibration_file(path: Path) -> CalibrationFile:
    """Read a `calibration.json`.

    Raises
    ------
    MeasurementError
        Missing, no JSON object, or an invalid entry.
    """
    content = read_json_object(path)
    table = StrictTable(shown(path), "", content)
    points = table.number("frequency_points")
    if points is not None and (points < 1 or points != int(points)):
        table.fail("frequency_points", "a whole number above 0", f"{points:g}")
    return CalibrationFile(
        table.number("frequency_low_ghz"),
        table.number("frequency_high_ghz"),
        None if points is None else int(points),
        {int(key): _frame(table.table(key)) for key in content if _FRAME_KEY.fullmatch(key)},
    )


def read_frame_entry(path: Path, number: int) -> FrameEntry | None:
    """Return the entry of one frame in a `calibration.json`, None if there is none.

    The entries of other frames are not read.

    Raises
    ------
    MeasurementError
        As `read_calibration_file`.
    """
    key = f"{number:06d}"
    content = read_json_object(path)
    table = StrictTable(shown(path), "", content)
    return _frame(table.table(key)) if table.has(key) else None


def frame_entry_json(entry: FrameEntry) -> dict[str, Any]:
    """Return a frame's entry as the file has it; what is None is left out."""
    parts: dict[str, Any] = {}
    if entry.volume is not None:
        scalars = {name: getattr(entry.volume, name) for name in _AMPLITUDES}
        parts["volume"] = _box_json(entry.volume.box) | _given(scalars)
    if entry.amplitude is not None:
        values = (entry.amplitude.filter_kernel_size, entry.amplitude.filter_threshold_db)
        parts["amplitude"] = _given(dict(zip(_FILTER, values, strict=True)))
    if entry.depth is not None:
        rows = entry.depth.intrinsics
        intrinsics = None if rows is None else [list(row) for row in rows]
        parts["depth"] = _given({"intrinsics": intrinsics}) | _box_json(entry.depth.box)
    return parts


def write_calibration_file(
    path: Path,
    low_ghz: float,
    high_ghz: float,
    points: int,
    frames: Mapping[int, Mapping[str, Any]],
) -> None:
    """Write a new `calibration.json`.

    Parameters
    ----------
    path : Path
        Must not exist.
    low_ghz, high_ghz : float
    points : int
    frames : mapping of int to JSON object
        Each as `frame_entry_json` gives it.

    Raises
    ------
    OutputError
        It exists or cannot be written.
    """
    content: dict[str, Any] = {
        "frequency_low_ghz": low_ghz,
        "frequency_high_ghz": high_ghz,
        "frequency_points": points,
    }
    content |= {f"{n:06d}": frames[n] for n in sorted(frames)}
    _replace(path, content, force=False)


def put_frame_entry(path: Path, number: int, entry: FrameEntry) -> None:
    """Replace one frame's entry in a `calibration.json`; everything else in it stays as it is.

    Raises
    ------
    MeasurementError
        The file that is there is no JSON object.
    OutputError
        It cannot be written.
    """
    content = read_json_object(path)
    content[f"{number:06d}"] = frame_entry_json(entry)
    _replace(path, content, force=True)


def _replace(path: Path, content: Mapping[str, Any], *, force: bool) -> None:
    write_file(path, (json.dumps(content, indent=2) + "\n").encode("ascii"), force=force)


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _box_json(box: GridBox | None) -> dict[str, Any]:
    if box is None:
        return {}
    return {
        "bb_min": list(box.low_m),
        "bb_max": list(box.high_m),
        "grid_size": list(box.counts),
    }


def _frame(entry: StrictTable) -> FrameEntry:
    volume = amplitude = depth = None
    if entry.has("volume"):
        part = entry.table("volume")
        volume = VolumeEntry(_box(part, 3), *map(part.number, _AMPLITUDES))
    if entry.has("amplitude"):
        part = entry.table("amplitude")
        amplitude = AmplitudeEntry(*map(part.number, _FILTER))
    if entry.has("depth"):
        part = entry.table("depth")
        depth = DepthEntry(_intrinsics(part), part.has("transform"), _box(part, 2, 3))
    return FrameEntry(volume, amplitude, depth)


def _box(part: StrictTable, *lengths: int) -> GridBox | None:
    low, high, counts = (part.numbers(name, *lengths) for name in ("bb_min", "bb_max", "grid_size"))
    if low is None or high is None or counts is None:
        return None
    farthest = max(map(abs, low + high))
    if farthest > MAX_POSITION_M:
        part.fail("bb_min", f"metres, at most {MAX_POSITION_M:g}", f"{farthest:g}")
    if not len(low) == len(high) == len(counts):
        part.fail("grid_size", "as many numbers as in bb_min and bb_max", f"{len(counts)}")
    for a, b, count in zip(low, high, counts, strict=True):
        if count < 1 or count != int(count):
            part.fail("grid_size", "whole numbers above 0", f"{count:g}")
        if not (a < b if count > 1 else a == b):
            expected = "bb_min below bb_max" if count > 1 else "one point where grid_size is 1"
            part.fail("bb_max", expected, f"{a:g} and {b:g}")
    return GridBox(low, high, tuple(int(n) for n in counts))


def _intrinsics(part: StrictTable) -> Matrix | None:
    """Return a matrix given as four rows or as sixteen numbers."""
    value = part.raw("intrinsics")
    if isinstance(value, list) and value and not isinstance(value[0], list):
        flat = part.numbers("intrinsics", 16) or ()
        return tuple(flat[i : i + 4] for i in range(0, 16, 4))
    rows = part.rows("intrinsics")
    if rows is not None and (len(rows), len(rows[0])) != (4, 4):
        part.fail("intrinsics", "a 4 x 4 matrix", f"{len(rows)} x {len(rows[0])}")
    return rows
