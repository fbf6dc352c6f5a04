"""Line a simulated image up with a measured one; find and undo a file's convention."""

# The functions take the names of their modules: `from calibration import align` gives the function.
from calibration.align import Alignment, align
from calibration.conventions import HYPOTHESES, Hypothesis, apply_convention
from calibration.diagnose import Diagnosis, Score, diagnose

__all__ = [
    "HYPOTHESES",
    "Alignment",
    "Diagnosis",
    "Hypothesis",
    "Score",
    "align",
    "apply_convention",
    "diagnose",
]
