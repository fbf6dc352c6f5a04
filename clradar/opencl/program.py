"""Building programs, launching kernels and testing devices; errors name device and remedy."""

from __future__ import annotations

import itertools
import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakSet

import numpy as np
import pyopencl as cl

from clradar.errors import DeviceError
from clradar.opencl.buffers import Buffers, hi_lo
from clradar.opencl.device import INSTALL_HINT, Device, check_process
from clradar.opencl.sources import source

CACHE_FAILURE = "PYOPENCL_CACHE_FAILURE_FATAL"
"""pyopencl caches programs for the user. Where one of another processor or a damaged file does not
load, pyopencl builds from source only if this variable is set and empty; where it is missing it
stops with a KeyError."""

ITEM_WORK = 1000.0  # operations of an item, roughly, of a kernel that states no other number
TESTED = 64  # vectors: a whole number of work-groups of any width
LENGTH_ERROR = 2.0**-41
"""Largest relative error of `dual_length` (``common/phase.h``) with the roundings OpenCL allows.

A square root may err by 3 units in the last place, so with the roundings of its argument the
correction is up to d = 4.25 * 2^-23 of the length. One Newton step leaves d^2 / 2 = 0.56 * 2^-42;
its quotient, good to 2.5 units, 0.66 * 2^-42; the sums and products before it 0.53 * 2^-42.
"""

OTHER_DEVICE_HINT = "choose another device with CLRADAR_DEVICE=... (see `clradar devices`)"


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Kernels of one source file, built for one device and one set of options."""

    device: Device
    file: str
    kernels: dict[str, Any]

    def launch(
        self, name: str, global_size: tuple[int, ...], *args: Any, work: float = ITEM_WORK
    ) -> None:
        """Run kernel `name` over `global_size` items and wait for it.

        `args` are buffers and numpy scalars in the kernel's order. Sizes are padded to whole
        work-groups: kernels do nothing beyond theirs. Items of `work` operations each run in
        several launches where they are more than `Device.launch_work`, with the same result.
        """
        self.start(name, global_size, *args, work=work)()

    def start(
        self, name: str, global_size: tuple[int, ...], *args: Any, work: float = ITEM_WORK
    ) -> Callable[[], None]:
        """As `launch`, without waiting; returns a function that waits.

        Borrowed arrays must not change until it has run.
        """
        check_process()
        kernel = self.kernels[name]
        local = group_shape(global_size, self._most_items(kernel))
        padded = tuple(-(-n // side) * side for n, side in zip(global_size, local, strict=True))
        parts = launch_parts(padded, local, self.device.launch_work / max(1.0, work))

        def enqueue() -> list[Any]:
            events, queue = [], self.device.queue
            with self.device.lock:
                kernel.set_args(*args)
                for offset, size in parts:
                    events.append(cl.enqueue_nd_range_kernel(queue, kernel, size, local, offset))
                    queue.flush()
            return events

        events = self._checked(name, global_size, enqueue)

        def wait() -> None:
            for event in events:
                event.wait()

        return lambda: self._checked(name, global_size, wait)

    def _most_items(self, kernel: Any) -> int:
        """Items of a work-group: what the device wants, and the kernel's registers allow."""
        wanted = self.device.group_items
        if wanted == 1:
            return 1
        limit = cl.kernel_work_group_info.WORK_GROUP_SIZE
        (opened,) = self.device.context.devices
        return min(wanted, int(kernel.get_work_group_info(limit, opened)))

    def _checked(self, name: str, global_size: tuple[int, ...], call: Callable[[], Any]) -> Any:
        try:
            return call()
        except cl.Error as error:
            what, remedy = f"kernel {name} of {self.file}", OTHER_DEVICE_HINT
            if isinstance(error, cl.MemoryError):
                failed = f"out of memory in {what}"
                remedy = f"make the problem smaller, or {OTHER_DEVICE_HINT}"
            else:
                failed = f"{what} failed over {global_size} items"
            message = f"device {self.device.info.label}: {failed} ({error}); {remedy}"
            raise DeviceError(message) from error


def group_shape(global_size: tuple[int, ...], most: int) -> tuple[int, ...]:
    """Sides of a work-group of at most `most` items: powers of two, the first as long as useful."""
    shape = []
    for n in global_size:
        side = 1
        while side < n and 2 * side <= most:
            side *= 2
        shape.append(side)
        most //= side
    return tuple(shape)


def launch_parts(
    size: tuple[int, ...], group: tuple[int, ...], most_items: float
) -> list[tuple[tuple[int, ...] | None, tuple[int, ...]]]:
    """Offsets (None: from the start) and sizes of launches that together have all items of `size`.

    None has more than `most_items`, but for a single work-group. The last axes are cut first, so
    that neighbouring items stay together.
    """
    if math.prod(size) <= most_items:
        return [(None, size)]
    step = list(size)
    for axis in reversed(range(len(size))):
        others = math.prod(step) // step[axis]
        side = group[axis]
        step[axis] = min(size[axis], max(1, int(most_items / (others * side))) * side)
    starts = itertools.product(*(range(0, n, d) for n, d in zip(size, step, strict=True)))
    return [
        (at, tuple(min(d, n - a) for a, d, n in zip(at, step, size, strict=True))) for at in starts
    ]


