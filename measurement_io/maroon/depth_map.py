"""The depth map that a radar folder has beside a frame, and the grid that places its pixels.

The files are in the dataset's radar space, x_radar = -x_antenna, and their rows run from the
largest y to the smallest. What is returned has x and y of the antenna frame, both ascending.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, model_validator

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.files.failures import fail, reading
from clradar.files.json_file import read_json_object
from clradar.files.records import (
    Number,
    OpenRecord,
    Rows,
    checked,
    is_number,
    mistake,
    numbers,
    record_of,
)
from clradar.model import DepthMap, checks
from measurement_io.maroon.folders import CALIBRATION_FILE, product_files, ranges
from measurement_io.maroon.png16 import read_png16

MAX_POSITION_M = 1e3
"""Farthest end of a grid; anything beyond is not in metres."""

MM_PER_M = 1000.0
SAME_M = 1e-6
"""Grids closer than this are the same: some of their ends have been rounded to float32."""

_MATRIX_TOLERANCE = 1e-6
"""Relative; the matrices are products of a few float64 numbers."""


def _four_rows(value: Any) -> Any:
    """Return sixteen numbers as four rows, anything else as it is."""
    if isinstance(value, list) and len(value) == 16:
        return [value[i : i + 4] for i in range(0, 16, 4)]
    return value


def _square(rows: Any) -> Any:
    if (len(rows), len(rows[0])) != (4, 4):
        raise mistake("a 4 x 4 matrix", f"{len(rows)} x {len(rows[0])}")
    return rows


Axis = tuple[float, float, int]
"""First and last point, metres, and number of points."""


def _is_a_count(value: Any) -> bool:
    return is_number(value) and value >= 1 and value == int(value)


class Grid(OpenRecord):
    """`volume` or `depth` of a frame: the grid of its pixels, both ends included."""

    bb_min: Annotated[tuple[float, ...] | None, numbers(2, 3)] = None
    bb_max: Annotated[tuple[float, ...] | None, numbers(2, 3)] = None
    grid_size: Annotated[tuple[float, ...] | None, numbers(2, 3)] = None

    @model_validator(mode="after")
    def _is_a_grid(self) -> Grid:
        low, high, counts = self.bb_min, self.bb_max, self.grid_size
        if low is None or high is None or counts is None:
            return self
        farthest = max(map(abs, low + high))
        if farthest > MAX_POSITION_M:
            raise mistake(f"metres, at most {MAX_POSITION_M:g}", f"{farthest:g}", key="bb_min")
        if not len(low) == len(high) == len(counts):
            expected = "as many numbers as in bb_min and bb_max"
            raise mistake(expected, f"{len(counts)}", key="grid_size")
        for a, b, count in zip(low, high, counts, strict=True):
            if count < 1 or count != int(count):
                raise mistake("whole numbers above 0", f"{count:g}", key="grid_size")
            if not (a < b if count > 1 else a == b):
                words = "bb_min below bb_max" if count > 1 else "one point where grid_size is 1"
                raise mistake(words, f"{a:g} and {b:g}", key="bb_max")
        return self

    @property
    def pixels(self) -> tuple[Axis, Axis] | None:
        """Ends and number of the pixels along x and y, radar space; None if a part is missing."""
        if self.bb_min is None or self.bb_max is None or self.grid_size is None:
            return None
        x, y, *_ = zip(self.bb_min, self.bb_max, map(int, self.grid_size), strict=True)
        return x, y


class DepthEntry(Grid):
    """`depth` of a frame; with `transform`, row 0 of the depth map is the smallest y."""

    intrinsics: Annotated[Rows, BeforeValidator(_four_rows), AfterValidator(_square)] | None = None
    transform: Any = None


class AmplitudeEntry(OpenRecord):
    """`amplitude` of a frame: pixels this far below the maximum have no depth, of either sign."""

    amplitude_filter_threshold_dB: Number | None = None


class FrameEntry(OpenRecord):
    """The entry of one frame in `calibration.json`."""

    volume: Grid | None = None
    amplitude: AmplitudeEntry | None = None
    depth: DepthEntry | None = None


class Frequencies(OpenRecord):
    """The frequencies in `calibration.json`."""

    frequency_low_ghz: Number | None = None
    frequency_high_ghz: Number | None = None
    frequency_points: Annotated[int, checked("a whole number above 0", _is_a_count, int)] | None = (
        None
    )


def read_frequencies(path: Path) -> tuple[Frequencies, set[int]]:
    """Return the frequencies of a `calibration.json`, and the frames that it has entries of."""
    content = read_json_object(path)
    entries = {key for key in content if len(key) == 6 and key.isascii() and key.isdecimal()}
    for key in sorted(entries):
        record_of(content[key], FrameEntry, path, place=key)
    return record_of(content, Frequencies, path), {int(key) for key in entries}


def read_depth_map(radar: str | os.PathLike[str], number: int) -> DepthMap:
    """Return `depth/%06d.png` of a frame.

    Parameters
    ----------
    radar : path-like
        A radar folder.
    number : int
        The frame.

    Returns
    -------
    DepthMap
        In the antenna frame. The file's depths are whole millimetres; 0 becomes NaN. The
        amplitude is that of `maxproj`, where there is one of the same shape, else 1 where there
        is a depth and 0 elsewhere. `dynamic_range_db` is the magnitude of the threshold that
        `calibration.json` names, or the default where it names none, or 0.

    Notes
    -----
    The positions of the pixels are in `volume` of the frame's entry of `calibration.json` (its
    `bb_min`, `bb_max`, `grid_size`, both ends included); else by the same keys in `depth`; else by
    `depth: intrinsics`. An entry `depth: transform` means that the file's rows still run upwards.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from PIL import Image
    >>> from measurement_io import read_depth_map
    >>> radar = Path("plate/30/radar_72.0_82.0_3")
    >>> (radar / "depth").mkdir(parents=True)
    >>> Image.fromarray(np.array([[300, 0]], np.uint16)).save(radar / "depth" / "000000.png")
    >>> grid = {"bb_min": [-0.1, 0.0], "bb_max": [0.1, 0.0], "grid_size": [2, 1]}
    >>> _ = (radar / "calibration.json").write_text(json.dumps({"000000": {"depth": grid}}))
    >>> depth = read_depth_map(radar, 0)
    >>> depth.depth_m.tolist(), depth.x_m.tolist()  # x is mirrored
    ([[nan, 0.3]], [-0.1, 0.1])
    """
    radar = Path(radar)
    number = checks.whole("depth: number of the frame", number, 0)
    there = product_files(radar, "depth")
    if number not in there:
        found = f"none; frames with one: {ranges(there)}" if there else "none of any frame"
        fail(radar / "depth" / f"{number:06d}.png", f"the depth of frame {number}", found)
    path, calibration = there[number], radar / CALIBRATION_FILE
    if not calibration.exists():
        fail(calibration, f"the grid of depth/{path.name}", "none")
    content = read_json_object(calibration)
    if f"{number:06d}" not in content:
        fail(calibration, f"an entry '{number:06d}', for depth/{path.name}", "none")
    entry = record_of(content[f"{number:06d}"], FrameEntry, calibration, place=f"{number:06d}")
    millimetres = read_png16(path)
    x_m, y_m = _pixel_axes(calibration, path, number, entry, millimetres.shape)
    upwards = entry.depth is not None and "transform" in entry.depth.model_fields_set
    millimetres = millimetres[:, ::-1] if upwards else millimetres[::-1, ::-1]
    depth_m = np.where(millimetres == 0, np.nan, millimetres / MM_PER_M)
    amplitude = np.isfinite(depth_m).astype(np.float32)
    strength = product_files(radar, "maxproj").get(number)
    if strength is not None:
        pixels = read_png16(strength)
        if pixels.shape == depth_m.shape:
            amplitude = pixels[::-1, ::-1].astype(np.float32)
    threshold_db = entry.amplitude and entry.amplitude.amplitude_filter_threshold_dB
    # Below the maximum, with either sign.
    cut_db = abs(threshold_db) if threshold_db else DYNAMIC_RANGE_DB
    with reading(path, "a depth map"):
        return DepthMap(depth_m, amplitude, x_m, y_m, cut_db)


def _pixel_axes(
    calibration: Path, path: Path, number: int, entry: FrameEntry, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the antenna frame of an image's pixels, ascending."""
    placed = [part.pixels for part in (entry.volume, entry.depth) if part and part.pixels]
    if len(placed) == 2 and not _same(*placed):
        fail(
            calibration,
            f"the same x and y in '{number:06d}: volume' and '{number:06d}: depth'",
            " and ".join(map(_in_words, placed)),
        )
    rows, columns = shape
    if placed:
        x, y = placed[0]
        if (rows, columns) != (y[2], x[2]):
            expected = f"{y[2]} rows of {x[2]} pixels, by {CALIBRATION_FILE}"
            fail(path, expected, f"{rows} rows of {columns}")
        return -np.linspace(*x)[::-1], np.linspace(*y)
    if entry.depth is None or entry.depth.intrinsics is None:
        fail(
            calibration,
            f"where the pixels of {path.parent.name}/{path.name} are: 'bb_min', 'bb_max' and "
            f"'grid_size', or 'depth: intrinsics', in '{number:06d}'",
            "neither",
        )
    return _axes_of_matrix(calibration, number, np.array(entry.depth.intrinsics), rows, columns)


