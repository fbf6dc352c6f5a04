"""Printing: results to stdout; errors, warnings and progress to stderr."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from clradar.errors import quoted

if TYPE_CHECKING:
    from clradar.model.progress import Progress

WRAPPED_CHARACTERS = 24  # least width in which text of the last column of a table is wrapped


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
    if not wanted:
        yield
        return
    import logging

    log, handler = logging.getLogger("clradar"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("clradar: %(message)s"))
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
        print(_encodable(text, stream), file=stream, flush=True)
    except BrokenPipeError:  # as of `| head -1`: nobody reads on, and the files are not written yet
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _encodable(text: str, stream: TextIO) -> str:
    """The text with escapes for what a stream's encoding lacks, as in the C locale."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    if encoding.lower().replace("-", "") != "utf8":
        text = text.replace("±", "+-").replace("…", "...").replace("°", " deg")
    return text.encode(encoding, "backslashreplace").decode(encoding)


def counted(count: int, noun: str) -> str:
    """A number and its noun, such as "2 problems"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[str] = ()
) -> None:
    """Print a table; the columns named in `right` are aligned to the right, others may wrap."""
    from rich import box
    from rich.console import Console, JustifyMethod
    from rich.table import Table
    from rich.text import Text

    # In a pipe nothing is cut or wrapped: a program that reads it needs whole lines.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 10_000)
    # Text: brackets are no markup.
    cells = [[Text(_encodable(one_line(cell), sys.stdout)) for cell in row] for row in rows]
    table = Table(
        box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold",
        padding=(0, 1, 0, 0),
    )  # fmt: skip
    gaps, last = 2 * (len(columns) - 1), len(columns) - 1 if columns[-1] not in right else None
    filled = [max((row[i].cell_len for row in cells), default=0) for i in range(len(columns))]
    if last is not None:
        filled[last] = min(filled[last], WRAPPED_CHARACTERS)
    heads = [[name] for name in columns]
    if sum(map(max, filled, map(len, columns))) + gaps > console.width:
        longest = [max([n, *map(len, c.split())]) for c, n in zip(columns, filled, strict=True)]
        heads = [textwrap.wrap(c, n or 1) for c, n in zip(columns, longest, strict=True)]
    for i, lines in enumerate(heads):
        number = columns[i] in right
        side: JustifyMethod = "right" if number else "left"
        table.add_column(Text("\n".join(lines)), justify=side, no_wrap=number, overflow="fold")
    for row in cells:
        table.add_row(*row)
    with console.capture() as captured:
        console.print(table)
    text(captured.get().removesuffix("\n"))


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
