"""OpenCL devices, kernel sources, programs and buffers.

No other package imports pyopencl.
"""

from clradar.opencl.buffers import Buffers
from clradar.opencl.choice import cpu_beside, devices_like, open_device
from clradar.opencl.device import Device, DeviceInfo, forget_devices, list_devices
from clradar.opencl.program import Program, build
from clradar.opencl.several_devices import Devices, map_devices, open_devices

__all__ = [
    "Buffers",
    "Device",
    "DeviceInfo",
    "Devices",
    "Program",
    "build",
    "cpu_beside",
    "devices_like",
    "forget_devices",
    "list_devices",
    "map_devices",
    "open_device",
    "open_devices",
]


def __dir__() -> list[str]:
    return sorted(__all__)
