"""Ctrl-C while processes start: a terminal sends it to all of them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT while the block runs, and permanently in the threads and processes it starts.

    Processes inherit the signal mask of the thread that starts them, so only this process receives
    the signal, and ends them in order.
    """
    if sys.platform == "win32":  # there the others receive it, too
        yield
        return
    # Starting a resource tracker unblocks the signal, so it must run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
