"""Data model: immutable, checked records that all stages exchange; none needs a device."""

from clradar.model.array import AntennaArray
from clradar.model.capture import Capture
from clradar.model.channels import ChannelCalibration, ChannelResponse
from clradar.model.grid import VoxelGrid
from clradar.model.known_materials import material
from clradar.model.material import METAL, PERFECT_CONDUCTOR, Coating, Material
from clradar.model.paths import Paths, TraceStatistics
from clradar.model.pattern import AntennaPattern
from clradar.model.permittivity import ColeCole, PermittivityTable, PowerLaw
from clradar.model.scale import ImageScale
from clradar.model.scene import Scene
from clradar.model.spread import Spread
from clradar.model.volume import DepthMap, Volume
from clradar.model.waveform import Waveform

__all__ = [
    "METAL",
    "PERFECT_CONDUCTOR",
    "AntennaArray",
    "AntennaPattern",
    "Capture",
    "ChannelCalibration",
    "ChannelResponse",
    "Coating",
    "ColeCole",
    "DepthMap",
    "ImageScale",
    "Material",
    "Paths",
    "PermittivityTable",
    "PowerLaw",
    "Scene",
    "Spread",
    "TraceStatistics",
    "Volume",
    "VoxelGrid",
    "Waveform",
    "material",
]


def __dir__() -> list[str]:
    return sorted(__all__)
