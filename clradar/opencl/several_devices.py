"""Batches of independent items over the devices of a machine, one process per device.

Processes and not threads: the host's part of a simulation holds Python's global lock, filters of
warnings belong to a process, and where a driver crashes it is known whose it was.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.reduction import ForkingPickler
from time import monotonic
from typing import Any, TypeVar

from clradar.errors import ClradarError, DeviceError, handled_warnings, warn
from clradar.files.interrupts import interrupts_blocked
from clradar.model import checks
from clradar.model.progress import Progress, part_of
from clradar.opencl.choice import open_device, select_devices
from clradar.opencl.device import Device, DeviceInfo
from clradar.opencl.program import compiled
from clradar.opencl.self_test import self_test

BLAS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

AHEAD = 4
"""Items per device that may be made before the turn of their results: these are kept."""

TELL_S = 0.1
"""Least time between two words of progress from a process."""

LOOK_S = 1.0
"""Longest wait that Ctrl-C does not end on every system."""

END_S = 5.0
"""Time that a process has for ending before it is killed."""

_STEPS = 1000  # of the progress bar, per item

Result = TypeVar("Result")

Work = Callable[[Any, Device, Progress], Iterable[Result]]
"""Makes the results of an item on a device; says by the last argument how far it is."""


def check_alike(infos: Sequence[DeviceInfo], what: str) -> None:
    """Raise `DeviceError` unless all devices are of one name and driver."""
    if not all(info.is_like(infos[0]) for info in infos[1:]):
        raise DeviceError(
            f"device: expected devices of one name and driver for {what}, since those of others "
            f"give other bits, got {_listed(infos)}; name those of one kind, as in 0:0,0:1"
        )


def _listed(infos: Sequence[DeviceInfo]) -> str:
    return ", ".join(f"{info.selector} {info.label}" for info in infos)


@dataclass(frozen=True, slots=True)
class Devices:
    """The devices of a batch.

    Attributes
    ----------
    infos : tuple of DeviceInfo
    first : Device
        The first of them, opened in this process. A single one makes all items here.

    Examples
    --------
    >>> from clradar.opencl import open_devices
    >>> devices = open_devices("pocl")
    >>> def squares(n, device, progress):
    ...     yield n * n
    >>> list(devices.made(squares, [3, 4])), list(devices.in_order(squares, [3, 4]))
    ([(0, 9), (1, 16)], [9, 16])
    """

    infos: tuple[DeviceInfo, ...]
    first: Device

    @property
    def text(self) -> str:
        """Their names, for a person."""
        if len(self.infos) == 1:
            return self.first.info.label
        return _listed(self.infos)

    def check_alike(self, what: str) -> None:
        """Raise `DeviceError` unless all are of one name and driver, so that bits are the same."""
        check_alike(self.infos, what)

    def made(
        self, work: Work[Result], items: Iterable[Any], progress: Progress | None = None
    ) -> Iterator[tuple[int, Result]]:
        """Make the results of all items, in any order.

        Parameters
        ----------
        work : callable
            Called with an item, an opened device and a progress callback; returns the results of
            the item. With several devices it is pickled, once for each.
        items : iterable
            Pickled, too.
        progress : callable, optional
            Called with (done, total) units of work.

        Yields
        ------
        item : int
            Its number.
        result

        Raises
        ------
        DeviceError
            A device fails, or its process ends; the message names it. All processes are ended.

        Warns
        -----
        ClradarWarning
            As `work`; from other processes each text once.
        """
        return self._made(work, list(items), progress, None)

    def in_order(
        self, work: Work[Result], items: Iterable[Any], progress: Progress | None = None
    ) -> Iterator[Result]:
        """As `made`, the results in the order of the items; a few items ahead are kept."""
        listed = list(items)
        early: dict[int, list[Result]] = {}
        turn = 0

        def limit() -> int:
            return turn + AHEAD * len(self.infos)

        for i, results in self._made(_All(work), listed, progress, limit):
            early[i] = results
            while turn in early:
                yield from early.pop(turn)
                turn += 1

    def _made(
        self,
        work: Work[Result],
        items: list[Any],
        progress: Progress | None,
        limit: Callable[[], int] | None,
    ) -> Iterator[tuple[int, Result]]:
        if len(self.infos) == 1 or len(items) < 2:
            yield from _made_here(work, items, self.first, progress)
            return
        with _processes(self.infos[: len(items)], work) as processes:
            yield from _Batch(processes, items, progress, limit or (lambda: len(items))).run()


def open_devices(device: Devices | Device | str | Sequence[str] | None = "all") -> Devices:
    """Choose the devices of a batch.

    Parameters
    ----------
    device : Devices, Device, str, sequence of str or None
        `Devices` are returned as they are. "all": all GPUs, those of one name by the first driver
        that offers them; without GPUs the CPU device that is used anyway, and others of its name
        and driver. A sequence, or names with commas between them: those. Else as
        `clradar.open_device`.

    Raises
    ------
    DeviceError
        No such device, or one is named twice.

    Examples
    --------
    >>> from clradar.opencl import open_devices
    >>> [info.kind for info in open_devices("pocl").infos]
    ['cpu']
    """
    if isinstance(device, Devices):
        return device
    if isinstance(device, Device):
        return Devices((device.info,), device)
    infos = select_devices(device)
    return Devices(tuple(infos), open_device(infos[0].selector))


def map_devices(
    function: Callable[[Any, Device], Result],
    items: Iterable[Any],
    *,
    device: Device | str | Sequence[str] | None = "all",
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Call a function for every item, on several devices at the same time.

    Every device has a process of its own, which takes the next item when it is free; a single
    device works in this process. Frames, alphas or samples of a batch come out as from one device:
    the same bits from devices of one name and driver, else what differs between runtimes.

    Parameters
    ----------
    function : callable
        Called with an item and an opened device. With several devices function, items and results
        are pickled, so it is a function of a module, and a script that calls this has its own code
        under ``if __name__ == "__main__":``.
    items : iterable
    device : Device, str, sequence of str or None
        "all": all GPUs, or without one the CPU device that is used anyway; names with commas, or a
        sequence of names: those; else as `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) units of work.

    Yields
    ------
    object
        What the function returns, in the order of the items. Up to four items per device are made
        ahead of the one that is waited for.

    Raises
    ------
    DeviceError
        There is no such device, it fails its test, or it fails; the message names it.
    Exception
        What the function raises. The other processes are ended.

    Examples
    --------
    >>> import clradar
    >>> def lanes(item, device):
    ...     return item * device.width
    >>> list(clradar.map_devices(lanes, [1, 2, 3], device="pocl"))
    [8, 16, 24]
    """
    return open_devices(device).in_order(_Plain(function), items, progress)


