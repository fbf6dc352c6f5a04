"""Runs of commands, and files for them."""

from __future__ import annotations

from pathlib import Path

import command_line
import pytest
from command_line import DENSITY, EDGE_MM, GRID, Outcome, Run, exit_status
from quick_figures import draw_quickly, lay_out_once, seek_no_lobes

from measurement_io import open_capture, save_recording


@pytest.fixture(autouse=True)
def _device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")


@pytest.fixture(autouse=True)
def _layout(monkeypatch: pytest.MonkeyPatch) -> None:
    lay_out_once(monkeypatch)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: object) -> Outcome:
        return Outcome(*command_line.run(capsys, *arguments))

    return call


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures without content, images without a search for lobes."""
    draw_quickly(monkeypatch)
    seek_no_lobes(monkeypatch)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a hand, a capture, its volume, and a recording of the same data."""
    folder = tmp_path_factory.mktemp("made")
    commands = [
        ["hand", "F", "-o", "hand.ply", "--edge-mm", EDGE_MM],
        ["hand", "F", "-o", "parts.glb", "--edge-mm", EDGE_MM],
        ["simulate", "hand.ply", "-o", "sim.h5", "--samples-per-mm2", DENSITY, "--band", "72:82:16",
         "--alpha", "0.4", "--seed", "7"],
        ["image", "sim.h5", "-o", "volume.h5", *GRID],
    ]  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLRADAR_DEVICE", "pocl")
        patch.chdir(folder)
        for command in commands:
            assert exit_status(*command) == 0, command
        save_recording("recording", [open_capture("sim.h5")])
    return folder
