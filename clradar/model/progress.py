"""The progress callback that long computations take."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (done, total) units of work, such as samples."""

_STEPS = 1000  # of a computation that consists of parts


def say_stage(progress: Progress | None, words: str) -> None:
    """Say what is done now to a callback that shows it: one with a method `stage`."""
    getattr(progress, "stage", lambda _: None)(words)


def part_of(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """The callback for a part of a longer computation, from its share `begin` to `end`, of 1000."""
    if progress is None:
        return None

    def show(done: int, total: int) -> None:
        progress(round(_STEPS * (begin + (end - begin) * done / total)), _STEPS)

    return show
