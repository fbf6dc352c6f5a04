"""Progress on a terminal wherever a command takes long, and none in a pipe."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from command_line import Run


@pytest.mark.parametrize(
    ("line", "labels"),
    [
        ("image {}/volume.h5 --png a.png --report a.html", ("drawing", "writing the page")),
        (
            "compare {}/volume.h5 {}/volume.h5 -o a.png --report a.html",
            ("drawing", "writing the page"),
        ),
        ("align {}/volume.h5 {}/volume.h5 -o a.json", ("aligning",)),
        ("inspect {}/recording --check", ("checking",)),
        ("inspect {}/recording --png a.png", ("reading",)),
    ],
)
@pytest.mark.usefixtures("quickly")
def test_a_terminal_shows_progress_and_a_pipe_none(
    run: Run,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    line: str,
    labels: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    for kind in ("html", "image"):
        monkeypatch.setattr(f"clradar.report.{kind}_report", lambda *_, **__: "a page")
    arguments = line.replace("{}", str(made)).split()
    plain = run(*arguments)
    assert plain.status == 0, plain.err
    assert not any(label in plain.err for label in labels)
    for path in tmp_path.iterdir():
        path.unlink()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    shown = run(*arguments)
    assert shown.status == 0, shown.err
    assert all(label in shown.err for label in labels)
    assert shown.out == plain.out  # results stay on stdout
