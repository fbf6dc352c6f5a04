"""What a recording needs before it is imaged, and what lines a simulation up with it."""

# The function takes the name of its module: `from calibration import align` gives the function.
from calibration.align import Alignment, align
from calibration.background import average_frames, subtract_background
from calibration.channels import estimate_channels
from calibration.correction import correct
from calibration.gating import Gate, gate, range_gate
from calibration.targets import CornerReflector, Echo, FlatPlate, Sphere, Target, response

__all__ = [
    "Alignment",
    "CornerReflector",
    "Echo",
    "FlatPlate",
    "Gate",
    "Sphere",
    "Target",
    "align",
    "average_frames",
    "correct",
    "estimate_channels",
    "gate",
    "range_gate",
    "response",
    "subtract_background",
]
