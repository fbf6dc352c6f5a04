"""Printing: results to stdout; errors, warnings and progress to stderr."""

from __future__ import annotations

import sys
import textwrap
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

NARROW_GAP_CHARACTERS = 2
"""The same in a terminal that is too narrow."""

WRAPPED_CHARACTERS = 24
"""Least width in which text of the last column is wrapped."""


def one_line(text: object) -> str:
    """The text on one line that any stream can print, however long."""
    return quoted(text, sys.maxsize)


def print_error(text: object) -> None:
    """Print the one line with the reason why a command failed."""
    _print(f"clradar: error: {one_line(text)}", sys.stderr)


def print_interrupted(text: str) -> None:
    """Print that a command was interrupted, and what resumes, where something does."""
    _print(f"clradar: {one_line(text)}", sys.stderr)


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
    print(_encodable(text, stream), file=stream, flush=True)


def _encodable(text: str, stream: TextIO) -> str:
    """The text with escapes for what a stream's encoding lacks, as in the C locale."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def counted(count: int, noun: str) -> str:
    """A number and its noun, such as "2 problems"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Sequence[str] = (),
    keys: int = 1,
) -> None:
    """Print a table; the columns named in `right` are aligned to the right, the last one wraps.

    Nothing is cut. Where a terminal is too narrow, heads wrap, and columns that still do not fit
    follow in further tables, each with the first ones again: `keys` of them, which name a row.
    """
    from rich import box
    from rich.console import Console, JustifyMethod
    from rich.table import Table
    from rich.text import Text

    # In a pipe nothing is cut or wrapped: a program that reads it needs whole lines.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 10_000)
    # Text: brackets are no markup.
    cells = [[Text(_encodable(one_line(cell), sys.stdout)) for cell in row] for row in rows]
    filled = [max((row[i].cell_len for row in cells), default=0) for i in range(len(columns))]
    heads, gap = [[name] for name in columns], GAP_CHARACTERS
    if columns[-1] not in right:
        filled[-1] = min(filled[-1], WRAPPED_CHARACTERS)
    if len(_fitting(_widths(heads, filled), gap, keys, console.width)) > 1:
        heads = [_wrapped(name, width) for name, width in zip(columns, filled, strict=True)]
        gap = NARROW_GAP_CHARACTERS
    widths, available = _widths(heads, filled), console.width
    for n, shown in enumerate(_fitting(widths, gap, keys, available)):
        free = len(shown) <= keys + 1
        wraps = [c not in right and (free or c == columns[-1]) for c in columns]
        # A terminal wraps what is still too wide; the table would cut it.
        least = sum(min(widths[i], WRAPPED_CHARACTERS) if wraps[i] else widths[i] for i in shown)
        console.width = max(available, least + gap * (len(shown) - 1))
        table = Table(
            box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold",
            padding=(0, 1, 0, gap - NARROW_GAP_CHARACTERS),
        )  # fmt: skip
        for i in shown:
            justify: JustifyMethod = "right" if columns[i] in right else "left"
            head = Text("\n".join(heads[i]))
            table.add_column(head, justify=justify, no_wrap=not wraps[i], overflow="fold")
        for row in cells:
            table.add_row(*(row[i] for i in shown))
        if n > 0:
            console.print()
        console.print(table)


def _wrapped(name: str, width: int) -> list[str]:
    return textwrap.wrap(name, max([width, *map(len, name.split())])) or [""]


def _widths(heads: Sequence[Sequence[str]], filled: Sequence[int]) -> list[int]:
    return [max(width, *map(len, h)) for width, h in zip(filled, heads, strict=True)]


def _fitting(widths: Sequence[int], gap: int, keys: int, most: int) -> list[list[int]]:
    """Columns of the tables that show all columns, each with the keys, and one more at least."""
    first = list(range(keys))
    tables = [first]
    for i in range(keys, len(widths)):
        wanted = sum(widths[k] + gap for k in tables[-1]) + widths[i]
        if wanted > most and len(tables[-1]) > keys:
            tables.append(first)
        tables[-1] = [*tables[-1], i]
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
    """Show a progress bar on stderr while the block runs, where stderr is a terminal."""
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