@dataclass(frozen=True, slots=True)
class _Plain:
    """Work by a function that returns one result and says nothing meanwhile."""

    function: Callable[[Any, Device], Any]

    def __call__(self, item: Any, device: Device, progress: Progress) -> list[Any]:
        return [self.function(item, device)]


@dataclass(frozen=True, slots=True)
class _All:
    """Work whose only result are all results of an item."""

    work: Work[Any]

    def __call__(self, item: Any, device: Device, progress: Progress) -> list[list[Any]]:
        return [list(self.work(item, device, progress))]


def _silent(done: int, total: int) -> None:
    pass


def _made_here(
    work: Work[Result], items: list[Any], device: Device, progress: Progress | None
) -> Iterator[tuple[int, Result]]:
    for i, item in enumerate(items):
        part = part_of(progress, i / len(items), (i + 1) / len(items))
        for result in work(item, device, part or _silent):
            yield i, result
        if part is not None:
            part(1, 1)


@dataclass(slots=True)
class _Process:
    """A process of a device, and the number of the item that it makes."""

    info: DeviceInfo
    process: Any
    pipe: Any  # a Connection, on Windows a PipeConnection
    item: int | None = None

    @property
    def name(self) -> str:
        return f"device {self.info.selector} {self.info.label}"

    def named(self, error: BaseException) -> BaseException:
        """The error of its work; of a device with its selector, since names may be the same."""
        if type(error) is not DeviceError:
            return error
        text = str(error).removeprefix(f"device {self.info.label}: ")
        return DeviceError(f"{self.name}: {text}")

    def send(self, pickled: Any) -> None:
        """Send it work or an item."""
        try:
            self.pipe.send_bytes(pickled)
        except OSError:
            raise self.ended() from None

    def ended(self) -> DeviceError:
        """The error of a process that ended by itself."""
        self.process.join(END_S)
        code = self.process.exitcode
        how = f"signal {-code}" if code is not None and code < 0 else f"exit status {code}"
        if self.item is None:
            return DeviceError(
                f"{self.name}: its process ended with {how} before its first item; a script that "
                'uses several devices has its own code under if __name__ == "__main__":'
            )
        return DeviceError(
            f"{self.name}: its process ended with {how} at item {self.item}; choose other devices, "
            "see `clradar devices`"
        )


