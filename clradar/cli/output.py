"""What the subcommands print and write: errors, tables, progress, and files that are not there yet.

Results go to stdout; errors and progress go to stderr.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from clradar.errors import OutputError
from clradar.model.progress import Progress


def one_line(text: object) -> str:
    """Return `text` on one line that any stream can print, however long."""
    line = " ".join(str(text).split())
    line = line.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in line)


def print_error(text: object) -> None:
    """Print the one line that says why a command failed."""
    print(_encodable(f"clradar: error: {one_line(text)}", sys.stderr), file=sys.stderr)


def print_warning(text: object) -> None:
    """Print one line about something that was done but may not be meant."""
    print(_encodable(f"clradar: warning: {one_line(text)}", sys.stderr), file=sys.stderr)


def print_line(text: object) -> None:
    """Print one line of a result, at once."""
    print(_encodable(one_line(text), sys.stdout), flush=True)


def print_text(text: str) -> None:
    """Print lines of a result as they are."""
    print(_encodable(text, sys.stdout), flush=True)


def _encodable(text: str, stream: object) -> str:
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[str] = ()
) -> None:
    """Print a table.

    Parameters
    ----------
    columns : sequence of str
    rows : iterable of sequences of str
        One string per column; brackets in them mean nothing.
    right : sequence of str
        The columns whose values are aligned to the right.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # In a pipe nothing is cut or wrapped: whoever reads it wants whole lines.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 10_000)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold")
    for name in columns:
        table.add_column(Text(name), justify="right" if name in right else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(Text(one_line(cell)) for cell in row))
    console.print(table)


@contextmanager
def progress_bar(label: str) -> Iterator[Progress | None]:
    """Show a progress bar on stderr while the block runs, where stderr is a terminal.

    Yields
    ------
    callable or None
        To be passed on as ``progress=``: called with (done, total). None in a pipe.
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
        task = bars.add_task(label, total=None)

        def show(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        yield show


def check_outputs(
    outputs: Iterable[Path | None], *, force: bool, inputs: Iterable[Path] = ()
) -> None:
    """Raise unless every output may be written; called before the long work starts.

    Parameters
    ----------
    outputs : iterable of Path or None
        None stands for an output that was not asked for.
    force : bool
        Existing files may be replaced.
    inputs : iterable of Path
        Files that are read, and are never written to.

    Raises
    ------
    OutputError
        A file exists and `force` is False, its folder does not exist or cannot be written to, it is
        a folder, one name is given twice, or it is also an input.
    """
    taken: dict[Path, str] = {}
    for path in inputs:
        taken[_place(path)] = "is also an input"
    for output in outputs:
        if output is None:
            continue
        place = _place(output)
        try:
            if place in taken:
                raise OutputError(f"{output}: {taken[place]}; choose another name")
            if output.is_dir():
                raise OutputError(f"{output}: expected a file's name, got a folder")
            if not output.parent.is_dir():
                raise OutputError(f"{output}: expected an existing folder, got '{output.parent}'")
            if not force and os.path.lexists(output):
                raise OutputError(f"{output}: exists already; --force replaces it")
            if not os.access(output.parent, os.W_OK | os.X_OK):
                raise OutputError(f"{output}: the folder '{output.parent}' cannot be written to")
        except OutputError:
            raise
        except (OSError, ValueError) as error:  # a name that is too long, or holds a zero byte
            raise OutputError(f"{output}: cannot be written: {error}") from error
        taken[place] = "is named twice as an output"


def _place(path: Path) -> Path:
    return Path(os.path.realpath(path))


def write_bytes(path: Path, content: bytes, *, force: bool) -> None:
    """Write a small file whole or not at all."""
    from clradar.files.atomic import write_file

    write_file(path, content, force=force)


def write_json(path: Path, value: object, *, force: bool) -> None:
    """Write strict JSON (no NaN), indented, whole or not at all."""
    from clradar.files import json_file

    json_file.write_json(path, value, force=force)
