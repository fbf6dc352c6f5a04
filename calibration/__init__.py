"""What a recording needs before it is imaged, and what lines a simulation up with it."""

# The function takes the name of its module: `from calibration import align` gives the function.
from calibration.align import Alignment, align
from calibration.background import average_frames, subtract_background
from calibration.gating import Gate, gate, range_gate

__all__ = [
    "Alignment",
    "Gate",
    "align",
    "average_frames",
    "gate",
    "range_gate",
    "subtract_background",
]
