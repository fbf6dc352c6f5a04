"""The images that a radar folder ships beside its frames, in the antenna frame.

The files are in the dataset's radar space, x_radar = -x_antenna, and their rows run from the
largest y to the smallest. What is returned has x and y of the antenna frame, both ascending.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.files.failures import fail, reading
from clradar.files.limits import MAX_IMAGE_PIXELS, MAX_PLY_VOXELS
from clradar.model import DepthMap, VoxelGrid, checks
from measurement_io.maroon.calibration_file import (
    CALIBRATION_FILE,
    FrameEntry,
    GridBox,
    Matrix,
    read_frame_entry,
)
from measurement_io.maroon.folders import entries, ranges
from measurement_io.maroon.ply_points import ply_blocks, read_ply_header, require_properties
from measurement_io.maroon.png16 import read_png16

PRODUCTS = {"depth": "png", "maxproj": "png", "volume": "ply", "xyz": "ply"}
"""Folder of each product, and the extension of its files."""

PLACED = {"depth": "its pixels", "maxproj": "its pixels", "volume": "its grid and its amplitudes"}
"""Products whose grid is in `calibration.json` alone; points of `xyz` carry their positions."""


MM_PER_M = 1000.0
SINGLE_SPACING_M = 1e-3
"""Spacing of an axis of one voxel, which has none."""

SAME_M = 1e-6
"""Grids closer than this are the same: some of their ends have been rounded to float32."""

_MATRIX_TOLERANCE = 1e-6
"""Relative; the matrices are products of a few float64 numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeImage:
    """Maximum of an image's amplitude along z.

    Parameters
    ----------
    amplitude : array_like, shape (n_y, n_x), float32
        Linear, as the file has it: whole numbers, since it cuts off the fraction.
    x_m, y_m : array_like, shape (n_x,) and (n_y,), metres
        Pixel centres in the antenna frame, ascending.
    """

    amplitude: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray

    def __post_init__(self) -> None:
        x_m = checks.one_axis("AmplitudeImage.x_m", self.x_m)
        y_m = checks.one_axis("AmplitudeImage.y_m", self.y_m)
        amplitude = checks.read_only(
            "AmplitudeImage.amplitude (y, x)", self.amplitude, np.float32, (len(y_m), len(x_m))
        )
        object.__setattr__(self, "amplitude", amplitude)
        object.__setattr__(self, "x_m", x_m)
        object.__setattr__(self, "y_m", y_m)


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeVolume:
    """An image without its phase.

    Parameters
    ----------
    amplitude : array_like, shape (n_z, n_y, n_x), float32
        Linear, quantised to 256 steps between the smallest and the largest.
    grid : VoxelGrid
        In the antenna frame.
    """

    amplitude: np.ndarray
    grid: VoxelGrid

    def __post_init__(self) -> None:
        checks.instance("AmplitudeVolume.grid", self.grid, VoxelGrid)
        amplitude = checks.read_only(
            "AmplitudeVolume.amplitude (z, y, x)", self.amplitude, np.float32, self.grid.shape
        )
        object.__setattr__(self, "amplitude", amplitude)


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of a depth map with their amplitude.

    Parameters
    ----------
    points_m : array_like, shape (n, 3), float64, metres
        x, y, z in the antenna frame.
    amplitude : array_like, shape (n,), float32
        Linear, relative to the image's maximum: 0 to 1 in 256 steps.
    """

    points_m: np.ndarray
    amplitude: np.ndarray

    def __post_init__(self) -> None:
        points = checks.read_only(
            "PointCloud.points_m", self.points_m, np.float64, (None, 3), allow_empty=True
        )
        amplitude = checks.read_only(
            "PointCloud.amplitude", self.amplitude, np.float32, (len(points),), allow_empty=True
        )
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "amplitude", amplitude)


def product_files(radar: Path, product: str) -> dict[int, Path]:
    """Return the files of one product of a radar folder by the number of their frame."""
    folder = radar / product
    with reading(folder, "a folder of products"):
        if not folder.is_dir():
            return {}
    pattern = re.compile(rf"([0-9]{{6}})\.{PRODUCTS[product]}")
    matches = ((pattern.fullmatch(path.name), path) for path in entries(folder))
    return {int(match[1]): path for match, path in matches if match is not None}


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

    Raises
    ------
    MeasurementError
        The frame has no such file, it is damaged or another kind of image, or `calibration.json`
        has no grid for its pixels.

    Notes
    -----
    The positions of the pixels are in `volume` of the frame's entry of `calibration.json` (its
    `bb_min`, `bb_max`, `grid_size`, both ends included); else by the same keys in `depth`; else by
    `depth: intrinsics`. An entry `depth: transform` means that the file's rows still run upwards.
    """
    radar = Path(radar)
    path, entry = _product(radar, "depth", number)
    millimetres = read_png16(path)
    x_m, y_m = _pixel_axes(radar / CALIBRATION_FILE, path, number, entry, millimetres.shape)
    upwards = entry.depth is not None and entry.depth.has_transform
    millimetres = millimetres[:, ::-1] if upwards else millimetres[::-1, ::-1]
    depth_m = np.where(millimetres == 0, np.nan, millimetres / MM_PER_M)
    amplitude = np.isfinite(depth_m).astype(np.float32)
    strength = product_files(radar, "maxproj").get(number)
    if strength is not None:
        pixels = read_png16(strength)
        if pixels.shape == depth_m.shape:
            amplitude = pixels[::-1, ::-1].astype(np.float32)
    threshold_db = None if entry.amplitude is None else entry.amplitude.filter_threshold_db
    # Below the maximum, with either sign.
    cut_db = abs(threshold_db) if threshold_db else DYNAMIC_RANGE_DB
    with reading(path, "a depth map"):
        return DepthMap(depth_m, amplitude, x_m, y_m, cut_db)


