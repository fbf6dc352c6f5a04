"""Pictures of what is in a file, drawn without computing again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import Run, one_error_line

from clradar import Capture, Waveform, arrays
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CompareError
from clradar.plot import capture_figure, recording_figure
from measurement_io import save_capture

WAVEFORM = Waveform.sfcw(72e9, 82e9, 64)


def echo(range_m: float, level: float = 1.0) -> Capture:
    """A target in the middle, seen by the imager's antennas; Tx 5 is dead."""
    array = arrays.qar50()
    place = np.array([0.0, 0.0, range_m])
    legs = [np.linalg.norm(side - place, axis=1) for side in (array.tx_m, array.rx_m)]
    path_m = legs[0][:, None, None] + legs[1][None, :, None]
    data = level * np.exp(-2j * np.pi * path_m * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S)
    data[5] = 0
    return Capture(data.astype(np.complex64), array, WAVEFORM)


@pytest.mark.parametrize("name", ["volume.h5", "sim.h5", "recording"])
def test_files_are_drawn_without_a_device(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("CLRADAR_DEVICE", "abacus")
    outcome = run("inspect", made / name, "--png", tmp_path / "x.png")
    assert outcome.status == 0, outcome.err
    assert (tmp_path / "x.png").read_bytes()[:4] == b"\x89PNG"
    if name == "volume.h5":
        outcome = run("image", made / name, "--png", tmp_path / "y.png")
        assert outcome.status == 0, outcome.err
        same = [(tmp_path / f"{letter}.png").read_bytes() for letter in "xy"]
        assert same[0] == same[1]


def test_slices_and_views_of_a_volume_are_drawn(run: Run, made: Path, tmp_path: Path) -> None:
    for i, options in enumerate((["--view", "all"], ["--slice", "y=0"])):
        outcome = run("inspect", made / "volume.h5", "--png", tmp_path / f"{i}.png", *options)
        assert outcome.status == 0, outcome.err
    for name, options in (("volume.h5", ["--slice", "q"]), ("sim.h5", ["--view", "xz"])):
        outcome = run("inspect", made / name, "--png", tmp_path / "no.png", *options)
        assert outcome.status == 2
        assert options[0] in outcome.err


def test_a_capture_shows_its_target_and_its_dead_channel() -> None:
    curve, pairs, _ = capture_figure(echo(0.4)).axes
    (line,) = curve.lines
    where_mm, level_db = np.array(line.get_data())
    # The antennas are some centimetres off the axis: paths are a little longer than twice 400 mm.
    assert where_mm[np.argmax(level_db)] == pytest.approx(405, abs=8)
    shown_db = pairs.images[0].get_array()
    assert np.flatnonzero((shown_db < -100).all(axis=1)).tolist() == [5]
    assert np.allclose(np.delete(shown_db, 5, axis=0), 0, atol=1e-4)


def test_a_recording_shows_how_its_target_moves() -> None:
    frames = [echo(0.3), echo(0.35, 0.5), echo(0.4)]
    echoes, level, _ = recording_figure(frames, [2, 3, 7]).axes
    (mesh,) = echoes.collections
    power_db, edges_mm = np.asarray(mesh.get_array()), np.asarray(mesh.get_coordinates())[:, 0, 1]
    found_mm = (edges_mm[1:] + edges_mm[:-1])[power_db.argmax(axis=0)] / 2
    assert np.diff(found_mm) == pytest.approx([50, 50], abs=8)
    (line,) = level.lines
    assert np.array(line.get_data()) == pytest.approx(
        np.array([[2, 3, 7], [0, 20 * np.log10(0.5), 0]]), abs=1e-3
    )


def test_what_cannot_be_drawn_is_an_error(run: Run, made: Path, tmp_path: Path) -> None:
    zeros = Capture(np.zeros((94, 94, 64), np.complex64), arrays.qar50(), WAVEFORM)
    with pytest.raises(CompareError, match="zeros"):
        capture_figure(zeros)
    save_capture(tmp_path / "zeros.h5", zeros)
    one_error_line(run("inspect", tmp_path / "zeros.h5", "--png", tmp_path / "x.png"), "zeros")
    assert run("inspect", made / "sim.h5", "--check", "--png", tmp_path / "x.png").status == 2
    assert not (tmp_path / "x.png").exists()
