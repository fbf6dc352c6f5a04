"""Bring a recording and a simulation together: calibrated channels, aligned images."""

# The function takes the name of its module: `from calibration import align` gives the function.
from calibration.align import Alignment, align
from calibration.channels import estimate_channels
from calibration.correction import correct
from calibration.targets import CornerReflector, Echo, FlatPlate, Sphere, Target, response

__all__ = [
    "Alignment",
    "CornerReflector",
    "Echo",
    "FlatPlate",
    "Sphere",
    "Target",
    "align",
    "correct",
    "estimate_channels",
    "response",
]
