"""Rigged hands from files, skinned glTF 2.0 and MANO models, posed by the poses of `clradar.hand`.

Bone axes are estimated from the joints, which also check unit and side; linear blend skinning gives
the surface; see ``docs/rigs.md``.
"""

from clradar.rigs.anatomy import UNITS_M
from clradar.rigs.mano import rotations_of_theta, theta_of_rotations
from clradar.rigs.reading import read_rig
from clradar.rigs.rig import Rig

__all__ = [
    "UNITS_M",
    "Rig",
    "read_rig",
    "rotations_of_theta",
    "theta_of_rotations",
]


def __dir__() -> list[str]:
    return sorted(__all__)
