"""OpenCL devices, kernel sources, programs and buffers; the only importer of pyopencl."""

from clradar.opencl.buffers import Buffers as Buffers
from clradar.opencl.choice import (
    cpu_beside as cpu_beside,
    devices_like as devices_like,
    open_device as open_device,
)
from clradar.opencl.device import (
    Device as Device,
    DeviceInfo,
    forget_devices,
    list_devices as list_devices,
)
from clradar.opencl.program import Program as Program, build as build

__all__ = ["DeviceInfo", "forget_devices"]


def __dir__() -> list[str]:
    return sorted(__all__)
