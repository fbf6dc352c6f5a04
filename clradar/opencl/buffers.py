"""Device memory that is counted against a budget and freed when a `with` block ends.

And the double-single numbers of kernels: a float64 as the unevaluated sum of two float32
(``common/dual.h``).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import numpy as np
import pyopencl as cl

from clradar.errors import DeviceError
from clradar.opencl.device import Device, check_process

HUGE_BYTES = 4 * 2**20
"""From this size on numpy allocates huge pages, and buffers on a CPU are numpy's memory. PoCL's own
costs a page fault for every 4 KiB that is used, some microseconds each."""

PAGE_BYTES = 4096
FEWEST_BYTES = 16  # of a buffer: OpenCL has no empty ones

Prepared = TypeVar("Prepared", bound="OnDevice")


class Buffers:
    """Buffers of one call, which count against the device's budget and are freed together."""

    def __init__(self, device: Device) -> None:
        check_process()
        self.device = device
        self.used_bytes = 0
        self._held: dict[int, tuple[Any, int]] = {}
        self._closed = False
        with device.lock:
            device.buffers.add(self)

    def __enter__(self) -> Buffers:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(waiting=kind is not None)

    def close(self, *, waiting: bool) -> None:
        """Free all; `waiting` until nothing that was launched may use them."""
        if waiting:
            with suppress(cl.Error):  # of what has failed before
                self.device.queue.finish()
        for buffer, _ in self._held.values():
            buffer.release()
        self._held.clear()
        self.used_bytes = 0
        self._closed = True

    @property
    def free_bytes(self) -> int:
        """Rest of the budget."""
        return self.device.budget_bytes - self.device.used_bytes

    def empty(self, n_bytes: int) -> Any:
        """Allocate at least `n_bytes`, contents undefined."""
        size = max(int(n_bytes), FEWEST_BYTES)
        if self.device.info.kind != "cpu" or size < HUGE_BYTES:
            return self._hold(size, cl.mem_flags.READ_WRITE)
        self._check_room(size)
        with self._memory_of(size):
            memory = np.empty(size + PAGE_BYTES, np.uint8)
        at = -memory.ctypes.data % PAGE_BYTES
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
        return self._hold(size, flags, memory[at : at + size])

    def _check_room(self, size: int) -> None:
        if self._closed:
            raise DeviceError(
                "buffers: expected an allocation inside the `with` block, got one after"
            )
        info = self.device.info
        if size > info.max_alloc_bytes or size > self.free_bytes:
            used, budget = _mib(self.device.used_bytes), _mib(self.device.budget_bytes)
            raise DeviceError(
                f"device {info.label}: a buffer of {_mib(size)} does not fit "
                f"({used} of {budget} in use, largest single buffer "
                f"{_mib(info.max_alloc_bytes)}); make the problem smaller, or choose "
                "another device with CLRADAR_DEVICE=..."
            )

    def _hold(self, size: int, flags: int, of: np.ndarray | None = None) -> Any:
        self._check_room(size)
        with self._memory_of(size):
            buffer = cl.Buffer(self.device.context, flags, 0 if of is not None else size, of)
        self._held[id(buffer)] = (buffer, size)
        self.used_bytes += size
        return buffer

    def upload(self, array: np.ndarray) -> Any:
        """Copy `array` to a new buffer."""
        buffer = self.empty(array.nbytes)
        self.write(buffer, array)
        return buffer

    def borrow(self, array: np.ndarray) -> Any:
        """A read-only buffer of `array`, which must not change meanwhile; a CPU copies nothing."""
        array = np.require(array, requirements=["C", "A"])
        if self.device.info.kind != "cpu" or array.nbytes < FEWEST_BYTES:
            return self.upload(array)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return self._hold(array.nbytes, flags, array)

    def zeros(self, n_bytes: int) -> Any:
        """Allocate zero bytes."""
        buffer = self.empty(n_bytes)
        self.write(buffer, np.zeros(buffer.size, np.uint8))
        return buffer

    def write(self, buffer: Any, array: np.ndarray) -> None:
        """Copy `array` to the start of `buffer`."""
        self._check_held(buffer)
        if array.nbytes:
            with self._memory_of(array.nbytes):
                cl.enqueue_copy(self.device.queue, buffer, np.ascontiguousarray(array))

    def read(self, buffer: Any, shape: tuple[int, ...] | int, dtype: Any) -> np.ndarray:
        """Copy the start of `buffer` to a new array."""
        self._check_held(buffer)
        out: np.ndarray = np.empty(shape, dtype=dtype)
        if out.nbytes:
            with self._memory_of(out.nbytes):
                cl.enqueue_copy(self.device.queue, out, buffer)
        return out

    def release(self, buffer: Any) -> None:
        """Free one buffer before the block ends."""
        self._check_held(buffer)
        held, size = self._held.pop(id(buffer))
        held.release()
        self.used_bytes -= size

    def _check_held(self, buffer: Any) -> None:
        # PoCL crashes on a buffer that was released.
        if id(buffer) not in self._held:
            raise DeviceError("buffers: expected a buffer of this block, got one that was freed")

    @contextmanager
    def _memory_of(self, size: int) -> Iterator[None]:
        try:
            yield
        except (MemoryError, cl.Error) as error:
            raise DeviceError(
                f"device {self.device.info.label}: {_mib(size)} could not be allocated or copied "
                f"({error}); free memory, make the problem smaller, or choose another device with "
                f"CLRADAR_DEVICE=..."
            ) from error


class OnDevice:
    """Base of what lives on a device for the length of a `with` block.

    The block begins with `_prepare`, which uploads and builds. All buffers are freed when the block
    ends, also if preparing fails.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._buffers = Buffers(device)

    def __enter__(self: Prepared) -> Prepared:
        try:
            self._prepare()
        except BaseException:
            self.__exit__(*sys.exc_info())
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None = None, *_: object) -> None:
        self._buffers.close(waiting=kind is not None)

    def _prepare(self) -> None:
        raise NotImplementedError


def _mib(n_bytes: int) -> str:
    return f"{n_bytes / 2**20:.1f} MiB"


def hi_lo(values: Any) -> tuple[Any, Any]:
    """Split float64 into two float32 whose sum equals it to 2^-48, relative."""
    hi = np.asarray(values, np.float32)[()]  # of one number np.float32 warns (numpy 1.26)
    return hi, np.asarray(values - np.asarray(hi, np.float64), np.float32)[()]


def antenna_rows(positions_m: np.ndarray) -> np.ndarray:
    """Antennas, shape (n, 3), as float32 of shape (n, 6): x, y, z as hi, then as lo."""
    return np.concatenate(hi_lo(positions_m), axis=1)
