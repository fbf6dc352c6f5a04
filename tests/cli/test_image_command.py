"""``clradar image``, ``inspect``, ``export`` and ``convert``."""

import json
from dataclasses import replace
from pathlib import Path

import maroon_files as files
import numpy as np
import pytest
import trimesh
from command_line import GRID, Cli
from comparisons import same_capture, tree
from matplotlib.figure import Figure

import clradar
import clradar.plot
from clradar.cli.images import recording_title, title_of
from clradar.cli.options import GridOptions
from clradar.cli.parse import axis_mm
from clradar.errors import CompareError
from clradar.plot import capture_figure, recording_figure
from clradar.reference import point_targets
from measurement_io import (
    check_file,
    open_capture,
    open_volume,
    save_capture,
    save_recording,
    save_volume,
)


def test_axes_in_millimetres_and_the_default_grid_of_the_paper():
    assert axis_mm("--x-mm", "-100:100:1") == (-100.0, 100.0, 1.0)
    assert axis_mm("--x-mm", "300") == (300.0, 300.0, 1.0)
    assert axis_mm("--x-mm", "0:0.3:0.1") == (0.0, 0.3, 0.1)
    paper = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    assert GridOptions().grid().same_voxels(paper, tolerance_m=1e-15)


def test_image_of_a_recording(cli, place):
    cli.ok(f"image recording -o v.h5 --method exact --window hann {GRID}")
    volume = open_volume("v.h5")
    options = {"method": "exact", "window": "hann", "check_grid": False, "device": "pocl"}
    expected = clradar.backproject(open_capture("sim.h5"), volume.grid, **options)
    assert np.array_equal(volume.data, expected.data)
    assert [i["file"] for i in volume.meta["inputs"]] == ["000000.npy"]


def test_figures_of_recordings_are_titled_with_object_distance_variant_and_frame(
    cli, place, monkeypatch
):
    capture = open_capture("sim.h5")
    for frame in save_recording("hand/30", [capture, capture]).rglob("*.npy"):
        frame.rename(frame.with_stem(f"{frame.stem}_emptyfiltered"))
    titles = []
    monkeypatch.setattr(
        "clradar.plot.image_figure", lambda *given, **_: titles.append(given[1]) or Figure()
    )
    words, png = "hand, 30 cm, emptyfiltered, frame 1", f"--png {place}/v.png --force"
    chosen = f"--variant emptyfiltered --frame 1 {png} {GRID}"
    (frame_file,) = Path("hand/30").glob("*/*/000001_*.npy")
    cli.ok(f"image hand/30 -o v.h5 {chosen}")
    cli.ok(f"image {frame_file} {png} {GRID}")
    cli.ok(f"image v.h5 {png}")
    cli.ok(f"image volume.h5 {png}")
    monkeypatch.chdir("hand/30")
    cli.ok(f"image . {chosen}")
    assert titles == [words, words, f"v.h5: {words}", "volume.h5", words]
    assert recording_title({"capture": {"format": "maroon", "source": 3}}) == ""
    assert title_of(Path("lab.mat"), {"format": "layout", "frame": 2}) == "lab.mat, frame 2"


@pytest.mark.parametrize(
    ("name", "kind"),
    [("sim.h5", "native capture"), ("volume.h5", "native volume"), ("recording", "recording")],
)
def test_inspect(cli, place, monkeypatch, name, kind):
    assert f"{name}: {kind}" in cli.ok(f"inspect {name}").out.splitlines()[0]
    described = json.loads(cli.ok(f"inspect {name} --json").out)
    assert described["kind"] == kind
    assert described["facts"]["data"]["type"] == "complex64"
    assert described["problems"] == []
    assert "all right" in cli.ok(f"inspect {name} --check").out
    assert json.loads(cli.ok(f"inspect {name} --check --json").out)["ok"] is True
    monkeypatch.setenv("CLRADAR_DEVICE", "abacus")  # pictures need none
    cli.ok(f"inspect {name} --png x.png")
    assert Path("x.png").read_bytes()[:4] == b"\x89PNG"
    if name == "volume.h5":
        cli.ok(f"image {name} --png y.png")
        assert Path("x.png").read_bytes() == Path("y.png").read_bytes()
        cli.ok(f"inspect {name} --png slice.png --slice y=0")
        cli.fails(f"inspect {name} --png no.png --slice q", "--slice", status=2)
    else:
        cli.fails(f"inspect {name} --png no.png --view xz", "--view", status=2)


