"""`calibration.json` of a radar folder: its frequencies, and the grid of each frame's products.

All positions in it are in the dataset's radar space, x_radar = -x_antenna.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from clradar.files.atomic import replacing
from clradar.files.failures import clean, fail
from clradar.files.json_file import read_json_object

CALIBRATION_FILE = "calibration.json"
MAX_POSITION_M = 1e3
"""Farthest end of a grid; anything beyond is not in metres."""

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
        Missing, no JSON object, or an entry that is there is not what it has to be.
    """
    content = read_json_object(path)
    parser = _Parser(path)
    points = parser.number(content, "frequency_points", path.name)
    if points is not None and (points < 1 or points != int(points)):
        fail(path, "'frequency_points' to be a whole number above 0", f"{points:g}")
    return CalibrationFile(
        parser.number(content, "frequency_low_ghz", path.name),
        parser.number(content, "frequency_high_ghz", path.name),
        None if points is None else int(points),
        {int(k): parser.frame(k, v) for k, v in content.items() if _FRAME_KEY.fullmatch(k)},
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
    return _Parser(path).frame(key, content[key]) if key in content else None


def frame_entry_json(entry: FrameEntry) -> dict[str, Any]:
    """Return a frame's entry as the file has it; what is None is left out."""
    parts: dict[str, Any] = {}
    if entry.volume is not None:
        v = entry.volume
        scalars = {
            "min_abs": v.min_abs,
            "max_abs": v.max_abs,
            "min_amplitude": v.min_amplitude,
            "max_amplitude": v.max_amplitude,
        }
        parts["volume"] = _box_json(v.box) | _given(scalars)
    if entry.amplitude is not None:
        a = entry.amplitude
        parts["amplitude"] = _given(
            {
                "amplitude_filter_kernel_size": a.filter_kernel_size,
                "amplitude_filter_threshold_dB": a.filter_threshold_db,
            }
        )
    if entry.depth is not None:
        d = entry.depth
        intrinsics = None if d.intrinsics is None else [list(row) for row in d.intrinsics]
        parts["depth"] = _given({"intrinsics": intrinsics}) | _box_json(d.box)
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
    text = json.dumps(content, indent=2) + "\n"
    with replacing(path, force=force) as temporary:
        temporary.write_text(text, encoding="ascii")


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


class _Parser:
    """Parts of one file, each either as it has to be or an error that names file and key."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path

    def frame(self, key: str, value: Any) -> FrameEntry:
        entry = self._mapping(value, key)
        volume = amplitude = depth = None
        if "volume" in entry:
            where = f"{key}: volume"
            part = self._mapping(entry["volume"], where)
            volume = VolumeEntry(
                self._box(part, where, (3,)),
                *(
                    self.number(part, name, where)
                    for name in ("min_abs", "max_abs", "min_amplitude", "max_amplitude")
                ),
            )
        if "amplitude" in entry:
            where = f"{key}: amplitude"
            part = self._mapping(entry["amplitude"], where)
            amplitude = AmplitudeEntry(
                self.number(part, "amplitude_filter_kernel_size", where),
                self.number(part, "amplitude_filter_threshold_dB", where),
            )
        if "depth" in entry:
            where = f"{key}: depth"
            part = self._mapping(entry["depth"], where)
            intrinsics = None
            if part.get("intrinsics") is not None:
                intrinsics = self._matrix(part["intrinsics"], f"{where}: intrinsics")
            depth = DepthEntry(intrinsics, "transform" in part, self._box(part, where, (2, 3)))
        return FrameEntry(volume, amplitude, depth)

    def number(self, part: Mapping[str, Any], key: str, where: str) -> float | None:
        if part.get(key) is None:
            return None
        return self._finite(part[key], f"{where}: {key}")

    def _box(self, part: Mapping[str, Any], where: str, lengths: tuple[int, ...]) -> GridBox | None:
        names = ("bb_min", "bb_max", "grid_size")
        there = [name for name in names if part.get(name) is not None]
        values = {name: self._list(part[name], f"{where}: {name}", lengths) for name in there}
        if len(there) < len(names):
            return None
        low, high, counts = (values[name] for name in names)
        farthest = max(abs(value) for value in low + high)
        if farthest > MAX_POSITION_M:
            self._refuse(where, f"metres, at most {MAX_POSITION_M:g}", f"{farthest:g}")
        if not len(low) == len(high) == len(counts):
            self._refuse(where, "bb_min, bb_max and grid_size of the same length", "others")
        for a, b, count in zip(low, high, counts, strict=True):
            if count < 1 or count != int(count):
                self._refuse(where, "whole numbers above 0 in grid_size", f"{count:g}")
            if (b < a) if count > 1 else (b != a):
                expected = "bb_min below bb_max" if count > 1 else "one point where grid_size is 1"
                self._refuse(where, expected, f"{a:g} and {b:g}")
            if count > 1 and a == b:
                self._refuse(where, "bb_min below bb_max", f"{a:g} for both")
        return GridBox(tuple(low), tuple(high), tuple(int(n) for n in counts))

    def _list(self, value: Any, where: str, lengths: tuple[int, ...]) -> list[float]:
        if not isinstance(value, list) or len(value) not in lengths:
            self._refuse(where, f"{' or '.join(map(str, lengths))} numbers", _shown(value))
        return [self._finite(item, where) for item in value]

    def _matrix(self, value: Any, where: str) -> Matrix:
        if isinstance(value, list) and len(value) == 16:
            value = [value[i : i + 4] for i in range(0, 16, 4)]
        if not isinstance(value, list) or len(value) != 4:
            self._refuse(where, "a 4 x 4 matrix", _shown(value))
        return tuple(tuple(self._list(row, where, (4,))) for row in value)

    def _finite(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._refuse(where, "a number", _shown(value))
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self._refuse(where, "a finite number", _shown(value))
        return number

    def _mapping(self, value: Any, where: str) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            self._refuse(where, "a JSON object", _shown(value))
        return value

    def _refuse(self, where: str, expected: str, got: str) -> NoReturn:
        fail(self._path, f"{expected} in '{clean(where)}'", got)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, str | float):
        return f"{type(value).__name__} {clean(str(value)[:40])}"
    return type(value).__name__
