"""Simulate, read, image and compare captures of near-field imaging radars."""

from clradar import arrays
from clradar.model import (
    AntennaArray,
    Capture,
    DepthMap,
    Paths,
    Scene,
    TraceStatistics,
    Volume,
    VoxelGrid,
    Waveform,
)

__version__ = "0.1.0"

__all__ = [
    "AntennaArray",
    "Capture",
    "DepthMap",
    "Paths",
    "Scene",
    "TraceStatistics",
    "Volume",
    "VoxelGrid",
    "Waveform",
    "__version__",
    "arrays",
]
