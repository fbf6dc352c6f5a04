"""The depth map that a radar folder has beside a frame, and the grid that places its pixels.

The files are in the dataset's radar space, x_radar = -x_antenna, and their rows run from the
largest y to the smallest. What is returned has x and y of the antenna frame, both ascending.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.files.failures import fail, reading
from clradar.files.json_file import read_json_object
from clradar.files.limits import MAX_IMAGE_PIXELS
from clradar.files.records import Number, Numbers, OpenRecord, Whole, mistake, record_of
from clradar.model import DepthMap, checks
from measurement_io.confined.reading import run
from measurement_io.maroon.alignment import Matrix
from measurement_io.maroon.folders import CALIBRATION_FILE, product_files, ranges
from measurement_io.maroon.frame_file import PNG, pixels

MAX_POSITION_M = 1e3  # farthest end of a grid; anything beyond is not in metres
MM_PER_M = 1000.0
SAME_M = 1e-6
"""Grids closer than this are the same: some of their ends have been rounded to float32."""

_MATRIX_TOLERANCE = 1e-6  # relative; the matrices are products of a few float64 numbers

Axis = tuple[float, float, int]
"""First and last point, metres, and number of points."""


class Grid(OpenRecord):
    """`volume` or `depth` of a frame: the grid of its pixels, both ends included."""

    bb_min: Numbers | None = None
    bb_max: Numbers | None = None
    grid_size: Numbers | None = None

    @model_validator(mode="after")
    def _is_a_grid(self) -> Grid:
        low, high, counts = self.bb_min, self.bb_max, self.grid_size
        if low is None or high is None or counts is None:
            return self
        farthest = max(map(abs, low + high))
        if farthest > MAX_POSITION_M:
            raise mistake(f"metres, at most {MAX_POSITION_M:g}", f"{farthest:g}", key="bb_min")
        if not len(low) == len(high) == len(counts) in (2, 3):
            raise mistake("as many numbers as in bb_min, 2 or 3", len(counts), key="grid_size")
        for a, b, count in zip(low, high, counts, strict=True):
            if count < 1 or count != int(count):
                raise mistake("whole numbers above 0", f"{count:g}", key="grid_size")
            if not (a < b if count > 1 else a == b):
                expected = "bb_min below bb_max" if count > 1 else "one point where grid_size is 1"
                raise mistake(expected, f"{a:g} and {b:g}", key="bb_max")
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

    intrinsics: Matrix | None = None
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
    frequency_points: Annotated[Whole, Field(gt=0)] | None = None


def read_frequencies(path: Path) -> tuple[Frequencies, set[int]]:
    """Return the frequencies of a `calibration.json`, and the frames that it has entries of."""
    content = read_json_object(path)
    entries = {key for key in content if len(key) == 6 and key.isascii() and key.isdecimal()}
    for key in sorted(entries):
        record_of(content[key], FrameEntry, path, place=key)
    return record_of(content, Frequencies, path), {int(key) for key in entries}


def read_depth_map(radar: str | os.PathLike[str], number: int) -> DepthMap:
    """Return `depth/%06d.png` of a frame of a radar folder, in the antenna frame.

    Depths are whole millimetres in the file; 0 becomes NaN. The amplitude is that of `maxproj`
    where there is one, else 1 where there is a depth. The pixels lie where `calibration.json` has
    them, in `volume` or `depth` of the frame (`bb_min`, `bb_max`, `grid_size`, both ends included),
    or by `depth: intrinsics`; `depth: transform` means rows that run upwards.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from PIL import Image
    >>> radar = Path("plate/30/radar_72.0_82.0_3")
    >>> (radar / "depth").mkdir(parents=True)
    >>> Image.fromarray(np.array([[300, 0]], np.uint16)).save(radar / "depth/000000.png")
    >>> grid = {"bb_min": [-0.1, 0.0], "bb_max": [0.1, 0.0], "grid_size": [2, 1]}
    >>> _ = (radar / "calibration.json").write_text(json.dumps({"000000": {"depth": grid}}))
    >>> depth = measurement_io.read_depth_map(radar, 0)
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
    place, (rows, columns) = f"'{number:06d}'", shape
    placed = [part.pixels for part in (entry.volume, entry.depth) if part and part.pixels]
    if len(placed) == 2 and np.abs(np.subtract(placed[0], placed[1])).max() > SAME_M:
        expected = f"the same x and y in 'volume' and 'depth' of {place}"
        fail(calibration, expected, " and ".join(map(str, placed)))
    if placed:
        x, y = placed[0]
        if (rows, columns) != (y[2], x[2]):
            expected = f"{y[2]} rows of {x[2]} pixels, by {CALIBRATION_FILE}"
            fail(path, expected, f"{rows} rows of {columns}")
        return -np.linspace(*x)[::-1], np.linspace(*y)
    if entry.depth is None or entry.depth.intrinsics is None:
        expected = (
            f"where the pixels of {path.parent.name}/{path.name} are: 'bb_min', 'bb_max' and "
            f"'grid_size', or 'depth: intrinsics', in {place}"
        )
        fail(calibration, expected, "neither")
    # (column, row, millimetres, 1) = K (x, y, z, 1), metres; below 1 m / mm it is the inverse.
    matrix = entry.depth.intrinsics
    matrix = np.linalg.inv(matrix) if abs(matrix[2, 2]) < 1.0 else matrix
    scale_x, scale_y = matrix[0, 0], matrix[1, 1]
    plain = np.diag([scale_x, scale_y, MM_PER_M, 1.0])
    plain[:2, 3] = matrix[:2, 3]
    if not (scale_x > 0 > scale_y and np.abs(matrix - plain).max() <= _MATRIX_TOLERANCE * MM_PER_M):
        expected = (
            f"'depth: intrinsics' of {place} from metres to (column, row, millimetres) without "
            "rotation, columns along +x and rows along -y"
        )
        fail(calibration, expected, "another matrix")
    x_radar_m = (np.arange(columns) - matrix[0, 3]) / scale_x
    y_m = (np.arange(rows) - matrix[1, 3]) / scale_y
    return -x_radar_m[::-1], y_m[::-1]


def read_png16(path: Path) -> np.ndarray:
    """Return a 16-bit grey image, shape (rows, columns), uint16; row 0 is the first of the file."""
    found: np.ndarray = run(
        pixels, path, MAX_IMAGE_PIXELS, most_bytes=2 * MAX_IMAGE_PIXELS, expected=PNG,
        modules=("PIL.Image", "PIL.PngImagePlugin"),
    )  # fmt: skip
    return found
