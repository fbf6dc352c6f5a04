"""Line a simulated image up with a measured one."""

# The function takes the name of its module: `from calibration import align` gives the function.
from calibration.align import Alignment, align

__all__ = ["Alignment", "align"]
