"""What a terminal shows while a command runs."""

from __future__ import annotations

import io
import os
import re
import struct
import subprocess
import sys
from contextlib import suppress

import pytest
from systems import posix_only

from clradar.cli.console import progress_bar
from clradar.compare import METRIC_TABLE
from clradar.model.progress import part_of, say_stage


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_progress_bar_says_what_is_done_now(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("fitting") as progress:
        assert progress is not None
        say_stage(progress, "[A], 1 of 24")
        part = part_of(progress, 0.0, 0.5)
        assert part is not None
        part(1, 2)
    assert "fitting: [A], 1 of 24" in terminal.getvalue()
    assert "25%" in terminal.getvalue()


def test_a_pipe_gets_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress_bar("fitting") as progress:
        assert progress is None
    say_stage(progress, "simulating")


def in_terminal(columns: int, code: str) -> str:
    """What a program prints in a terminal of so many columns."""
    import fcntl  # which Windows has not
    import pty
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    variables = {key: value for key, value in os.environ.items() if key != "COLUMNS"}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=theirs, stdout=theirs, stderr=theirs, env=variables
    ):
        os.close(theirs)
        shown = b""
        with suppress(OSError):  # how a terminal says that nobody writes to it any more
            while part := os.read(ours, 65536):
                shown += part
    os.close(ours)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode()).replace("\r", "")


METRIC_COLUMNS = [metric.name for metric in METRIC_TABLE]
METRICS = ["0.942", "0.919", "-101.25", "0.75", "11.77", "12.68", "13.36"]
TABLES = {
    "metrics": (["simulated", *METRIC_COLUMNS], [["sim.h5", *METRICS]], METRIC_COLUMNS),
    "long name": (
        ["simulated", *METRIC_COLUMNS], [["n" * 70, *METRICS]], METRIC_COLUMNS
    ),
    "text": (
        ["axes", "phase", "frequencies", "x", "sharpness (dB)", "brightest at x, y, z (mm)", ""],
        [["[tx, rx]", "exp(-j)", "descending", "mirrored", "-12.3", "-100, -20, 300", "best"]],
        ["sharpness (dB)", "brightest at x, y, z (mm)"],
    ),
}  # fmt: skip


@posix_only
@pytest.mark.parametrize("columns", [200, 80, 60, 20])
@pytest.mark.parametrize("name", TABLES)
def test_a_terminal_cuts_no_cell_of_a_table(columns: int, name: str) -> None:
    heads, rows, right = TABLES[name]
    shown = in_terminal(
        columns,
        "from clradar.cli.console import print_table\n"
        f"print_table({heads!r}, {rows!r}, right={right!r})",
    )
    assert "…" not in shown
    for cell in rows[0] if name != "long name" else rows[0][1:]:
        assert cell in shown
    for word in (word for head in heads for word in head.split()):
        assert word in shown
    assert shown.count("n") >= 70 or name != "long name"
    if columns >= 60:
        assert max(map(len, shown.splitlines())) <= columns
    if columns >= 80 and name != "long name":  # one table
        assert shown.count("─\n") == 1
