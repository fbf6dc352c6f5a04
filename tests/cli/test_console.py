"""What a terminal shows while a command runs."""

from __future__ import annotations

import io
import sys

import pytest

from clradar.cli.console import progress_bar
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
