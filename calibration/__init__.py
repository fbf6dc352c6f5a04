"""What a recording needs before it is imaged, and what lines a simulation up with it."""

# The function takes the name of its module: `from calibration import align` gives the function.
# So do `align_mesh` and `register`.
from calibration.align import align
from calibration.align_mesh import align_mesh
from calibration.alignment import Alignment
from calibration.background import average_frames, subtract_background
from calibration.gating import Gate, gate, range_gate
from calibration.register import Registration, Round, register

__all__ = [
    "Alignment",
    "Gate",
    "Registration",
    "Round",
    "align",
    "align_mesh",
    "average_frames",
    "gate",
    "range_gate",
    "register",
    "subtract_background",
]
