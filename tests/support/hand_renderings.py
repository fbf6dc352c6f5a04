"""Pictures of hands as the fit renders them, to be fitted."""

from typing import Any

import numpy as np

from calibration.hand_fit.descent import HandFitter, fitted_parameters
from calibration.hand_fit.hand_model import HandModel, ParametricHand
from calibration.hand_fit.hand_rendering import HandRendering
from calibration.hand_fit.hand_state import HandState
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.mesh_rendering import Aperture, MeasuredImage
from clradar import DepthMap, arrays
from clradar.hand import HandPose, HandShape
from clradar.hand.shape import AVERAGE
from clradar.opencl import open_device

APERTURE = Aperture(arrays.qar50(), 77e9)
TIPS = [4, 9, 14, 19, 24]


def fitter_on(
    depth: DepthMap, model: HandModel | None = None, *, shape: bool = False, **options: Any
) -> HandFitter:
    """A fit of the right hand, or of a model, to an image."""
    model = ParametricHand("right", "pocl") if model is None else model
    fitted = fitted_parameters(shape)
    return HandFitter(model, depth, APERTURE, open_device("pocl"), fitted, **options)


def state_of(pose: HandPose, model: HandModel, shape: HandShape = AVERAGE) -> HandState:
    """A hand 30 cm in front of the radar."""
    transform = np.eye(4)
    transform[:3, 3] = [0.0, -0.09, 0.3]
    return HandState(pose, shape, transform)


def rendered_depth(model: HandModel, state: HandState, step_m: float = 2e-3) -> DepthMap:
    """The picture that the rendering itself has of a hand, 0.22 m wide."""
    n = int(0.11 / step_m)
    axis_m = np.arange(-n, n + 1) * step_m
    x, y = np.meshgrid(axis_m, axis_m)
    median_m = 0.3
    for _ in range(2):  # seen from the hand's range, which the first tells
        blank = MeasuredImage(
            axis_m, axis_m, np.ones_like(x), np.full_like(x, median_m), (step_m, step_m)
        )
        picture = HandRendering(model, blank, APERTURE, open_device("pocl"))
        picture.draw_surface(state, seed=7)
        power, range_m = picture.render(state, initial_log_brightness())
        lit = power > 1e-2 * power.max()
        median_m = float(np.median(range_m[lit]))
    depth_m = np.where(lit, np.sqrt(np.maximum(range_m**2 - x**2 - y**2, 0.0)), np.nan)
    return DepthMap(depth_m, np.sqrt(power / power.max()), axis_m, axis_m, 20.0)
