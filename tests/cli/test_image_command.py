"""``clradar image``, ``convert`` and ``inspect``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from command_line import GRID, Run, one_error_line
from matplotlib.figure import Figure

import clradar
import clradar.plot
from clradar.cli.inputs import recording_title, title_of
from clradar.cli.options import GridOptions
from clradar.cli.parse import axis_mm
from measurement_io import (
    check_file,
    describe,
    open_capture,
    open_volume,
    save_capture,
    save_recording,
)


def test_axis_in_millimetres() -> None:
    assert axis_mm("--x-mm", "-100:100:1") == (-100.0, 100.0, 1.0)
    assert axis_mm("--x-mm", "300") == (300.0, 300.0, 1.0)
    assert axis_mm("--x-mm", "0:0.3:0.1") == (0.0, 0.3, 0.1)
    for text in ("", "a:b:c", "1:2", "1:2:3:4", "0:1:0", "0:1:-1", "0:1:0.3", "inf"):
        with pytest.raises(typer.BadParameter):
            axis_mm("--x-mm", text)


def test_the_default_grid_is_that_of_the_paper() -> None:
    grid = GridOptions().grid()
    paper = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    assert grid.counts == (201, 201, 81)
    assert grid.same_voxels(paper, tolerance_m=1e-15)


def test_image_of_a_recording_and_its_figure(run: Run, made: Path, tmp_path: Path) -> None:
    target, png = tmp_path / "v.h5", tmp_path / "v.png"
    outcome = run("image", made / "recording", "-o", target, "--png", png, "--method", "exact",
                  "--window", "hann", *GRID)  # fmt: skip
    assert outcome.status == 0, outcome.err
    volume = open_volume(target)
    expected = clradar.backproject(
        open_capture(made / "sim.h5"),
        volume.grid,
        method="exact",
        window="hann",
        check_grid=False,
        device="pocl",
    )
    assert np.array_equal(volume.data, expected.data)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert [i["file"] for i in volume.meta["inputs"]] == ["000000.npy"]


def test_figures_of_recordings_are_titled_with_object_distance_variant_and_frame(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = open_capture(made / "sim.h5")
    recording = tmp_path / "hand" / "30"
    save_recording(recording, [capture, capture], variant="emptyfiltered")
    titles = []
    monkeypatch.setattr(
        "clradar.plot.image_figure", lambda *given, **_: titles.append(given[1]) or Figure()
    )
    words = "hand, 30 cm, emptyfiltered, frame 1"
    chosen = ("--variant", "emptyfiltered", "--frame", "1")
    png = ("--png", tmp_path / "v.png", "--force")
    outcome = run("image", recording, *png, *chosen, *GRID, "-o", tmp_path / "v.h5")
    assert outcome.status == 0, outcome.err
    monkeypatch.chdir(recording)
    assert run("image", ".", *png, *chosen, *GRID).status == 0
    (frame_file,) = recording.glob("*/*/000001_*.npy")
    assert run("image", frame_file, *png, *GRID).status == 0
    assert run("image", tmp_path / "v.h5", *png).status == 0
    assert run("image", made / "volume.h5", *png).status == 0
    assert titles == [words, words, words, f"v.h5: {words}", "volume.h5"]
    volume = open_volume(tmp_path / "v.h5")
    assert recording_title(volume.meta) == words
    assert recording_title({"capture": {"format": "maroon", "source": 3}}) == ""
    assert title_of(Path("lab.mat"), {"format": "layout", "frame": 2}) == "lab.mat, frame 2"


def test_report_of_one_image(run: Run, made: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    outcome = run("image", made / "recording", "--report", page, *GRID)
    assert outcome.status == 0, outcome.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html"]
    text = page.read_text(encoding="utf-8")
    assert "<h1>recording, raw, frame 0</h1>" in text
    assert "000000.npy" in text
    assert "Metrics" not in text
    saved = tmp_path / "saved.html"
    outcome = run("image", made / "volume.h5", "--report", saved)
    assert outcome.status == 0, outcome.err
    row = "maximum of the amplitude"
    assert text.split(row)[1][:60] == saved.read_text(encoding="utf-8").split(row)[1][:60]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("sim.h5", "native capture"), ("volume.h5", "native volume"), ("recording", "recording")],
)
def test_inspect(run: Run, made: Path, name: str, kind: str) -> None:
    outcome = run("inspect", made / name)
    assert outcome.status == 0, outcome.err
    assert f"{name}: {kind}" in outcome.out.splitlines()[0]
    described = json.loads(run("inspect", made / name, "--json").out)
    assert described["kind"] == kind
    assert described["facts"]["data"]["type"] == "complex64"
    assert described["problems"] == []
    checked = run("inspect", made / name, "--check")
    assert checked.status == 0, checked.err
    assert "all right" in checked.out
    assert json.loads(run("inspect", made / name, "--check", "--json").out)["ok"] is True


def test_check_finds_a_changed_byte(run: Run, made: Path, tmp_path: Path) -> None:
    content = bytearray((made / "sim.h5").read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(content)
    outcome = run("inspect", damaged, "--check")
    one_error_line(outcome, "damaged.h5")
    assert "problem" in outcome.out


def test_a_capture_without_receptions_is_warned_of(run: Run, made: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing.h5"
    outcome = run("simulate", made / "hand.ply", "-o", nothing, "--samples-per-mm2", "1e-9")
    assert outcome.status == 0
    assert "clradar: warning: no ray reached a receiver" in outcome.err
    figure = tmp_path / "nothing.png"
    outcome = run("image", nothing, "-o", tmp_path / "v.h5", *GRID, "--png", figure)
    assert outcome.status == 0
    assert "zero everywhere" in outcome.err
    assert not figure.exists()


def test_a_slice_is_drawn_from_above_and_a_voxel_not_at_all(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    monkeypatch.setattr("clradar.plot.save_figure", lambda figure, *_, **__: drawn.append(figure))
    across = ["--x-mm=-60:60:6", "--z-mm", "280:320:5"]
    for axes, view, labels in (
        (["--y-mm", "0", *across], [], ("x (mm)", "z (mm)")),
        (["--y-mm=-60:60:6", *across], ["--view", "yz"], ("z (mm)", "y (mm)")),
        (["--y-mm", "0", *across], ["--view", "xy"], ("x (mm)", "y (mm)")),
        (
            ["--y-mm", "0", "--x-mm", "0", "--z-mm", "280:320:5"],
            [],
            ("z (mm)", "below maximum (dB)"),
        ),
    ):
        outcome = run("image", made / "sim.h5", "-o", tmp_path / "v.h5", "--png",
                      tmp_path / "v.png", "--force", *axes, *view)  # fmt: skip
        assert outcome.status == 0, outcome.err
        first = drawn[-1].axes[0]
        assert (first.get_xlabel().lstrip("\N{LEFTWARDS ARROW} "), first.get_ylabel()) == labels
    one = ["--x-mm", "0", "--y-mm", "0", "--z-mm", "300"]
    outcome = run("image", made / "sim.h5", "-o", tmp_path / "one.h5", "--png",
                  tmp_path / "one.png", *one)  # fmt: skip
    assert outcome.status == 0
    assert "one.png: not drawn, since the image is one voxel, of amplitude" in outcome.err
    assert not (tmp_path / "one.png").exists()
    assert open_volume(tmp_path / "one.h5").data.size == 1


def test_a_capture_without_a_grid_is_imaged_where_its_echo_is(run: Run, tmp_path: Path) -> None:
    q = clradar.arrays.qar50()
    array = clradar.AntennaArray(q.tx_m[::4], q.rx_m[::4])
    sweep = clradar.Waveform.sfcw(72e9, 82e9, 128)
    far = tmp_path / "far.h5"
    save_capture(far, clradar.room_capture(array, sweep, [], points_m=[[0, 0, 1.5]]))
    outcome = run("image", far, "-o", tmp_path / "v.h5")
    assert outcome.status == 0, outcome.err
    assert outcome.err == ""
    assert "grid: " in outcome.out
    volume = open_volume(tmp_path / "v.h5")
    assert volume.grid.z_m[0] < 1.5 < volume.grid.z_m[-1]
    assert np.abs(volume.data).max() > 0.9
    outcome = run("image", far, "-o", tmp_path / "w.h5", "--z-mm", "260:340:8", "--x-mm=-80:80:8",
                  "--y-mm=-80:80:8")  # fmt: skip
    assert outcome.status == 0
    assert "clradar: warning: the strongest echo, at x 0.000, y 0.000, z 1.500 m" in outcome.err
    facts = json.loads(run("inspect", far, "--json").out)["facts"]
    assert facts["range"]["resolution_m"] == pytest.approx(0.01499, rel=1e-3)
    assert facts["range"]["unambiguous_m"] == pytest.approx(1.9037, rel=1e-3)
    assert facts["strongest_echo"]["range_m"] == pytest.approx(1.5, abs=0.01)
    assert facts["strongest_echo"]["lateral_resolution_m"][0] == pytest.approx(0.021, rel=0.05)
    assert "unambiguous to 1.904 m" in run("inspect", far).out


def test_radar_cross_sections_of_samples_that_are_s_parameters(
    run: Run, made: Path, tmp_path: Path
) -> None:
    target, png, page = tmp_path / "v.h5", tmp_path / "v.png", tmp_path / "v.html"
    files = ["-o", target, "--png", png, "--report", page, "--dbsm", *GRID]
    outcome = run("image", made / "sim.h5", *files)
    one_error_line(outcome, "sim.h5: expected S-parameters for --dbsm")
    assert not list(tmp_path.iterdir())
    assert run("image", made / "volume.h5", "--absolute", "--png", png).status == 2

    outcome = run("image", made / "sim.h5", *files, "--absolute")
    assert outcome.status == 0, outcome.err
    volume = open_volume(target)
    expected = f"{volume.rcs_dbsm().max():.1f} dBsm"
    assert expected in page.read_text(encoding="utf-8")
    assert expected in run("inspect", target).out
    again = tmp_path / "again.png"
    assert run("image", target, "--png", again, "--dbsm").status == 0
    assert again.read_bytes().startswith(b"\x89PNG")
    assert check_file(target).ok


def test_inspect_names_the_scale_and_the_echo_of_s_parameters(run: Run, tmp_path: Path) -> None:
    q = clradar.arrays.qar50()
    array = clradar.AntennaArray(q.tx_m[::12], q.rx_m[::12])
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)
    wavelength_m = 299_792_458 / waveform.frequencies_hz
    length_m = np.linalg.norm(array.tx_m[:, None] * [1, 1, -1] + [0, 0, 0.6] - array.rx_m, axis=2)
    phase = np.exp(-2j * np.pi * length_m[..., None] / wavelength_m)
    samples = wavelength_m / (4 * np.pi) / length_m[..., None] * phase
    plate = clradar.Capture(samples, array, waveform, {"absolute": True})
    save_capture(tmp_path / "plate.h5", plate)
    facts = describe(tmp_path / "plate.h5").values
    assert facts["scale"] == {"absolute": True}
    # pi R^2 with R half the mean length, told to a bin of 4 mm. Lengths from 0.6 to 0.63 m, where
    # the mean profile (60 mm wide by the window) takes one, cost some tenths of a decibel.
    range_m = facts["strongest_echo"]["range_m"]
    assert range_m == pytest.approx(length_m.mean() / 2, abs=4e-3)
    found = facts["echo's_radar_cross_section"]["dbsm"]
    assert found == pytest.approx(10 * np.log10(np.pi * range_m**2), abs=0.5)


def test_images_by_iteration(run: Run, made: Path, tmp_path: Path) -> None:
    target, few = tmp_path / "v.h5", tmp_path / "few.h5"
    capture = open_capture(made / "sim.h5")
    tx_m, rx_m = (antennas_m[::8] for antennas_m in (capture.array.tx_m, capture.array.rx_m))
    array = clradar.AntennaArray(tx_m, rx_m)
    save_capture(few, clradar.Capture(capture.data[::8, ::8], array, capture.waveform))
    fit = ["--method", "sparse", "--iterations", "2", "--sparsity-db=-20"]
    outcome = run("image", few, "-o", target, *fit, *GRID)
    assert outcome.status == 0, outcome.err
    assert "sparse: 2 iterations, no more were asked for; left: " in outcome.out
    meta = open_volume(target).meta
    assert (meta["method"], meta["iterations"], meta["sparsity_db"]) == ("sparse", 2, -20)
    assert meta["residual_db"] < 0
