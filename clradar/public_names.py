"""The public names of `clradar` and what they stand for, imported on first use of one."""

from clradar import arrays
from clradar.backproject import backproject
from clradar.compare import Metrics, compare, spread
from clradar.errors import (
    CalibrationError,
    ClradarError,
    ClradarWarning,
    ClusterError,
    CompareError,
    DeviceError,
    MeasurementError,
    MeshError,
    MissingPackage,
    ModelError,
    OutputError,
    PackageError,
    RigError,
)
from clradar.imaging.frame_imager import FrameImager
from clradar.imaging.operator import ImagingOperator, forward
from clradar.imaging.placement import place_grid
from clradar.imaging.reconstruction import reconstruct
from clradar.impairments.channel_errors import draw_channels
from clradar.impairments.environment import Wall, room_capture
from clradar.impairments.impair import impair
from clradar.jobs.where import map_devices
from clradar.model import (
    METAL,
    AntennaArray,
    AntennaPattern,
    Capture,
    ChannelCalibration,
    ChannelResponse,
    Coating,
    ColeCole,
    DepthMap,
    Material,
    Paths,
    PermittivityTable,
    PowerLaw,
    Scene,
    Spread,
    TraceStatistics,
    Volume,
    VoxelGrid,
    Waveform,
    material,
)
from clradar.model.material_file import read_materials, write_materials
from clradar.motion.bodies import MovingBody, MovingScene
from clradar.motion.hands import MovingHand
from clradar.motion.motion_file import read_motion
from clradar.motion.rigid import RigidMotion
from clradar.motion.sweep import simulate_moving
from clradar.motion.timing import SweepTiming
from clradar.opencl import Device, list_devices, open_device
from clradar.simulation import simulate, simulate_image
from clradar.synthesize import synthesize
from clradar.trace import trace
from clradar.tracing.settings import SimulationSettings

__all__ = [
    "METAL",
    "AntennaArray",
    "AntennaPattern",
    "CalibrationError",
    "Capture",
    "ChannelCalibration",
    "ChannelResponse",
    "ClradarError",
    "ClradarWarning",
    "ClusterError",
    "Coating",
    "ColeCole",
    "CompareError",
    "DepthMap",
    "Device",
    "DeviceError",
    "FrameImager",
    "ImagingOperator",
    "Material",
    "MeasurementError",
    "MeshError",
    "Metrics",
    "MissingPackage",
    "ModelError",
    "MovingBody",
    "MovingHand",
    "MovingScene",
    "OutputError",
    "PackageError",
    "Paths",
    "PermittivityTable",
    "PowerLaw",
    "RigError",
    "RigidMotion",
    "Scene",
    "SimulationSettings",
    "Spread",
    "SweepTiming",
    "TraceStatistics",
    "Volume",
    "VoxelGrid",
    "Wall",
    "Waveform",
    "arrays",
    "backproject",
    "compare",
    "draw_channels",
    "forward",
    "impair",
    "list_devices",
    "map_devices",
    "material",
    "open_device",
    "place_grid",
    "read_materials",
    "read_motion",
    "reconstruct",
    "room_capture",
    "simulate",
    "simulate_image",
    "simulate_moving",
    "spread",
    "synthesize",
    "trace",
    "write_materials",
]
