"""How far measured ranges scatter about those of the surface, from the image itself."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from calibration.registration.mesh_rendering import MeasuredImage

RANGE_STD_M, RANGE_HALF_POWER = 0.8e-3, 0.066
"""Scatter of the range of bright pixels, and the power at which its variance is doubled."""

ROUGH_SHARE, ROUGH_M = 1.39, 2e-3
"""Neighbours within so many metres scatter about their plane, and the range scatters about the
surface by so many times that: where parts lie behind each other the brighter one is measured, and
speckle that moves the range changes from cell to cell. Share and half power are the most likely
ones of 14 656 pixels of 14 synthetic hands in the true pose; the likelihood of a pixel rises by
0.29 over that of a scatter that depends on the power alone."""


def range_scatter_m(measured: MeasuredImage) -> np.ndarray:
    """Standard deviation of the measured range about that of the surface, (n_y, n_x), metres."""
    smooth = RANGE_STD_M**2 * (1.0 + RANGE_HALF_POWER / np.maximum(measured.power, 1e-4))
    return np.sqrt(smooth + (ROUGH_SHARE * roughness_m(measured)) ** 2)


def roughness_m(measured: MeasuredImage) -> np.ndarray:
    """Standard deviation of the neighbours' range about their plane, weighted by power, (n_y, n_x),
    metres."""
    known = np.isfinite(measured.range_m)
    weight = np.where(known, measured.power, 0.0)
    range_m = np.where(known, measured.range_m - np.nanmedian(measured.range_m), 0.0)
    width = [ROUGH_M / step_m for step_m in reversed(measured.step_m)]
    total = ndimage.gaussian_filter(weight, width) + 1e-12

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.gaussian_filter(weight * values, width) / total

    y, x = np.mgrid[: range_m.shape[0], : range_m.shape[1]].astype(np.float64)
    at_x, at_y, at_range = mean(x), mean(y), mean(range_m)
    xx, yy, xy = mean(x * x) - at_x**2, mean(y * y) - at_y**2, mean(x * y) - at_x * at_y
    xr, yr = mean(x * range_m) - at_x * at_range, mean(y * range_m) - at_y * at_range
    determinant = np.maximum(xx * yy - xy**2, 1e-6)
    on_plane = (xr * (xr * yy - yr * xy) + yr * (yr * xx - xr * xy)) / determinant
    left: np.ndarray = np.maximum(mean(range_m**2) - at_range**2 - on_plane, 0.0)
    return np.sqrt(left)
