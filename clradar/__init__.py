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
from clradar.opencl import Device, list_devices, open_device
from clradar.synthesize import simulate, synthesize
from clradar.trace import trace

__version__ = "0.1.0"

__all__ = [
    "AntennaArray",
    "Capture",
    "DepthMap",
    "Device",
    "Paths",
    "Scene",
    "TraceStatistics",
    "Volume",
    "VoxelGrid",
    "Waveform",
    "__version__",
    "arrays",
    "list_devices",
    "open_device",
    "simulate",
    "synthesize",
    "trace",
]
