"""Every command that makes or needs a radar takes any: --array and --band, or a reason."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import pytest
import typer
from command_line import Run

import clradar
from clradar.cli.app import COMMANDS, module_of
from clradar.cli.groups import expanded
from measurement_io import open_volume, save_capture

OWN = "captures and recordings have their antennas and frequencies"
WITHOUT = {
    "devices": "no radar",
    "materials": "a band alone, --band-ghz",
    "hand": "a mesh alone",
    "dataset": "the plan has them, [radar]",
    "image": OWN,
    "convert": f"{OWN}, or a layout does",
    "export": OWN,
    "view": OWN,
    "clean": OWN,
    "channels": OWN,
    "process": OWN,
    "diagnose": OWN,
    "inspect": OWN,
    "compare": "nothing is simulated",
}

CROSS = """
[[tx]]
line = { first_m = [-0.0275, 0, 0], last_m = [0.0275, 0, 0], n = 6 }
[[rx]]
line = { first_m = [0, -0.0375, 0], last_m = [0, 0.0375, 0], n = 5 }
"""


@pytest.fixture
def cross(tmp_path: Path) -> Path:
    path = tmp_path / "cross60.toml"
    path.write_text(CROSS, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_takes_any_radar_or_says_why_not(name: str) -> None:
    parameters = expanded(import_module(module_of(name)).command).__signature__.parameters
    takes = {"array", "band"} <= set(parameters)
    assert takes != (name in WITHOUT), f"{name}: --array and --band, or a reason here"


def test_widths_of_an_array_are_not_called_its_resolution(run: Run, cross: Path) -> None:
    command = ("array", cross, "--band", "60:62:5", "--within-deg", "10")
    found = json.loads(run(*command, "--json").out)
    assert len(found["widths_m"]) == 3
    assert "resolution_m" not in found
    printed = run(*command).out
    assert "widths at -3 dB: x " in printed
    assert "resolution in range c/2B 74.9 mm" in printed


def test_a_volume_is_taken_for_one_of_the_radar_that_is_named(
    run: Run, tmp_path: Path, cross: Path
) -> None:
    array = clradar.arrays.read_array(cross)
    waveform = clradar.Waveform.sfcw(60e9, 62e9, 5)
    capture = clradar.room_capture(array, waveform, [], points_m=[[0, 0, 0.3]])
    save_capture(tmp_path / "capture.h5", capture)
    outcome = run(
        "image", tmp_path / "capture.h5", "-o", tmp_path / "volume.h5",
        "--x-mm", "-20:20:4", "--y-mm", "-20:20:4", "--z-mm", "290:310:4",
    )  # fmt: skip
    assert outcome.status == 0, outcome.err
    from clradar.cli.inputs import ImageInput
    from clradar.cli.options.measured import RadarOptions

    volume = ImageInput(tmp_path / "volume.h5", open_volume(tmp_path / "volume.h5"))
    found = volume.radar_or(RadarOptions(array=str(cross), band=(60.0, 62.0, 5)))
    assert found["array"].same_positions(array, 0.0)
    assert found["waveform"].same_frequencies(waveform)
    for command in ("register", "align", "sweep"):
        words = [command, tmp_path / "capture.h5", tmp_path / "no.ply"]
        words = [command, words[1], "--mesh", words[2]] if command == "align" else words
        outcome = run(*words, "-o", tmp_path / "made", "--array", cross)
        assert outcome.status != 0
    with pytest.raises(typer.BadParameter, match="capture and has its antennas"):
        ImageInput(tmp_path / "capture.h5", capture).radar_or(RadarOptions(band=(60.0, 62.0, 5)))
