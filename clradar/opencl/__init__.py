"""OpenCL devices, kernel sources, programs and buffers.

No other package imports pyopencl.
"""

from clradar.opencl.buffers import Buffers
from clradar.opencl.choice import cpu_beside, devices_like, open_device
from clradar.opencl.device import Device, DeviceInfo, forget_devices, list_devices
from clradar.opencl.program import Program, build

__all__ = [
    "Buffers",
    "Device",
    "DeviceInfo",
    "Program",
    "build",
    "cpu_beside",
    "devices_like",
    "forget_devices",
    "list_devices",
    "open_device",
]


def __dir__() -> list[str]:
    return sorted(__all__)
