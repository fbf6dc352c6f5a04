"""Rigged hands that users bring: skinned glTF files and MANO models, posed by the same poses."""

from clradar.rigs.anatomy import UNITS_M
from clradar.rigs.reading import read_rig
from clradar.rigs.rig import Rig

__all__ = ["UNITS_M", "Rig", "read_rig"]
