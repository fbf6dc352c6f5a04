from .anatomy import UNITS_M as UNITS_M
from .mano import rotations_of_theta as rotations_of_theta
from .reading import read_rig as read_rig
from .rig import Rig as Rig
