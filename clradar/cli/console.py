"""Printing: results to stdout; errors, warnings and progress to stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from clradar.errors import handled_warnings, quoted

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from clradar.model.progress import Progress


GAP_CHARACTERS = 3
"""Between two columns of a table."""

WRAPPED_CHARACTERS = 24
"""Least width in which text of the last column is wrapped."""


def one_line(text: object) -> str:
    """The text on one line that any stream can print, however long."""
    return quoted(text, sys.maxsize)


def print_error(text: object) -> None:
    """Print the one line with the reason why a command failed."""
    _print(f"clradar: error: {one_line(text)}", sys.stderr)


def print_warning(text: object) -> None:
    """Print one line about a result that is probably not as intended."""
    _print(f"clradar: warning: {one_line(text)}", sys.stderr)


def printed_warnings() -> AbstractContextManager[None]:
    """Print every different `ClradarWarning` of the block once, as a line on stderr."""
    return handled_warnings(print_warning)


@contextmanager
def printed_log(wanted: bool) -> Iterator[None]:
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


def print_line(text: object) -> None:
    """Print one line of a result, at once."""
    _print(one_line(text), sys.stdout)


def print_text(text: str) -> None:
    """Print lines of a result as they are."""
    _print(text, sys.stdout)


def _print(text: str, stream: TextIO) -> None:
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)


def counted(count: int, noun: str) -> str:
    """A number and its noun, such as "2 problems"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[str] = ()
) -> None:
    """Print a table; the columns named in `right` are aligned to the right, the last one wraps.

    Nothing is cut. Where a terminal is too narrow, columns follow in further tables, each with the
    first column again.
    """
    from rich import box
    from rich.console import Console, JustifyMethod
    from rich.table import Table
    from rich.text import Text

    # In a pipe nothing is cut or wrapped: a program that reads it needs whole lines.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 10_000)
    cells = [[Text(one_line(cell)) for cell in row] for row in rows]  # Text: brackets are no markup
    widths = [
        max(Text(name).cell_len, *(row[i].cell_len for row in cells), 0)
        for i, name in enumerate(columns)
    ]
    if columns[-1] not in right:
        widths[-1] = min(widths[-1], WRAPPED_CHARACTERS)
    for shown in _fitting(widths, console.width):
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold")
        for i in shown:
            justify: JustifyMethod = "right" if columns[i] in right else "left"
            wraps = i == len(columns) - 1 or len(shown) < 3
            table.add_column(Text(columns[i]), justify=justify, no_wrap=not wraps, overflow="fold")
        for row in cells:
            table.add_row(*(row[i] for i in shown))
        console.print(table)


def _fitting(widths: Sequence[int], most: int) -> list[list[int]]:
    """Columns of the tables that show all columns, each with the first; two at least."""
    tables = [[0]]
    for i in range(1, len(widths)):
        wanted = sum(widths[k] + GAP_CHARACTERS for k in tables[-1]) + widths[i]
        if wanted > most and len(tables[-1]) > 1:
            tables.append([0])
        tables[-1].append(i)
    return tables


@dataclass(frozen=True, slots=True)
class _Bar:
    bars: Bars
    task: TaskID
    label: str

    def __call__(self, done: int, total: int) -> None:
        self.bars.update(self.task, completed=done, total=total)

    def stage(self, words: str) -> None:
        self.bars.update(self.task, description=f"{self.label}: {words}")


@contextmanager
def progress_bar(label: str) -> Iterator[Progress | None]:
    """Show a progress bar on stderr while the block runs, where stderr is a terminal.

    Yields
    ------
    callable or None
        To be passed on as ``progress=``: called with (done, total); its method `stage` shows what
        is done now after the label. None in a pipe.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        yield _Bar(bars, bars.add_task(label, total=None), label)
