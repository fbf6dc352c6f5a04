"""Write an image as the cached products of a radar folder's frame."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ModelError
from clradar.files.atomic import refuse_existing, replacing
from clradar.files.failures import fail
from clradar.model import DepthMap, Volume, VoxelGrid, checks
from measurement_io.maroon.calibration_file import (
    CALIBRATION_FILE,
    AmplitudeEntry,
    DepthEntry,
    FrameEntry,
    GridBox,
    Matrix,
    VolumeEntry,
    frame_entry_json,
    put_frame_entry,
    read_calibration_file,
)
from measurement_io.maroon.ply_points import ply_dtype, write_ply
from measurement_io.maroon.png16 import write_png16
from measurement_io.maroon.products import MM_PER_M, PRODUCTS

_POINT = tuple((name, "double") for name in "xyz") + tuple(
    (name, "uchar") for name in ("red", "green", "blue")
)
_MAX_16_BIT = 2**16 - 1
_UNFILTERED = 1
"""Kernel size without effect."""


def write_products(
    radar: str | os.PathLike[str],
    number: int,
    volume: Volume,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    gain: float = 1.0,
    force: bool = False,
) -> tuple[Path, ...]:
    """Write `depth`, `maxproj`, `volume` and `xyz` of a frame, and its entry of `calibration.json`.

    Parameters
    ----------
    radar : path-like
        A radar folder with its `calibration.json`; the product folders are made where missing.
    number : int
        The frame, 0 to 999999.
    volume : Volume
        Its image, in the antenna frame.
    dynamic_range_db : float, decibel
        Pixels further below the maximum get no depth and no point.
    gain : float
        Factor on the amplitudes beyond that of the dataset (below).
    force : bool
        Replace products that are there.

    Returns
    -------
    tuple of Path
        The files, in the order of the first line.

    Raises
    ------
    ModelError
        The image cannot be stored: it is zero, its strongest pixel is below 1 or above 65535 in
        `maxproj`, or a depth is not between 0 and 65.535 m.
    MeasurementError
        `calibration.json` is missing, damaged, or has no number of frequencies.
    OutputError
        A product exists and `force` is not set, or the system refuses to write.

    Notes
    -----
    Amplitudes are multiplied by the number of frequencies, by which the dataset does not divide an
    image. Depths are those of `Volume.depth_map`, rounded to whole millimetres; amplitudes of
    `maxproj` lose their fraction; those of `volume` and `xyz` are rounded to 8 bits.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import save_recording, write_products
    >>> array, waveform = clradar.arrays.qar50(), clradar.Waveform([72e9, 77e9, 82e9])
    >>> data = np.full((94, 94, 3), 1 - 1j, np.complex64)
    >>> capture = clradar.Capture(data, array, waveform)
    >>> radar = save_recording("plate/30", [capture])
    >>> grid = clradar.VoxelGrid([-0.01, -0.01, 0.3], [0.01, 0.01, 0.01], (3, 3, 2))
    >>> image = np.zeros(grid.shape, np.complex64)
    >>> image[1, 1, 2] = 1000
    >>> paths = write_products(radar, 0, clradar.Volume(image, grid))
    >>> [path.parent.name for path in paths]
    ['depth', 'maxproj', 'volume', 'xyz']
    >>> from clradar.measurement_io.maroon.products import read_depth_map
    >>> depth = read_depth_map(radar, 0)
    >>> round(float(depth.depth_m[depth.mask][0]), 3)
    0.31
    """
    number = checks.whole("write_products: number", number, 0, 999_999)
    gain = checks.positive("write_products: gain", gain)
    checks.instance("write_products: volume", volume, Volume)
    radar = Path(radar)
    calibration = radar / CALIBRATION_FILE
    points = read_calibration_file(calibration).frequency_points
    if points is None:
        fail(calibration, "'frequency_points', by which amplitudes are scaled", "none")
    scale = points * gain

    depth = volume.depth_map(dynamic_range_db)
    rows_mm = _depth_rows(depth)
    strength = _strength_rows(depth.amplitude.astype(np.float64) * scale)
    amplitude = np.abs(volume.data) * np.float32(scale)
    low, high = float(amplitude.min()), float(amplitude.max())
    box = radar_box(volume.grid)
    entry = FrameEntry(
        VolumeEntry(box, low, high, low, high),
        AmplitudeEntry(_UNFILTERED, dynamic_range_db),
        DepthEntry(_intrinsics(box)),
    )
    targets = [radar / name / f"{number:06d}.{kind}" for name, kind in PRODUCTS.items()]
    for target in targets:
        target.parent.mkdir(exist_ok=True)
        refuse_existing(target, force=force)
    depth_png, maxproj_png, volume_ply, xyz_ply = targets
    with replacing(depth_png, force=force) as temporary:
        write_png16(temporary, rows_mm)
    with replacing(maxproj_png, force=force) as temporary:
        write_png16(temporary, strength)
    with replacing(volume_ply, force=force) as temporary:
        write_ply(temporary, amplitude.size, _POINT, _volume_points(amplitude, box, low, high))
    cloud = _depth_points(depth)
    with replacing(xyz_ply, force=force) as temporary:
        write_ply(temporary, len(cloud), _POINT, [cloud])
    put_frame_entry(calibration, number, entry)
    return tuple(targets)


def _depth_rows(depth: DepthMap) -> np.ndarray:
    """Return millimetres [row = y descending, column = x of radar space ascending], uint16."""
    millimetres = np.round(depth.depth_m * MM_PER_M)[::-1, ::-1]
    if not depth.mask.any():
        raise ModelError("write_products: expected an image, got one that is zero everywhere")
    low, high = np.nanmin(millimetres), np.nanmax(millimetres)
    if low < 1 or high > _MAX_16_BIT:
        checks.fail("write_products: depths", f"1 to {_MAX_16_BIT} mm", f"{low:g} to {high:g} mm")
    return np.nan_to_num(millimetres, nan=0.0).astype(np.uint16)


def _strength_rows(amplitude: np.ndarray) -> np.ndarray:
    peak = float(amplitude.max())
    if not 1 <= peak <= _MAX_16_BIT:
        checks.fail(
            "write_products: strongest pixel times frequencies times gain",
            f"1 to {_MAX_16_BIT}, which maxproj can hold (choose gain=)",
            f"{peak:g}",
        )
    return amplitude[::-1, ::-1].astype(np.uint16)


def radar_box(grid: VoxelGrid) -> GridBox:
    """Return a grid of the antenna frame in radar space."""
    x_m, y_m, z_m = grid.x_m, grid.y_m, grid.z_m
    return GridBox(
        (-float(x_m[-1]), float(y_m[0]), float(z_m[0])),
        (-float(x_m[0]), float(y_m[-1]), float(z_m[-1])),
        grid.counts,
    )


def default_grid() -> VoxelGrid:
    """Return the grid that a frame without an image names: where objects of the dataset are."""
    return VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.2, 0.6), (1e-3, 1e-3, 2e-3))


def grid_entry(grid: VoxelGrid | None = None) -> dict[str, Any]:
    """Return the entry of a frame without an image: a grid alone, `default_grid()` if not given."""
    box = radar_box(default_grid() if grid is None else grid)
    return frame_entry_json(FrameEntry(VolumeEntry(box)))


def _intrinsics(box: GridBox) -> Matrix | None:
    """Return the matrix from (x, y, z, 1) to (column, row, millimetres, 1).

    None where an axis has one pixel, so that it has no scale.
    """
    if min(box.counts[:2]) < 2:
        return None
    per_x, per_y = ((box.counts[i] - 1) / (box.high_m[i] - box.low_m[i]) for i in (0, 1))
    return (
        (per_x, 0.0, 0.0, -box.low_m[0] * per_x),
        (0.0, -per_y, 0.0, box.high_m[1] * per_y),
        (0.0, 0.0, MM_PER_M, 0.0),
        (0.0, 0.0, 0.0, 1.0),
    )


def _volume_points(
    amplitude: np.ndarray, box: GridBox, low: float, high: float
) -> Iterator[np.ndarray]:
    """Yield one row of y at a time.

    Values run from the largest y to the smallest, the y of the points that carry them the other
    way: that is how the form has it.
    """
    x_m, y_m, z_m = (box.axis_m(axis) for axis in range(3))
    step = 255.0 / (high - low) if high > low else 0.0
    for row, y in enumerate(y_m):
        values = amplitude[:, len(y_m) - 1 - row, ::-1].T  # [x of radar space, z]
        block = np.zeros(values.shape, ply_dtype(_POINT))
        block["x"] = x_m[:, None]
        block["y"] = y
        block["z"] = z_m
        block["red"] = np.round((values.astype(np.float64) - low) * step)
        yield block.ravel()


def _depth_points(depth: DepthMap) -> np.ndarray:
    """Return the points of a depth map in radar space, in the order of the image's rows."""
    turned = depth.depth_m[::-1, ::-1]
    row, column = np.nonzero(np.isfinite(turned))
    share = depth.amplitude[::-1, ::-1][row, column] / depth.amplitude.max()
    points = np.zeros(len(row), ply_dtype(_POINT))
    points["x"] = -depth.x_m[::-1][column]
    points["y"] = depth.y_m[::-1][row]
    points["z"] = turned[row, column]
    points["green"] = np.round(255.0 * share)
    return points
