"""Simulate, read, image and compare captures of near-field imaging radars."""

from clradar import arrays
from clradar.backproject import backproject
from clradar.compare import Metrics, compare
from clradar.model import (
    AntennaArray,
    Capture,
    ChannelCalibration,
    ChannelResponse,
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
    "ChannelCalibration",
    "ChannelResponse",
    "DepthMap",
    "Device",
    "Metrics",
    "Paths",
    "Scene",
    "TraceStatistics",
    "Volume",
    "VoxelGrid",
    "Waveform",
    "__version__",
    "arrays",
    "backproject",
    "compare",
    "list_devices",
    "open_device",
    "simulate",
    "synthesize",
    "trace",
]
