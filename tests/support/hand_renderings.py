"""Pictures of hands as the fit renders them, to be fitted."""

from __future__ import annotations

import numpy as np

from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_rendering import HandRendering
from calibration.hand_fit.hand_state import HandState
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.mesh_rendering import Aperture, MeasuredImage
from clradar import DepthMap
from clradar.hand import HandPose, HandShape
from clradar.hand.shape import AVERAGE
from clradar.opencl import open_device


def state_of(pose: HandPose, model: HandModel, shape: HandShape = AVERAGE) -> HandState:
    """A hand 30 cm in front of the radar."""
    transform = np.eye(4)
    transform[:3, 3] = [0.0, -0.09, 0.3]
    return HandState(pose, shape, transform)


def rendered_depth(model: HandModel, state: HandState, aperture: Aperture) -> DepthMap:
    """The picture that the rendering itself has of a hand."""
    axis_m = np.arange(-55, 56) * 2e-3
    blank = MeasuredImage(
        axis_m, axis_m, np.ones((111, 111)), np.full((111, 111), 0.3), (2e-3, 2e-3)
    )
    picture = HandRendering(model, blank, aperture, open_device("pocl"))
    picture.draw_surface(state, seed=7)
    power, range_m = picture.render(state, initial_log_brightness())
    x, y = np.meshgrid(axis_m, axis_m)
    lit = power > 1e-2 * power.max()
    depth_m = np.where(lit, np.sqrt(np.maximum(range_m**2 - x**2 - y**2, 0.0)), np.nan)
    return DepthMap(depth_m, np.sqrt(power / power.max()), axis_m, axis_m, 20.0)
