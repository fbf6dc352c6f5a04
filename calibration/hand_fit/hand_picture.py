"""A hand's image without its place, size of pixels and level: what is learned from."""

from __future__ import annotations

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap

PIXELS, PIXEL_M = 40, 5e-3
"""A square of 200 mm: a hand, or its part next to the radar where it is longer."""

BRIGHTNESS_DB, MASK_DB = 25.0, 20.0
"""Range of brightness; depths count where the image is within the second, as in the fit."""

DEPTH_M = 0.04
"""Depth relative to the middle is divided by it, and cut at twice as much."""

LEAST_SHARE = 0.1
"""Added to the share of a pixel that has a depth, so that few depths fade out."""


def hand_picture(depth: DepthMap, handedness: str = "right") -> np.ndarray:
    """Return the picture of a hand, as if it were a right one in the middle.

    Parameters
    ----------
    depth : DepthMap
    handedness : "right" or "left"
        The mirror image of a left hand is a right one.

    Returns
    -------
    ndarray, shape (3, PIXELS, PIXELS), float32
        Brightness from 0 (`BRIGHTNESS_DB` below the maximum) to 1; depth behind the middle in units
        of `DEPTH_M`; share of depths. Rows and columns are y and x, ascending. The middle is the
        medians of x, y and z, weighted by the amplitude. All is blurred by a pixel.

    Raises
    ------
    CompareError
        The image is dark or has no depths.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    amplitude = depth.amplitude.astype(np.float64)
    peak = amplitude.max()
    seen = depth.mask & (amplitude >= peak * 10 ** (-MASK_DB / 20))
    if not (peak > 0 and seen.any()):
        raise CompareError("could not look for a hand, because the image is empty")
    rows, columns = np.nonzero(seen)
    weights = amplitude[seen]
    middle_m = [
        _weighted_median(values, weights)
        for values in (depth.x_m[columns], depth.y_m[rows], depth.depth_m[seen])
    ]
    bright = 20 * np.log10(np.maximum(amplitude / peak, 1e-9))
    bright = np.clip(1 + bright / BRIGHTNESS_DB, 0, 1)
    behind = np.clip((depth.depth_m - middle_m[2]) / DEPTH_M, -2, 2)
    layers = (bright, np.where(seen, behind, 0.0), seen.astype(np.float64))
    offsets_m = (np.arange(PIXELS) - (PIXELS - 1) / 2) * PIXEL_M
    across_m = offsets_m if handedness == "right" else -offsets_m
    at = np.meshgrid(
        _index_of(depth.y_m, middle_m[1] + offsets_m),
        _index_of(depth.x_m, middle_m[0] + across_m),
        indexing="ij",
    )
    blur = [PIXEL_M / _step_m(axis_m) for axis_m in (depth.y_m, depth.x_m)]
    brightness, behind, share = (
        map_coordinates(gaussian_filter(layer, blur, mode="constant"), at, order=1, cval=0.0)
        for layer in layers
    )
    return np.array([brightness, behind / (share + LEAST_SHARE), share], np.float32)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, below[-1] / 2)])


def _step_m(axis_m: np.ndarray) -> float:
    return float(np.ptp(axis_m) / max(len(axis_m) - 1, 1)) or PIXEL_M


def _index_of(axis_m: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Fractional indices; outside the axis they are, so that nothing is seen there."""
    found = np.interp(at_m, axis_m, np.arange(len(axis_m)), left=-2.0, right=len(axis_m) + 1.0)
    return np.asarray(found)
