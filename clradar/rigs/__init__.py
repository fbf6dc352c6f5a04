"""Rigged hands that users bring: skinned glTF files and MANO models, posed by the same poses."""

from clradar.rigs.anatomy import UNITS_M
from clradar.rigs.mano import rotations_of_theta, theta_of_components, theta_of_rotations
from clradar.rigs.names import read_mapping
from clradar.rigs.reading import read_rig
from clradar.rigs.rig import Rig

__all__ = [
    "UNITS_M",
    "Rig",
    "read_mapping",
    "read_rig",
    "rotations_of_theta",
    "theta_of_components",
    "theta_of_rotations",
]
