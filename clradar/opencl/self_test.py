"""A test of an opened device that takes milliseconds: does it build, run and copy as it should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.errors import DeviceError
from clradar.opencl.buffers import Buffers
from clradar.opencl.device import Device
from clradar.opencl.program import build

N_PIXELS, N_Z = 1000, 5


@dataclass(frozen=True, slots=True)
class _Width:
    width: int


def self_test(device: Device) -> None:
    """Run a kernel on whole numbers, whose results are exact.

    Raises
    ------
    DeviceError
        It does not build or run, or its results are wrong.

    Examples
    --------
    >>> from clradar.opencl import open_device
    >>> from clradar.opencl.self_test import self_test
    >>> self_test(open_device("pocl"))
    """
    z, pixel = np.mgrid[:N_Z, :N_PIXELS]
    volume = np.zeros((2, N_Z, N_PIXELS), np.float32)
    volume[0] = (pixel * 7 + z * 13) % 31
    expected = volume[0].argmax(axis=0)
    with Buffers(device) as buffers:
        padded = np.append(volume.ravel(), np.zeros(device.width, np.float32))
        top, values = buffers.zeros(4 * N_PIXELS), buffers.zeros(24 * N_PIXELS)
        build(device, "depth.cl", _Width(device.width)).launch(
            "strongest_along_z", (-(-N_PIXELS // device.width),), np.uint32(N_PIXELS),
            np.uint32(N_PIXELS), np.uint32(N_Z), np.float32(1), buffers.upload(padded), top, values,
        )  # fmt: skip
        found = buffers.read(top, N_PIXELS, np.int32)
    wrong = int(np.count_nonzero(found != expected))
    if wrong:
        raise DeviceError(
            f"device {device.info.label}: its self-test gives {wrong} of {N_PIXELS} wrong results; "
            "update its driver, or choose other devices, see `clradar devices`"
        )
