"""``--device all``, wherever the help offers it."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
from command_line import GRID, Run

from clradar.cli.app import COMMANDS, module_of
from clradar.cli.groups import expanded

LINES = {  # and what the command fails for once it has opened the device; "": it does not fail
    "hand": ("hand A -o new.ply --edge-mm 4", ""),
    "simulate": ("simulate hand.ply -o new.h5 --samples-per-mm2 0.01 --band 72:82:2", ""),
    "image": (f"image sim.h5 -o new.h5 {' '.join(GRID)}", ""),
    "compare": (f"compare sim.h5 none.h5 {' '.join(GRID)}", "none.h5"),
    "diagnose": ("diagnose sim.h5 --x-mm -40:40:20 --y-mm -40:40:20 --z-mm 300", ""),
    "align": ("align none.h5 --mesh hand.ply -o new.json", "none.h5"),
    "register": ("register none.h5 hand.ply -o new", "none.h5"),
    "fit-hand": ("fit-hand none.h5 --pose F -o new", "none.h5"),
    "sweep": ("sweep none.h5 hand.ply -o new", "none.h5"),
    "dataset": ("dataset --replay none 0", "none"),
    "process": (f"process recording -o new {' '.join(GRID)}", ""),
    "view": ("view none.h5", "none.h5"),
    "demo": ("demo -o new", "the demo"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_with_a_device_takes_all(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    parameters = expanded(import_module(module_of(name)).command).__signature__.parameters
    assert ("device" in parameters) == (name in LINES)
    if name not in LINES:
        return

    def broken(*_: object) -> None:
        raise ValueError("the demo is made")

    monkeypatch.setattr("clradar.cli.commands.demo.run_demo", broken)
    monkeypatch.setattr("clradar.cli.recordings.RecordingWork._write", lambda *_: None)
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    line, reason = LINES[name]
    outcome = run(*line.split(), "--device", "all")
    assert outcome.status == bool(reason), outcome.err
    assert reason in outcome.err
    assert "expected one device" not in outcome.err