def test_a_capture_without_receptions_is_warned_of(cli, place):
    outcome = cli.ok("simulate hand.ply -o nothing.h5 --samples-per-mm2 1e-9")
    assert "clradar: warning: no ray reached a receiver" in outcome.err
    outcome = cli.ok(f"image nothing.h5 -o v.h5 {GRID} --png nothing.png")
    assert "zero everywhere" in outcome.err
    assert not Path("nothing.png").exists()
    assert "none above the noise" in cli.ok("inspect nothing.h5").out
    cli.fails("inspect nothing.h5 --png x.png", "zeros")


def test_a_slice_is_drawn_from_above_and_a_voxel_not_at_all(cli, place, monkeypatch):
    drawn = []
    monkeypatch.setattr("clradar.plot.save_figure", lambda figure, *_, **__: drawn.append(figure))
    across = "--x-mm=-60:60:6 --z-mm 280:320:5"
    for options, labels in (
        (f"--y-mm 0 {across}", ("x (mm)", "z (mm)")),
        (f"--y-mm=-60:60:6 {across} --view yz", ("z (mm)", "y (mm)")),
        (f"--y-mm 0 {across} --view xy", ("x (mm)", "y (mm)")),
    ):
        cli.ok(f"image sim.h5 -o v.h5 --png v.png --force {options}")
        first = drawn[-1].axes[0]
        assert (first.get_xlabel().lstrip("\N{LEFTWARDS ARROW} "), first.get_ylabel()) == labels
    outcome = cli.ok("image sim.h5 -o one.h5 --png one.png --x-mm 0 --y-mm 0 --z-mm 300")
    assert "one.png: not drawn, since the image is one voxel, of amplitude" in outcome.err
    outcome = cli.ok("image sim.h5 -o line.h5 --png line.png --x-mm 0 --y-mm 0 --z-mm 280:320:5")
    assert "line.png: not drawn, since the image is a line of 9 voxels" in outcome.err
    assert len(drawn) == 3
    assert open_volume("one.h5").data.size == 1


def thinned(every: int) -> clradar.AntennaArray:
    whole = clradar.arrays.qar50()
    return clradar.AntennaArray(whole.tx_m[::every], whole.rx_m[::every])


def test_a_capture_without_a_grid_is_imaged_where_its_echo_is(cli):
    sweep = clradar.Waveform.sfcw(72e9, 82e9, 128)
    far = clradar.room_capture(thinned(4), sweep, [], points_m=[[0, 0, 1.5]])
    save_capture("far.h5", far)
    outcome = cli.ok("image far.h5 -o v.h5")
    assert outcome.err == ""
    assert "grid: " in outcome.out
    volume = open_volume("v.h5")
    assert volume.grid.z_m[0] < 1.5 < volume.grid.z_m[-1]
    assert np.abs(volume.data).max() > 0.9
    outcome = cli.ok("image far.h5 -o w.h5 --z-mm 260:340:8 --x-mm=-80:80:8 --y-mm=-80:80:8")
    assert "clradar: warning: the strongest echo, at x 0.000, y 0.000, z 1.500 m" in outcome.err
    facts = json.loads(cli.ok("inspect far.h5 --json").out)["facts"]
    assert facts["range"]["resolution_m"] == pytest.approx(0.01499, rel=1e-3)
    assert facts["range"]["unambiguous_m"] == pytest.approx(1.9037, rel=1e-3)
    assert facts["strongest_echo"]["range_m"] == pytest.approx(1.5, abs=0.01)
    assert facts["strongest_echo"]["lateral_resolution_m"][0] == pytest.approx(0.021, rel=0.05)
    assert "unambiguous to 1.904 m" in cli("inspect far.h5").out


@pytest.mark.usefixtures("quickly")
def test_radar_cross_sections_of_samples_that_are_s_parameters(cli, place):
    line = f"image sim.h5 -o v.h5 --png v.png --report v.html --dbsm {GRID}"
    cli.fails(line, "sim.h5: expected S-parameters for --dbsm")
    assert not Path("v.h5").exists()
    cli.ok(f"{line} --absolute")
    expected = f"{open_volume('v.h5').rcs_dbsm().max():.1f} dBsm"
    page = Path("v.html").read_text(encoding="utf-8")
    assert all(part in page for part in (expected, "<h1>sim.h5</h1>"))
    assert "Metrics" not in page
    assert expected in cli.ok("inspect v.h5").out
    cli.ok("image v.h5 --png again.png --dbsm")


