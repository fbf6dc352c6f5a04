"""Runs of commands, and files for them."""

from pathlib import Path

import pytest
from command_line import DENSITY, EDGE_MM, GRID, exit_status
from quick_figures import draw_quickly, lay_out_once, seek_nothing_else

from measurement_io import open_capture, save_recording


@pytest.fixture(autouse=True)
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")
    lay_out_once(monkeypatch)


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures without content, images without a search for lobes."""
    draw_quickly(monkeypatch)
    seek_nothing_else(monkeypatch)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a hand, a capture, its volume, and a recording of the same data."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLRADAR_DEVICE", "pocl")
        patch.chdir(folder)
        for line in (
            f"hand F -o hand.ply --edge-mm {EDGE_MM}",
            f"simulate hand.ply -o sim.h5 --samples-per-mm2 {DENSITY} --band 72:82:16 "
            "--alpha 0.4 --seed 7",
            f"image sim.h5 -o volume.h5 {GRID}",
        ):
            assert exit_status(*line.split()) == 0, line
        save_recording("recording", [open_capture("sim.h5")])
    return folder


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Path:
    """The folder of the commands, with links to all that is made."""
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return tmp_path