def read_max_projection(radar: str | os.PathLike[str], number: int) -> AmplitudeImage:
    """Return `maxproj/%06d.png` of a frame.

    Returns
    -------
    AmplitudeImage
        In the antenna frame, amplitudes as in the file. The dataset divides an image by the number
        of Rx times Tx and not by that of frequencies: divide by the latter to hold it against
        `Volume.max_projection()`.

    Raises
    ------
    MeasurementError
        As `read_depth_map`, which also documents the grid.
    """
    radar = Path(radar)
    path, entry = _product(radar, "maxproj", number)
    pixels = read_png16(path)
    x_m, y_m = _pixel_axes(radar / CALIBRATION_FILE, path, number, entry, pixels.shape)
    with reading(path, "an amplitude image"):
        return AmplitudeImage(pixels[::-1, ::-1].astype(np.float32), x_m, y_m)


def read_amplitude_volume(radar: str | os.PathLike[str], number: int) -> AmplitudeVolume:
    """Return `volume/%06d.ply` of a frame.

    Returns
    -------
    AmplitudeVolume
        In the antenna frame. red / 255 * (max_amplitude - min_amplitude) + min_amplitude, in the
        unit of `maxproj`.

    Raises
    ------
    MeasurementError
        The frame has no such file, it is damaged, or `calibration.json` lacks its grid and
        amplitudes, or has another grid.

    Notes
    -----
    The values are in the order (y descending, x ascending, z ascending) of radar space. The y of
    the points that carry them ascends, against the values, and is not used; their x and z are held
    against the grid.
    """
    radar = Path(radar)
    path, entry = _product(radar, "volume", number)
    calibration = radar / CALIBRATION_FILE
    part = entry.volume
    if part is None or part.box is None:
        fail(calibration, f"'bb_min', 'bb_max' and 'grid_size' in '{number:06d}: volume'", "none")
    if part.min_amplitude is None or part.max_amplitude is None:
        fail(
            calibration,
            f"'min_amplitude' and 'max_amplitude' in '{number:06d}: volume', to scale {path.name}",
            "none",
        )
    if not 0 <= part.min_amplitude <= part.max_amplitude:
        fail(
            calibration,
            f"0 <= min_amplitude <= max_amplitude in '{number:06d}: volume'",
            f"{part.min_amplitude:g} and {part.max_amplitude:g}",
        )
    n_x, n_y, n_z = part.box.counts
    header = read_ply_header(path, MAX_PLY_VOXELS)
    if header.count != n_x * n_y * n_z:
        fail(path, f"the {n_x} x {n_y} x {n_z} points of {CALIBRATION_FILE}", f"{header.count}")
    require_properties(path, header, x="float", z="float", red="8-bit")
    red = np.empty(header.count, np.uint8)
    first = 0
    for block in ply_blocks(path, header):
        with np.errstate(all="ignore"):  # a file can hold any bits as its numbers
            _check_order(path, part.box, block, first)
        red[first : first + len(block)] = block["red"]
        first += len(block)
    span = part.max_amplitude - part.min_amplitude
    with reading(path, "an amplitude volume"):
        grid = _voxel_grid(part.box)
        turned = red.reshape(n_y, n_x, n_z)[::-1, ::-1].transpose(2, 0, 1)
        with np.errstate(over="ignore", invalid="ignore"):  # the record refuses infinite ones
            levels = (part.min_amplitude + span * np.arange(256) / 255).astype(np.float32)
        amplitude = levels[turned]
        amplitude.flags.writeable = False
        return AmplitudeVolume(amplitude, grid)


def read_points(radar: str | os.PathLike[str], number: int) -> PointCloud:
    """Return `xyz/%06d.ply` of a frame.

    Returns
    -------
    PointCloud
        In the antenna frame: the file's points with their x turned around. The amplitude is
        green / 255.

    Raises
    ------
    MeasurementError
        The frame has no such file, it is damaged, or its points have no green.
    """
    path = _product_file(Path(radar), "xyz", number)
    header = read_ply_header(path, MAX_IMAGE_PIXELS)
    require_properties(path, header, x="float", y="float", z="float", green="8-bit")
    points_m = np.empty((header.count, 3))
    amplitude = np.empty(header.count, np.float32)
    first = 0
    for block in ply_blocks(path, header):
        rows = slice(first, first + len(block))
        with np.errstate(all="ignore"):  # a file can hold any bits as its numbers
            for axis, name in enumerate("xyz"):
                points_m[rows, axis] = block[name]
        amplitude[rows] = block["green"] / np.float32(255)
        first += len(block)
    points_m[:, 0] *= -1.0
    points_m.flags.writeable = amplitude.flags.writeable = False
    with reading(path, "points"):
        return PointCloud(points_m, amplitude)


