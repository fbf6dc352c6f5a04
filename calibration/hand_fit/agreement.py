"""Whether the ranges of a fit are off by more than cells that scatter independently leave."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from calibration.hand_fit.hand_rendering import HandRendering
from calibration.hand_fit.misfit import RANGE_CELLS, misfit
from calibration.registration.mesh_fit import TUKEY_CUTOFF, cell_pixels
from calibration.registration.mesh_rendering import Pixels

FINGER_M = 8e-3
"""Standard deviation of the window that residuals are averaged in, half the breadth of a finger."""


def range_ratio(canvas: HandRendering, rendered: Pixels) -> float:
    """Birge's ratio of the ranges of a rendering: `smoothed_ratio` of their residuals.

    Of brightness there is none: speckle differs from skin to skin, and the ranges of hands in
    wrong places were off by ten times as much as those of hands in their right ones.
    """
    found = misfit(canvas, rendered)
    residual = np.clip(found.range_m / found.range_std_m, -TUKEY_CUTOFF, TUKEY_CUTOFF)
    weight = np.where(found.measured, found.covered, 0.0)
    width = FINGER_M / np.array(canvas.measured.step_m[::-1])
    return smoothed_ratio(residual, weight, width, RANGE_CELLS * cell_pixels(canvas))


def smoothed_ratio(
    residual: np.ndarray, weight: np.ndarray, width: np.ndarray, pixels: float
) -> float:
    """Variance of residuals averaged in a window, relative to that of independent ones.

    Of residuals in units of their standard deviation and their weights, both (n_y, n_x), and a
    Gaussian window with standard deviations `width`, (2,), in pixels, so many `pixels` of which are
    alike: sum w r^2 / sum w v with the window's mean r = G(w z) / G(w) and the variance that
    independent z leave it, v = pixels G^2(w^2) / G(w)^2. It is 1 where the surface is the measured
    one, and larger where whole parts of it are elsewhere.
    """

    def averaged(values: np.ndarray, width: np.ndarray) -> np.ndarray:
        return ndimage.gaussian_filter(values, width, mode="constant")

    total = np.maximum(averaged(weight, width), 1e-12)
    mean = averaged(weight * residual, width) / total
    # A squared Gaussian is one that is narrower by the root of two.
    squares = averaged(weight**2, width / np.sqrt(2.0)) / (4.0 * np.pi * width.prod())
    expected = pixels * squares / total**2
    return float((weight * mean**2).sum() / max(float((weight * expected).sum()), 1e-12))
