__version__: str

from . import (
    arrays as arrays,
    dataset as dataset,
    hand as hand,
    model as model,
    opencl as opencl,
    plot as plot,
    report as report,
    rigs as rigs,
    view as view,
)
from .backproject import backproject as backproject
from .compare.metrics import Metrics as Metrics, compare as compare
from .compare.spread import spread as spread
from .dataset.readers import open_dataset as open_dataset
from .errors import (
    CalibrationError as CalibrationError,
    ClradarError as ClradarError,
    ClradarWarning as ClradarWarning,
    ClusterError as ClusterError,
    CompareError as CompareError,
    DeviceError as DeviceError,
    MeasurementError as MeasurementError,
    MeshError as MeshError,
    MissingPackage as MissingPackage,
    ModelError as ModelError,
    OutputError as OutputError,
    PackageError as PackageError,
    RigError as RigError,
)
from .imaging.frame_imager import FrameImager as FrameImager
from .imaging.operator import ImagingOperator as ImagingOperator, forward as forward
from .imaging.placement import place_grid as place_grid
from .imaging.reconstruction import reconstruct as reconstruct
from .impairments.channel_errors import draw_channels as draw_channels
from .impairments.impair import Wall as Wall, impair as impair, room_capture as room_capture
from .jobs.where import map_devices as map_devices
from .model import (
    METAL as METAL,
    AntennaArray as AntennaArray,
    AntennaPattern as AntennaPattern,
    Capture as Capture,
    ChannelCalibration as ChannelCalibration,
    ChannelResponse as ChannelResponse,
    Coating as Coating,
    ColeCole as ColeCole,
    DepthMap as DepthMap,
    Material as Material,
    Paths as Paths,
    PermittivityTable as PermittivityTable,
    PowerLaw as PowerLaw,
    Scene as Scene,
    Spread as Spread,
    TraceStatistics as TraceStatistics,
    Volume as Volume,
    VoxelGrid as VoxelGrid,
    Waveform as Waveform,
    material as material,
)
from .model.material_file import (
    read_materials as read_materials,
    write_materials as write_materials,
)
from .motion.hands import MovingHand as MovingHand
from .motion.instants import SweepTiming as SweepTiming
from .motion.motion_file import read_motion as read_motion
from .motion.rigid import MovingBody as MovingBody, RigidMotion as RigidMotion
from .motion.sweep import MovingScene as MovingScene, simulate_moving as simulate_moving
from .opencl import Device as Device, list_devices as list_devices, open_device as open_device
from .simulation import simulate as simulate, simulate_image as simulate_image
from .synthesize import synthesize as synthesize
from .trace import trace as trace
from .tracing.settings import SimulationSettings as SimulationSettings
