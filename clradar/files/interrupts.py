"""Ctrl-C, SIGTERM and SIGHUP: a command that is ended puts things in order first."""

from __future__ import annotations

import signal
import sys
from contextlib import contextmanager

TYPE_CHECKING = False  # as in `clradar`
if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Any

_heard: int | None = None
_blocks = 0


@contextmanager
def ending_signals() -> Iterator[None]:
    """Let the signals that end a program raise `KeyboardInterrupt` in the block, of the main thread
    alone. Signals that the process ignores, as after ``nohup``, stay ignored.
    """
    global _heard
    _heard = None
    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has not all of them
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    default = (signal.SIG_DFL, signal.default_int_handler)
    try:
        before = {n: signal.signal(n, _handle) for n in numbers if signal.getsignal(n) in default}
    except ValueError:  # another thread than the main one
        before = {}
    try:
        yield
    except BaseException as error:
        if isinstance(error, SystemExit) or not heard():
            raise
        sys.stderr.write("clradar: interrupted\n")  # an import, which may have changed the error
        raise SystemExit(exit_status()) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        exec("")  # After an interrupt in a dataclass's exec, `python -m` would end by SIGINT.


def heard() -> bool:
    """Whether there was a signal; what it did to imports and other processes may be an error."""
    return _heard is not None


def exit_status() -> int:
    """That of a program that was interrupted, as shells have it: 128 and the signal."""
    return 128 + (_heard or signal.SIGINT)


def _handle(number: int, frame: Any) -> None:
    global _heard
    _heard = number
    if not _blocks:
        raise KeyboardInterrupt


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT while the block runs, and permanently in the threads and processes it starts.

    Processes inherit the signal mask of the thread that starts them, so only this process receives
    the signal, and ends them in order. The others of `ending_signals` wait for the block's end.
    """
    global _blocks
    if sys.platform == "win32":  # there the others receive it, too
        yield
        return
    from multiprocessing import resource_tracker

    # Starting a resource tracker unblocks the signal, so it must run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    _blocks += 1
    try:
        yield
    finally:
        _blocks -= 1
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if heard():
            raise KeyboardInterrupt
