"""Printing: results to stdout; errors, warnings and progress to stderr."""

from __future__ import annotations

import logging
import os
import sys
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from typing import TYPE_CHECKING, TextIO, TypeVar

from clradar.errors import quoted

if TYPE_CHECKING:
    from clradar.model.progress import Progress

Item = TypeVar("Item")

LINE_CHARACTERS = 80  # of a terminal: heads of tables wrap beyond it


def one_line(text: object) -> str:
    """The text on one line that any stream can print, however long."""
    return quoted(text, sys.maxsize)


def error(text: object, kind: str = "error: ") -> None:
    """Print one line, of the reason why a command failed; of another kind where that is given."""
    _print(f"clradar: {kind}{one_line(text)}", sys.stderr)


def warning(text: object) -> None:
    """Print one line about a result that is probably not as intended."""
    error(text, "warning: ")


@contextmanager
def log(wanted: bool) -> Iterator[None]:
    """Print what the packages log while the block runs, as lines on stderr, if that is wanted."""
    log, handler = logging.getLogger("clradar"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("clradar: %(message)s"))
    if wanted:
        log.addHandler(handler)
        log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)


def line(text: object) -> None:
    """Print one line of a result, at once."""
    _print(one_line(text), sys.stdout)


def text(text: str) -> None:
    """Print lines of a result as they are."""
    _print(text, sys.stdout)


def _print(text: str, stream: TextIO) -> None:
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:  # as of `| head -1`: nobody reads on, and the files are not written yet
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def counted(count: int, noun: str) -> str:
    """A number and its noun, such as "2 problems"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[str] = ()
) -> None:
    """Print a table; the columns named in `right` are aligned to the right, long heads wrap."""
    cells = [list(map(one_line, row)) for row in rows]

    def widths_of(heads: Iterable[list[str]]) -> list[int]:
        return [max(map(len, [*h, *(row[i] for row in cells)])) for i, h in enumerate(heads)]

    widths = widths_of([name] for name in columns)
    if sum(widths) + 2 * len(widths) > LINE_CHARACTERS:
        widths = widths_of(name.split() or [""] for name in columns)
    heads = [textwrap.wrap(name, width or 1) for name, width in zip(columns, widths, strict=True)]
    lines = [*zip_longest(*heads, fillvalue=""), ["-" * width for width in widths], *cells]
    for row in lines:
        shown = [
            cell.rjust(width) if name in right else cell.ljust(width)
            for cell, width, name in zip(row, widths, columns, strict=True)
        ]
        text("  ".join(shown).rstrip())


@contextmanager
def bar(label: str) -> Iterator[Progress | None]:
    """Show a progress bar on stderr while the block runs, where stderr is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich import progress
    from rich.console import Console

    text = progress.TextColumn("{task.description}", markup=False)
    more = (progress.BarColumn(), progress.TaskProgressColumn(), progress.TimeRemainingColumn())
    with progress.Progress(text, *more, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(label, total=None)

        def shown(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        # As `clradar.model.progress.say_stage` calls it.
        shown.stage = lambda what: bars.update(task, description=f"{label}: {what}")  # type: ignore[attr-defined]
        yield shown


def track(items: Collection[Item], label: str) -> Iterator[Item]:
    """Go through items with a progress bar."""
    with bar(label) as progress:
        for done, item in enumerate(items, start=1):
            yield item
            if progress is not None:
                progress(done, len(items))
