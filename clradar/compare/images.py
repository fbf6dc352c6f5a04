"""Images that are compared: depth maps of one dynamic range on the same pixels."""

from __future__ import annotations

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks

SAME_PIXEL_TOLERANCE_M = 1e-7
"""Pixel centres closer than this are the same, as in `VoxelGrid.same_voxels`."""


def depth_map_of(image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthMap:
    """Return the depth map of an image, cut (again) at `dynamic_range_db`; errors name `label`."""
    if isinstance(image, Volume):
        image = image.depth_map(dynamic_range_db)
    elif not isinstance(image, DepthMap):
        raise CompareError(f"{label}: expected a Volume or a DepthMap, got {type(image).__name__}")
    peak = image.amplitude.max()
    if peak <= 0:
        raise CompareError(f"{label}: expected an amplitude above 0 somewhere, got 0 everywhere")
    if image.dynamic_range_db < dynamic_range_db:
        raise CompareError(
            f"{label}: expected depths down to {dynamic_range_db:g} dB below the maximum, got a "
            f"depth map that was cut at {image.dynamic_range_db:g} dB"
        )
    # The same expression as in Volume.depth_map, so that both cuts agree to the pixel.
    threshold = peak * 10.0 ** (-dynamic_range_db / 20.0)
    kept = image.mask & (image.amplitude >= threshold) & (image.amplitude > 0)
    if not kept.any():
        raise CompareError(
            f"{label}: expected a depth somewhere within {dynamic_range_db:g} dB of the maximum, "
            "got none"
        )
    depth_m = np.where(kept, image.depth_m, np.nan)
    return DepthMap(depth_m, image.amplitude, image.x_m, image.y_m, dynamic_range_db)


def clipped_db(image: DepthMap) -> np.ndarray:
    """Return the amplitude in dB relative to its maximum (above 0), clipped at the range."""
    amplitude = image.amplitude.astype(np.float64)
    floor = 10.0 ** (-image.dynamic_range_db / 20.0)
    # Clipped before the logarithm, which has no value at 0, and after it, because of its rounding.
    level_db = 20.0 * np.log10(np.maximum(amplitude / amplitude.max(), floor))
    return np.clip(level_db, -image.dynamic_range_db, 0.0)


def cut_pair(
    name: str,
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    dynamic_range_db: float,
) -> tuple[DepthMap, DepthMap]:
    """Return the depth maps of two images on the same pixels; errors of the range have `name`."""
    dynamic_range_db = checks.dynamic_range(f"{name}: dynamic_range_db", dynamic_range_db)
    first = depth_map_of(measured, dynamic_range_db, "measured image")
    second = depth_map_of(simulated, dynamic_range_db, "simulated image")
    check_same_pixels(first, second)
    return first, second


def check_same_pixels(measured: DepthMap, simulated: DepthMap) -> None:
    pairs = ((measured.x_m, simulated.x_m), (measured.y_m, simulated.y_m))
    if all(len(a) == len(b) and np.abs(a - b).max() <= SAME_PIXEL_TOLERANCE_M for a, b in pairs):
        return
    raise CompareError(
        f"compare: expected both images on the same pixels along x and y, got "
        f"{_pixels_text(measured)} measured and {_pixels_text(simulated)} simulated; form both "
        "on one grid"
    )


def _pixels_text(image: DepthMap) -> str:
    # Nine digits show any difference beyond the tolerance.
    axes = (
        f"{name} = {1e3 * axis_m[0]:.9g} to {1e3 * axis_m[-1]:.9g} mm in {len(axis_m)}"
        for name, axis_m in (("x", image.x_m), ("y", image.y_m))
    )
    return f"({', '.join(axes)})"
