"""Building programs and launching kernels, with errors that say the device and what to do."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import pyopencl as cl

from clradar.errors import DeviceError
from clradar.opencl.device import Device
from clradar.opencl.sources import source

CACHE_FAILURE = "PYOPENCL_CACHE_FAILURE_FATAL"
"""pyopencl keeps what it has built in the user's cache. What another processor or a damaged file
has left there does not load; pyopencl then builds from source only if this variable is set and
empty, and stops with a KeyError where it is missing."""

OTHER_DEVICE_HINT = "choose another device with CLRADAR_DEVICE=... (see `clradar devices`)"


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Kernels of one source file, built for one device and one set of options."""

    device: Device
    file: str
    kernels: dict[str, Any]

    def launch(self, name: str, global_size: tuple[int, ...], *args: Any) -> None:
        """Run kernel `name` over `global_size` items and wait for it.

        `args` are buffers and numpy scalars in the kernel's order. No result depends on the size of
        the work-groups: on a GPU the driver chooses; on a CPU each item, which is 8 lanes wide, is
        one of its own, since PoCL keeps the private arrays of a whole group on the stack.
        """
        self.start(name, global_size, *args)()

    def start(self, name: str, global_size: tuple[int, ...], *args: Any) -> Callable[[], None]:
        """As `launch`, but return at once what waits for it.

        Commands that follow come after it. Borrowed arrays are its own until it has run.
        """
        kernel = self.kernels[name]
        local = None if self.device.info.kind == "gpu" else (1,) * len(global_size)

        def enqueue() -> Any:
            kernel.set_args(*args)
            event = cl.enqueue_nd_range_kernel(self.device.queue, kernel, global_size, local)
            self.device.queue.flush()
            if self.device.launched is not None:
                self.device.launched.append(event)
            return event

        event = self._checked(name, global_size, enqueue)
        return lambda: self._checked(name, global_size, event.wait)

    def _checked(self, name: str, global_size: tuple[int, ...], call: Callable[[], Any]) -> Any:
        try:
            return call()
        except cl.MemoryError as error:
            raise DeviceError(
                f"device {self.device.info.label}: out of memory in kernel {name} of {self.file} "
                f"({error}); ask for a smaller problem, or {OTHER_DEVICE_HINT}"
            ) from error
        except cl.Error as error:
            raise DeviceError(
                f"device {self.device.info.label}: kernel {name} of {self.file} failed over "
                f"{global_size} items ({error}); {OTHER_DEVICE_HINT}"
            ) from error


def build(device: Device, file: str, options: Any) -> Program:
    """Return the program of kernel file `file`, from the device's cache or newly built.

    Parameters
    ----------
    options : frozen dataclass
        Each field `name` becomes ``-DCLR_NAME=value``; booleans become 0 or 1, and floats are
        written so that OpenCL reads back the same float32.

    Raises
    ------
    DeviceError
        The build failed; the message has the device, the options and the build log.
    """
    key = (file, options)
    cached = device.programs.get(key)
    if cached is not None:
        return cached
    defines = [
        f"-DCLR_{f.name.upper()}={_literal(getattr(options, f.name))}" for f in fields(options)
    ]
    flags = ["-cl-std=CL1.2", *defines]
    if device.info.is_interpreter:
        # A checker should see the code as written, and Oclgrind does not know all that its own
        # optimiser makes of it. CLR_CHECKED marks the few places that avoid its faults.
        flags += ["-cl-opt-disable", "-DCLR_CHECKED"]
    os.environ.setdefault(CACHE_FAILURE, "")
    try:
        with warnings.catch_warnings():
            # Drivers print remarks on success, which pyopencl turns into warnings.
            warnings.simplefilter("ignore")
            built = cl.Program(device.context, source(file)).build(flags)
            kernels = {kernel.function_name: kernel for kernel in built.all_kernels()}
    except cl.Error as error:
        log = str(error).strip()
        raise DeviceError(
            f"device {device.info.label}: {file} does not build with {' '.join(flags)}; "
            f"{OTHER_DEVICE_HINT}, or report this log:\n{log}"
        ) from error
    program = Program(device, file, kernels)
    device.programs[key] = program
    return program


def _literal(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.9e}f"
    return str(value)