class _Batch:
    """Gives items to processes that are free, and collects what they make."""

    def __init__(
        self,
        processes: list[_Process],
        items: list[Any],
        progress: Progress | None,
        limit: Callable[[], int],
    ) -> None:
        self._by_pipe: dict[Any, _Process] = {one.pipe: one for one in processes}
        self._free: list[_Process] = []
        self._items, self._progress, self._limit = items, progress, limit
        self._given = 0
        self._share = [0.0] * len(items)
        self._warned: set[str] = set()
        self._left = len(items)

    def run(self) -> Iterator[tuple[int, Any]]:
        while self._left:
            for pipe in wait(list(self._by_pipe), LOOK_S):
                process = self._by_pipe[pipe]
                try:
                    kind, content = process.pipe.recv()
                except (EOFError, OSError):
                    raise process.ended() from None
                if kind == "result":
                    assert process.item is not None
                    yield process.item, content
                else:
                    self._heard(process, kind, content)
                self._give()

    def _heard(self, process: _Process, kind: str, content: Any) -> None:
        if kind == "failed":
            error, trace = content
            raise process.named(error) from _Remote(trace)
        if kind == "warning":
            if content not in self._warned:
                self._warned.add(content)
                warn(content)
        elif kind == "progress":
            assert process.item is not None
            self._show(process.item, content)
        else:  # ready
            if process.item is not None:
                self._show(process.item, 1.0)
                self._left -= 1
                process.item = None
            self._free.append(process)

    def _show(self, item: int, share: float) -> None:
        self._share[item] = share
        if self._progress is not None:
            self._progress(round(_STEPS * sum(self._share)), _STEPS * len(self._items))

    def _give(self) -> None:
        while self._free and self._given < min(len(self._items), self._limit()):
            process = self._free.pop(0)
            process.item = self._given
            self._given += 1
            process.send(_pickled(self._items[process.item]))


class _Remote(Exception):
    """Where an error came from in its process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@contextmanager
def _processes(infos: Sequence[DeviceInfo], work: Work[Any]) -> Iterator[list[_Process]]:
    """Start a process for each device; end them all with the block."""
    pickled = _pickled(work)
    context = multiprocessing.get_context("spawn")
    started: list[_Process] = []
    done = False
    try:
        with interrupts_blocked(), _fewer_threads(len(infos)):
            for info in infos:
                here, there = context.Pipe()
                arguments = (there, info.selector)
                process = context.Process(target=_serve, args=arguments, daemon=True)
                process.start()
                there.close()  # so that the end of the process is the end of the pipe
                started.append(_Process(info, process, here))
        for one in started:
            one.send(pickled)
        yield started
        done = True
    finally:
        for one in started:
            one.pipe.close()  # a free process ends by this
            if not done:
                one.process.terminate()
        for one in started:
            one.process.join(END_S)
            if one.process.is_alive():
                one.process.kill()
                one.process.join()


@contextmanager
def _fewer_threads(processes: int) -> Iterator[None]:
    """Share the cores among the linear algebra of processes that start, unless the user has."""
    threads = str(max(1, (os.cpu_count() or 1) // processes))
    added = [name for name in BLAS_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(added, threads))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _pickled(content: Any) -> Any:
    """The bytes for another process, or a `ModelError`."""
    try:
        return ForkingPickler.dumps(content)
    except Exception as error:
        checks.fail(
            "several devices", "functions of a module and items that can be pickled", str(error)
        )


def _serve(pipe: Any, selector: str) -> None:
    """Make items that come through a pipe until it closes: what a process runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it is not blocked
    with handled_warnings(lambda text: pipe.send(("warning", text))):
        try:
            work: Work[Any] = pipe.recv()
            device = open_device(selector)
            self_test(device, compiled)
            while True:
                pipe.send(("ready", None))
                item = pipe.recv()
                for result in work(item, device, _teller(pipe)):
                    pipe.send(("result", result))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return  # the other end has gone
        except Exception as error:
            pipe.send(("failed", (_sendable(error), traceback.format_exc())))


def _teller(pipe: Any) -> Progress:
    last_s = monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal last_s
        if monotonic() - last_s >= TELL_S:
            last_s = monotonic()
            pipe.send(("progress", done / total))

    return tell


def _sendable(error: Exception) -> Exception:
    try:
        ForkingPickler.loads(ForkingPickler.dumps(error))
        return error
    except Exception:
        return ClradarError(f"{type(error).__name__}: {error}")