def _same(a: tuple[Axis, Axis], b: tuple[Axis, Axis]) -> bool:
    return bool(np.abs(np.subtract(a, b)).max() <= SAME_M)


def _in_words(axes: tuple[Axis, Axis]) -> str:
    return " x ".join(f"{count} from {low:g} to {high:g} m" for low, high, count in axes)


def _axes_of_matrix(
    calibration: Path, number: int, matrix: np.ndarray, rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes of pixels that only `intrinsics` places.

    Read as (column, row, millimetres, 1) = K (x, y, z, 1) in metres of radar space or, where its
    third diagonal element is below 1, as the inverse of that.
    """
    where = f"'{number:06d}: depth: intrinsics'"
    with (
        reading(calibration, f"an invertible matrix as {where}"),
        np.errstate(all="ignore"),  # any numbers, of which those below are wanted
    ):
        if abs(matrix[2, 2]) < 1.0:
            matrix = np.linalg.inv(matrix)
        scale_x, scale_y = matrix[0, 0], matrix[1, 1]
        expected = np.array(
            [
                [scale_x, 0, 0, matrix[0, 3]],
                [0, scale_y, 0, matrix[1, 3]],
                [0, 0, MM_PER_M, 0],
                [0, 0, 0, 1],
            ]
        )
        error = np.abs(matrix - expected).max()
    if not (scale_x > 0 > scale_y and error <= _MATRIX_TOLERANCE * MM_PER_M):
        fail(
            calibration,
            f"{where} from metres to (column, row, millimetres) without rotation, columns along "
            "+x and rows along -y",
            "another matrix",
        )
    with np.errstate(over="ignore", invalid="ignore"):  # the record refuses infinite ones
        x_radar_m = (np.arange(columns) - matrix[0, 3]) / scale_x
        y_m = (np.arange(rows) - matrix[1, 3]) / scale_y
    return -x_radar_m[::-1], y_m[::-1]
