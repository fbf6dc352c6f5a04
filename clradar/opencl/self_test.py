"""A test of an opened device that takes milliseconds: does it build, run, copy and round right?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakSet

import numpy as np

from clradar.errors import DeviceError
from clradar.opencl.buffers import Buffers
from clradar.opencl.device import Device
from clradar.opencl.double_single import hi_lo

N = 64
"""Vectors: a whole number of work-groups of any width."""

LENGTH_ERROR = 2.0**-41
"""Largest relative error of `dual_length` (``common/phase.h``) with the roundings OpenCL allows.

A square root may err by 3 units in the last place, so with the roundings of its argument the
correction is up to d = 4.25 * 2^-23 of the length. One Newton step leaves d^2 / 2 = 0.56 * 2^-42;
its quotient, good to 2.5 units, 0.66 * 2^-42; the sums and products before it 0.53 * 2^-42.
"""


@dataclass(frozen=True, slots=True)
class _Width:
    width: int


def self_test(device: Device, compiled: Callable[[Device, str, Any], Any]) -> None:
    """Compare a device's exact float32 arithmetic with float64, once.

    Products and sums as two float32 are exact only if each step rounds to nearest and none is
    fused or reordered, which a compiler may do by itself.
    """
    key = ("self_test.cl", _Width(device.width))
    with device.lock:
        if key not in device.programs:
            device.programs[key] = _tested(device, key, compiled)


def _tested(device: Device, key: tuple[str, Any], compiled: Callable[..., Any]) -> Any:
    # The caller's memory limit is not for this.
    apart = replace(device, budget_bytes=2**20, buffers=WeakSet())
    program = compiled(apart, *key)
    vectors = _vectors()
    with Buffers(apart) as buffers:
        out = buffers.empty(vectors.nbytes)
        program.launch(
            "dual_numbers", (N // device.width,), np.uint32(N), buffers.upload(vectors), out
        )
        found = buffers.read(out, vectors.shape, np.float32)
    _compare(device, vectors, found)
    return program


def _vectors() -> np.ndarray:
    """Vectors of 0.2 mm to 16 m a component, float32 of shape (3, 2, N) as x, y, z and hi, lo.

    Their products and sums fit in float64, and no step comes near the smallest float32.
    """
    rng = np.random.default_rng(1)
    size = 2.0 ** rng.uniform(-12, 4, (3, N))
    return np.stack(hi_lo(size * rng.choice([-1, 1], size.shape)), axis=1)


def _compare(device: Device, vectors: np.ndarray, found: np.ndarray) -> None:
    x, y = vectors[:2, 0].astype(np.float64)
    lengths = np.linalg.norm(vectors.astype(np.float64).sum(axis=1), axis=0)
    exact = np.stack([x * y, x + y, lengths])
    expected = np.stack(hi_lo(exact), axis=1)
    wrong = (found != expected).any(axis=1)
    error = np.abs(found[2].astype(np.float64).sum(axis=0) - lengths)
    wrong[2] = ~(error <= LENGTH_ERROR * lengths)
    if not wrong.any():
        return
    which, at = np.argwhere(wrong)[0]
    numbers = " and ".join(f"{v:.9g}" for v in vectors[:2, 0, at])
    what = (f"product of {numbers}", f"sum of {numbers}", "length of a vector")[which]
    want, got = (f"{hi:.9g} + {lo:.9g}" for hi, lo in (expected[which, :, at], found[which, :, at]))
    raise DeviceError(
        f"device {device.info.label}, driver {device.info.version}: expected {want} as the {what}, "
        f"found {got} ({int(wrong.sum())} of {wrong.size} results are wrong); its compiler changes "
        "float32 arithmetic that must be exact: use another version of the driver, or another "
        "device, see `clradar devices`"
    )