def test_inspect_names_the_scale_of_s_parameters(cli):
    samples = np.ones((2, 2, 8), np.complex64)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 8)
    save_capture("plate.h5", clradar.Capture(samples, thinned(47), waveform, {"absolute": True}))
    facts = json.loads(cli.ok("inspect plate.h5 --json").out)["facts"]
    assert facts["scale"] == {"absolute": True}


def test_images_by_iteration(cli, made):
    capture = open_capture(made / "sim.h5")
    data = capture.data[::8, ::8]
    save_capture("few.h5", clradar.Capture(data, thinned(8), capture.waveform))
    outcome = cli.ok(
        f"image few.h5 -o v.h5 --method sparse --iterations 2 --sparsity-db=-20 {GRID}"
    )
    assert "sparse: 2 iterations, ended by iterations; left: " in outcome.out
    meta = open_volume("v.h5").meta
    assert (meta["method"], meta["iterations"], meta["sparsity_db"]) == ("sparse", 2, -20)
    assert meta["residual_db"] < 0


# ---- pictures of captures and recordings

WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 64)


def echo(range_m: float, level: float = 1.0) -> clradar.Capture:
    """A target in the middle, seen by the imager's antennas; Tx 5 is dead."""
    point = ([[0, 0, range_m]], [level])
    seen = point_targets(clradar.arrays.qar50(), WAVEFORM, *point)
    return replace(seen, data=np.where(np.arange(94)[:, None, None] == 5, 0, seen.data))


def test_a_capture_shows_its_target_and_its_dead_channel():
    curve, pairs, _ = capture_figure(echo(0.4)).axes
    (line,) = curve.lines
    where_mm, level_db = np.array(line.get_data())
    # The antennas are some centimetres off the axis: paths are a little longer than twice 400 mm.
    assert where_mm[np.argmax(level_db)] == pytest.approx(405, abs=8)
    shown_db = pairs.images[0].get_array()
    assert np.flatnonzero((shown_db < -100).all(axis=1)).tolist() == [5]
    assert np.allclose(np.delete(shown_db, 5, axis=0), 0, atol=1e-4)
    with pytest.raises(CompareError, match="zeros"):
        capture_figure(echo(0.4, 0.0))


def test_a_recording_shows_how_its_target_moves():
    frames = [echo(0.3), echo(0.35, 0.5), echo(0.4)]
    echoes, level, _ = recording_figure(frames, [2, 3, 7]).axes
    (mesh,) = echoes.collections
    power_db, edges_mm = np.asarray(mesh.get_array()), np.asarray(mesh.get_coordinates())[:, 0, 1]
    found_mm = (edges_mm[1:] + edges_mm[:-1])[power_db.argmax(axis=0)] / 2
    assert np.diff(found_mm) == pytest.approx([50, 50], abs=8)
    (line,) = level.lines
    levels = [[2, 3, 7], [0, 20 * np.log10(0.5), 0]]
    assert np.array(line.get_data()) == pytest.approx(np.array(levels), abs=1e-3)


# ---- export


@pytest.fixture
def exported(cli: Cli) -> None:
    """A volume to export."""
    grid = clradar.VoxelGrid([-0.1, 0.2, 0.3], [1e-3, 2e-3, 5e-3], (5, 3, 4))
    data = np.arange(60).reshape(grid.shape) + 1j
    save_volume("volume.h5", clradar.Volume(data, grid, {"method": "exact"}))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("volume.h5 -o v.npz", "v.npz: volume, 5 x 3 x 4"),
        ("volume.h5 --dynamic-range-db 1 -o v.ply", "v.ply: depth map, 5 x 3"),
        ("volume.h5 --depth-map -o d.npz", "d.npz: depth map, 5 x 3"),
    ],
)
@pytest.mark.usefixtures("exported")
def test_what_goes_where(cli, line, said):
    assert cli.ok(f"export {line}").out == f"{said}\n"
    if "v.npz" in line:
        with np.load("v.npz") as file:
            provenance = json.loads(str(file["provenance"]))
        assert (provenance["method"], provenance["command"]) == ("exact", "export")
    elif "v.ply" in line:
        # 20 log10(45 / 59) = -2.4 dB and 52 / 59 = -1.1 dB: seven pixels are brighter than -1 dB.
        assert len(trimesh.load("v.ply", process=False).vertices) == 7


DATA = "radar_72.0_82.0_2/calibrated_data"
NAMES = ["000000", "000000_emptyfiltered", "000001", "000001_emptyfiltered"]


