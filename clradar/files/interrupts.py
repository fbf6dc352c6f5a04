"""Ctrl-C, SIGTERM and SIGHUP: a command that is ended puts things in order first."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from contextlib import contextmanager

TYPE_CHECKING = False  # as in `clradar`
if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType
    from typing import Any, Literal

ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that end a command; Windows has not all of them."""

AGAIN_S = 0.02  # until a signal that came at a wrong moment comes again

_timers: Any = signal  # Windows lacks some, and is asked first

_phase: Literal["none", "starting", "working", "ended"] = "none"
_ended_by: int = signal.SIGINT
_waits = False
_blocks = 0


@contextmanager
def ending_signals() -> Iterator[None]:
    """Let the signals that end a program raise `KeyboardInterrupt` in the block, so that it cleans
    up; before `working` they end the process at once, and after `ended` they do nothing.

    Of the main thread alone. Signals that the process ignores, as after ``nohup``, stay ignored.
    """
    global _phase
    numbers = [getattr(signal, name) for name in ENDING if hasattr(signal, name)]
    default = (signal.SIG_DFL, signal.default_int_handler)
    try:
        before = {n: signal.signal(n, _handle) for n in numbers if signal.getsignal(n) in default}
    except ValueError:  # another thread than the main one
        yield
        return
    if hasattr(signal, "SIGALRM") and signal.getsignal(signal.SIGALRM) == signal.SIG_DFL:
        signal.signal(_timers.SIGALRM, lambda _, frame: _handle(_ended_by, frame))
    hook, sys.unraisablehook = sys.unraisablehook, _raise_again_if_lost
    _phase = "starting"
    try:
        yield
    finally:
        # The program ends, which takes a while: drivers and Dask put their things in order.
        atexit.register(lambda: [signal.signal(n, signal.SIG_IGN) for n in before])
        ended()
        _phase, sys.unraisablehook = "none", hook
        for number, handler in before.items():
            signal.signal(number, handler)


def working() -> None:
    """From here on there may be things to put in order."""
    global _phase
    if _phase == "starting":
        _phase = "working"


def ended() -> None:
    """Nothing is left that could be interrupted."""
    global _phase, _waits
    if _phase == "working":
        _phase, _waits = "ended", False
        if hasattr(signal, "SIGALRM"):
            _timers.setitimer(_timers.ITIMER_REAL, 0)


def waits() -> bool:
    """Whether a signal is still to be heard; what it did to other processes may be an error."""
    return _waits


def exit_status() -> int:
    """That of a program that was interrupted, as shells have it: 128 and the signal."""
    return 128 + _ended_by


def _handle(number: int, frame: FrameType | None) -> None:
    global _ended_by, _waits
    if _phase == "starting":
        os.write(2, b"clradar: interrupted\n")
        os._exit(128 + number)
    if _phase == "ended":
        return
    _ended_by = number
    # An import that is cut short leaves half a module, and may lose the exception or change it.
    _waits = hasattr(signal, "SIGALRM") and (_blocks > 0 or _imports(frame))
    if not _waits:
        raise KeyboardInterrupt
    _timers.setitimer(_timers.ITIMER_REAL, AGAIN_S)


def _imports(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _raise_again_if_lost(lost: Any) -> None:
    """Where Python can pass no exception on, as in a destructor."""
    if issubclass(lost.exc_type, KeyboardInterrupt) and hasattr(signal, "SIGALRM"):
        _timers.setitimer(_timers.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(lost)


@contextmanager
def postponed() -> Iterator[None]:
    """Let no signal interrupt the block; it is heard after it."""
    global _blocks
    _blocks += 1
    try:
        yield
    finally:
        _blocks -= 1


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT while the block runs, and permanently in the threads and processes it starts.

    Processes inherit the signal mask of the thread that starts them, so only this process receives
    the signal, and ends them in order. The others of `ending_signals` wait for the block's end.
    """
    if sys.platform == "win32":  # there the others receive it, too
        yield
        return
    from multiprocessing import resource_tracker

    # Starting a resource tracker unblocks the signal, so it must run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with postponed():
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