def build(device: Device, file: str, options: Any) -> Program:
    """Build a kernel file, or return what the device has of it; fields of `options` are macros.

    Before a device's first program its arithmetic is tested.
    """
    key = (file, options)
    with device.lock:
        if key not in device.programs:
            self_test(device)
            device.programs[key] = compiled(device, file, options)
        program: Program = device.programs[key]
        return program


def compiled(device: Device, file: str, options: Any) -> Program:
    """As `build`, always anew, and on a device that need not have been tested."""
    flags = ["-cl-std=CL1.2", *defines(options), *_gpu_flags(device, options)]
    if device.info.is_interpreter:
        # Oclgrind checks the code as written and does not support all that its own optimiser
        # emits. CLR_CHECKED marks the few places that avoid its faults.
        flags += ["-cl-opt-disable", "-DCLR_CHECKED"]
    if device.info.target is not None:
        # For the caches of pyopencl and PoCL, whose keys do not have it: a folder of the user's may
        # serve several machines.
        flags.append(f"-DCLR_TARGET_{device.info.target.upper().replace('-', '_')}")
    os.environ.setdefault(CACHE_FAILURE, "")
    try:
        with warnings.catch_warnings():
            # pyopencl turns remarks of drivers into warnings.
            warnings.simplefilter("ignore")
            built = cl.Program(device.context, source(file)).build(flags)
            kernels = {kernel.function_name: kernel for kernel in built.all_kernels()}
    except cl.Error as error:
        log = str(error).strip()
        # The line that says what is wrong, without the place in front of it.
        wrong = (line[line.index("error:") :] for line in log.splitlines() if "error:" in line)
        raise DeviceError(
            f"device {device.info.label}: {file} does not build "
            f"({next(wrong, type(error).__name__)}); {OTHER_DEVICE_HINT}, or {INSTALL_HINT}; the "
            f"log of {' '.join(flags)}:\n{log}"
        ) from error
    return Program(device, file, kernels)


def private_length(n: int, step: int, device: Device) -> int:
    """Entries of an item's private array, at least `n`: few lengths, to build few programs.

    A GPU has little such memory: the next multiple of `step`. A CPU: powers of two of steps, four
    at least. No result depends on it.
    """
    steps = -(-n // step)
    if device.width == 8:
        steps = max(4, 1 << (steps - 1).bit_length())
    return steps * step


def _gpu_flags(device: Device, options: Any) -> list[str]:
    """Flags that make a GPU round as a CPU does, and that keep its registers few."""
    if device.info.kind != "gpu":
        return []
    flags = []
    (opened,) = device.context.devices
    if opened.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
        flags.append("-cl-fp32-correctly-rounded-divide-sqrt")
    # NVIDIA's compiler then uses so many: it is for programs that take more without need.
    most = getattr(options, "nvidia_registers", None)
    if most is not None and "cl_nv_compiler_options" in opened.extensions:
        flags.append(f"-cl-nv-maxrregcount={most}")
    return flags


def defines(options: Any) -> list[str]:
    """The compiler's arguments for an options dataclass, as `build` passes them."""
    return [f"-DCLR_{f.name.upper()}={_literal(getattr(options, f.name))}" for f in fields(options)]


def _literal(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.9e}f"
    return str(value)


# The test of a device


@dataclass(frozen=True, slots=True)
class _Width:
    width: int


def self_test(device: Device) -> None:
    """Does an opened device build, run, copy and round right? Tested once, in milliseconds.

    Products and sums as two float32 are exact only if each step rounds to nearest and none is
    fused or reordered, which a compiler may do by itself.
    """
    key = ("self_test.cl", _Width(device.width))
    with device.lock:
        if key in device.programs:
            return
        # The caller's memory limit is not for this.
        apart = replace(device, budget_bytes=2**20, buffers=WeakSet())
        program, vectors = compiled(apart, *key), _vectors()
        with Buffers(apart) as buffers:
            held, out = buffers.upload(vectors), buffers.empty(vectors.nbytes)
            program.launch("dual_numbers", (TESTED // device.width,), np.uint32(TESTED), held, out)
            _compare(device, vectors, buffers.read(out, vectors.shape, np.float32))
        device.programs[key] = program


def _vectors() -> np.ndarray:
    """Vectors of 0.2 mm to 16 m a component, float32 of shape (3, 2, TESTED) as x, y, z and hi, lo.

    Their products and sums fit in float64, and no step comes near the smallest float32.
    """
    rng = np.random.default_rng(1)
    size = 2.0 ** rng.uniform(-12, 4, (3, TESTED))
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