@pytest.fixture
def recording(cli: Cli) -> Path:
    """<object>/<distance> with two frames of both variants, and a mesh."""
    distance = Path("hand/30")
    files.write_recording(distance, n_frames=2)
    (distance / "metadata.json").write_bytes(b'{"distance_meters":  0.3}')
    (distance / "photogrammetry").mkdir()
    (distance / "photogrammetry" / "mesh.obj").write_bytes(b"v 1 2 3\n")
    return distance


def native(name: str, seed: int = 0, **meta: object) -> str:
    data = files.expected_data(files.random_frame(2, seed=seed))
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 2)
    save_capture(name, clradar.Capture(data, clradar.arrays.qar50(), waveform, meta))
    return name


def names(folder: str) -> list[str]:
    return sorted(path.name.removesuffix(".h5") for path in Path(folder).iterdir())


def test_all_frames(cli, recording):
    before = tree(recording)
    Path("kept").mkdir()
    Path("kept/000001.h5").write_bytes(b"precious")
    outcome = cli.ok("convert hand/30 -o a --all-frames")
    assert outcome.err == ""
    assert "2 raw frames, 2 emptyfiltered frames" in outcome.out
    assert names("a") == NAMES
    for name in NAMES:
        recorded = open_capture(recording / DATA / f"{name}.npy")
        capture = open_capture(f"a/{name}.h5")
        assert same_capture(capture, recorded)
        for key in ("timestamp_us", "variant"):
            assert capture.meta[key] == recorded.meta[key]
        assert [i["file"] for i in capture.meta["inputs"]] == [f"{name}.npy"]
    cli.ok("convert hand/30 -o b --all-frames --variant emptyfiltered")
    assert names("b") == NAMES[1::2]
    cli.fails("convert hand/30 -o kept --all-frames", "000001.h5", "--force")
    assert tree(Path("kept")) == {"000001.h5": b"precious"}
    cli.ok("convert hand/30 -o kept --all-frames --force")
    assert names("kept") == NAMES
    assert tree(recording) == before
    for path in (recording / DATA).glob("*_emptyfiltered*"):
        path.unlink()
    line = "convert hand/30 -o c --all-frames --variant emptyfiltered"
    cli.fails(line, "emptyfiltered")


def test_all_frames_skips_damaged_frames(cli, recording):
    bad = recording / DATA / "000000.npy"
    bad.write_bytes(bad.read_bytes()[:-1000])
    outcome = cli("convert hand/30 -o a --all-frames")
    assert (outcome.status, outcome.out) == (1, "")
    warning, summary = outcome.err.splitlines()
    assert "warning" in warning
    assert "000000.npy" in warning
    assert "3 of 4 frames converted" in summary
    assert names("a") == NAMES[1:]
    assert all(check_file(path).ok for path in Path("a").iterdir())
    for path in (recording / DATA).iterdir():
        path.write_bytes(b"")
    outcome = cli("convert hand/30 -o b --all-frames")
    assert (outcome.status, len(outcome.err.splitlines())) == (1, 5)
    assert "0 of 4 frames converted" in outcome.err
    assert not Path("b").exists()


def test_one_capture_to_a_recording_and_back(cli):
    native("sim.h5", note="a hand", rays={"paths": 3}, gain=7)
    Path("new").mkdir()
    outcome = cli.ok("convert sim.h5 -o new/30 --to maroon")
    assert "1 frame" in outcome.out
    cli.ok("convert new/30 -o back.h5")
    back = open_capture("back.h5")
    assert same_capture(back, open_capture("sim.h5"))
    assert (back.meta["note"], back.meta["gain"]) == ("a hand", 7)
    record = json.loads(open_capture("new/30").meta["provenance"])
    assert (record["rays"], record["command"]) == ({"paths": 3}, "convert")
    assert [i["file"] for i in record["inputs"]] == ["sim.h5"]
    native("other.h5", seed=1)
    assert "2 frames" in cli.ok("convert sim.h5 other.h5 -o both --to maroon").out
    assert same_capture(open_capture("both", frame=1), open_capture("other.h5"))
    sizes = []  # provenance grows by the same amount with every conversion
    for _ in range(5):
        cli.ok("convert back.h5 --to maroon -o 30 --force")
        cli.ok("convert 30 -o back.h5 --force")
        sizes.append(len(json.dumps(dict(open_capture("back.h5").meta))))
    growth = np.diff(sizes)
    assert growth.max() < 1.2 * growth.min() + 100
