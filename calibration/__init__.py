"""What a recording needs before it is imaged, and what lines a simulation up with it."""

# Functions take the names of their modules: `from calibration import align` gives the function.
from calibration.align_images import align
from calibration.align_mesh import align_mesh
from calibration.alignment import Alignment
from calibration.alpha_estimate import AlphaEstimate
from calibration.alpha_regions import RegionSweep
from calibration.alpha_sweep import Sweep, sweep
from calibration.closed_loop import Round
from calibration.conventions import HYPOTHESES, Hypothesis, apply_convention
from calibration.correction import correct
from calibration.diagnose import Diagnosis, Score, diagnose
from calibration.estimate_channels import estimate_channels
from calibration.gating import Gate, gate, range_gate
from calibration.regions import Regions
from calibration.register import Registration, register
from calibration.subtraction import average_frames, subtract_background
from calibration.targets import CornerReflector, Echo, FlatPlate, Sphere, Target, response

__all__ = [
    "HYPOTHESES",
    "Alignment",
    "AlphaEstimate",
    "CornerReflector",
    "Diagnosis",
    "Echo",
    "FlatPlate",
    "Gate",
    "Hypothesis",
    "RegionSweep",
    "Regions",
    "Registration",
    "Round",
    "Score",
    "Sphere",
    "Sweep",
    "Target",
    "align",
    "align_mesh",
    "apply_convention",
    "average_frames",
    "correct",
    "diagnose",
    "estimate_channels",
    "gate",
    "range_gate",
    "register",
    "response",
    "subtract_background",
    "sweep",
]