def _product_file(radar: Path, product: str, number: int) -> Path:
    number = checks.whole(f"{product}: number of the frame", number, 0)
    there = product_files(radar, product)
    if number not in there:
        path = radar / product / f"{number:06d}.{PRODUCTS[product]}"
        found = f"none; frames with one: {ranges(there)}" if there else "none of any frame"
        fail(path, f"the {product} of frame {number}", found)
    return there[number]


def _product(radar: Path, product: str, number: int) -> tuple[Path, FrameEntry]:
    path = _product_file(radar, product, number)
    calibration = radar / CALIBRATION_FILE
    if not calibration.exists():
        fail(calibration, f"the grid of {product}/{path.name}", "none")
    entry = read_frame_entry(calibration, number)
    if entry is None:
        fail(calibration, f"an entry '{number:06d}', for {product}/{path.name}", "none")
    return path, entry


def _pixel_axes(
    calibration: Path, path: Path, number: int, entry: FrameEntry, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the antenna frame of an image's pixels, ascending."""
    box = None if entry.volume is None else entry.volume.box
    depth_box = None if entry.depth is None else entry.depth.box
    if box is not None and depth_box is not None and not _same_pixels(box, depth_box):
        fail(
            calibration,
            f"the same x and y in '{number:06d}: volume' and '{number:06d}: depth'",
            f"{_in_words(box)} and {_in_words(depth_box)}",
        )
    box = depth_box if box is None else box
    rows, columns = shape
    if box is not None:
        if (rows, columns) != (box.counts[1], box.counts[0]):
            fail(
                path,
                f"{box.counts[1]} rows of {box.counts[0]} pixels, by {CALIBRATION_FILE}",
                f"{rows} rows of {columns}",
            )
        x_radar_m, y_m = box.axis_m(0), box.axis_m(1)
        return -x_radar_m[::-1], y_m
    if entry.depth is None or entry.depth.intrinsics is None:
        fail(
            calibration,
            f"where the pixels of {path.parent.name}/{path.name} are: 'bb_min', 'bb_max' and "
            f"'grid_size', or 'depth: intrinsics', in '{number:06d}'",
            "neither",
        )
    return _axes_of_matrix(calibration, number, entry.depth.intrinsics, rows, columns)


def _same_pixels(a: GridBox, b: GridBox) -> bool:
    ends = [np.array([box.low_m[:2], box.high_m[:2]]) for box in (a, b)]
    return a.counts[:2] == b.counts[:2] and bool(np.abs(ends[0] - ends[1]).max() <= SAME_M)


def _in_words(box: GridBox) -> str:
    return " x ".join(
        f"{box.counts[i]} from {box.low_m[i]:g} to {box.high_m[i]:g} m" for i in range(2)
    )


def _axes_of_matrix(
    calibration: Path, number: int, intrinsics: Matrix, rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes of pixels that only `intrinsics` places.

    Read as (column, row, millimetres, 1) = K (x, y, z, 1) in metres of radar space or, where its
    third diagonal element is below 1, as the inverse of that.
    """
    where = f"'{number:06d}: depth: intrinsics'"
    matrix = np.array(intrinsics)
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


def _voxel_grid(box: GridBox) -> VoxelGrid:
    low, high = np.array(box.low_m), np.array(box.high_m)
    counts = np.array(box.counts)
    spacing = np.where(counts > 1, (high - low) / np.maximum(counts - 1, 1), SINGLE_SPACING_M)
    origin = np.array([-high[0], low[1], low[2]])
    return VoxelGrid(origin, spacing, (box.counts[0], box.counts[1], box.counts[2]))


def _check_order(path: Path, box: GridBox, block: np.ndarray, first: int) -> None:
    """Raise unless points `first`, `first` + 1, ... lie at the x and z of the order (y, x, z)."""
    index = np.arange(first, first + len(block))
    n_x, _, n_z = box.counts
    for axis, name, at in ((0, "x", index // n_z % n_x), (2, "z", index % n_z)):
        axis_m = box.axis_m(axis)
        half = (axis_m[1] - axis_m[0]) / 2 if len(axis_m) > 1 else SINGLE_SPACING_M / 2
        off = ~(np.abs(block[name] - axis_m[at]) < half)
        if off.any():
            i = int(np.argmax(off))
            fail(
                path,
                f"its points in the order y, x, z of {CALIBRATION_FILE}'s grid",
                f"{name} = {float(block[name][i]):g} m at point {first + i}, not "
                f"{axis_m[at[i]]:g} m",
            )
