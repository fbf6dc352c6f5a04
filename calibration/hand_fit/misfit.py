"""Robust deviance of a rendering from a measured image, in units of a log likelihood.

Brightness has the exponential distribution of speckle, ranges scatter about the surface; both with
bounded influence. Its gradient is the score of `calibration.registration.mesh_fit`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.hand_fit.hand_rendering import HandRendering
from calibration.registration.mesh_fit import (
    CAUCHY_SCALE,
    POWER_FLOOR,
    TUKEY_CUTOFF,
    Residuals,
    cell_pixels,
    residuals,
)
from calibration.registration.mesh_rendering import Pixels

RANGE_CELLS = 2.0
"""Residuals of range are alike over so many resolution cells: in simulations of hands the integral
of their correlation is 9 to 13 pixels of 2 mm, and a cell has 4.6."""


def misfit(canvas: HandRendering, rendered: Pixels, range_scale: float = 1.0) -> Residuals:
    """Residuals of the measured image, with a scatter of ranges that is so many times larger."""
    found = residuals(canvas, *rendered)
    return replace(found, range_std_m=range_scale * canvas.range_std_m)


def deviance_map(canvas: HandRendering, rendered: Pixels, found: Residuals) -> np.ndarray:
    """What every pixel contributes, (n_y, n_x), before the division by pixels per cell.

    With u = (m + f) / (I + f) of the measured power m, the rendered I and the floor f, s = u - 1
    and c = `CAUCHY_SCALE`, brightness contributes c^2 / (1 + c^2) (-ln u + ln(1 + s^2 / c^2) / 2 +
    c atan(s / c)): its derivative by ln I is -s / (1 + s^2 / c^2).
    """
    c = CAUCHY_SCALE
    ratio = (canvas.power + POWER_FLOOR) / (rendered[0] + POWER_FLOOR)
    s = ratio - 1.0
    speckle = -np.log(ratio) + 0.5 * np.log1p((s / c) ** 2) + c * np.arctan(s / c)
    inside = np.maximum(1.0 - (found.range_m / found.range_std_m / TUKEY_CUTOFF) ** 2, 0.0)
    # A measured pixel that the hand does not cover costs as much as an outlier.
    off = TUKEY_CUTOFF**2 / 6.0 * (1.0 - found.covered * inside**3) / RANGE_CELLS
    return c**2 / (1.0 + c**2) * speckle + np.where(found.measured, off, 0.0)


def deviance(
    canvas: HandRendering,
    rendered: Pixels,
    range_scale: float = 1.0,
    covered: np.ndarray | None = None,
) -> float:
    """Sum over the pixels, where those of a resolution cell count as one.

    `covered`, (n_y, n_x), in place of that of the rendering.
    """
    found = misfit(canvas, rendered, range_scale)
    if covered is not None:
        found = replace(found, covered=covered)
    return float(deviance_map(canvas, rendered, found).sum()) / cell_pixels(canvas)
