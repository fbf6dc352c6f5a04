"""``clradar demo``: the whole chain at a small size, and its files."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import exit_status
from quick_figures import draw_quickly, seek_no_lobes

import clradar
from clradar.arrays.array_file import array_text
from clradar.cli.commands import demo
from clradar.cli.options.measured import RadarOptions
from clradar.hand import hand_mesh
from clradar.hand.flesh import PART_NAMES
from measurement_io import check_file, open_capture, open_volume

# With so few rays the wrist, which the paper's grid cuts, is as bright as the palm.
pytestmark = pytest.mark.filterwarnings("ignore:the grid cuts:clradar.ClradarWarning")

COLUMNS = ("alpha_0", "alpha_0.5", "alpha_1", "physical")
RAYS = {"samples_per_mm2": 1.0, "rays_per_sample": 2}
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With every third antenna, a quarter of the frequencies, and a coarse hand."""
    folder, whole = tmp_path_factory.mktemp("small"), clradar.arrays.qar50()
    array = clradar.AntennaArray(whole.tx_m[::3], whole.rx_m[::3])
    (folder / "array.toml").write_text(array_text(array))
    radar = RadarOptions(band=(72, 82, 33), array=str(folder / "array.toml"))
    (folder / "demo").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clradar.hand.hand_mesh", partial(hand_mesh, edge_length_m=4e-3))
        seek_no_lobes(patch)
        draw_quickly(patch)
        demo.run_demo(folder / "demo", radar, GRID, clradar.open_device("pocl"), **RAYS)
    return folder / "demo"


def test_files(small: Path) -> None:
    names = {p.name for p in small.iterdir()}
    images = {f"{n}_volume.h5" for n in ("measurement", *COLUMNS)}
    captures = {f"{n}.h5" for n in COLUMNS}
    rest = {"hand_f.ply", "measurement", "comparison.png", "metrics.json"}
    assert names == images | captures | rest
    for name in [*images, *captures, "measurement"]:
        assert check_file(small / name).ok
    for name in images:
        assert open_volume(small / name).grid.same_voxels(GRID)


def test_metrics_name_alphas_and_materials(small: Path) -> None:
    record = json.loads((small / "metrics.json").read_text())
    alpha = "\N{GREEK SMALL LETTER ALPHA}"
    labels = [s["label"] for s in record["simulated"]]
    assert labels == [f"{alpha} = 0", f"{alpha} = 0.5", f"{alpha} = 1", "skin and palm"]
    assert record["clradar"] == clradar.__version__
    assert record["options"]["rays"] == RAYS
    # The measurement has the same materials, but another texture: no pixel of it is predicted.
    assert record["simulated"][3]["metrics"]["overlap"] > 0.9


def test_captures_of_the_demo_are_those_of_the_library(small: Path) -> None:
    scene = clradar.Scene.from_mesh(small / "hand_f.ply", alpha=0.5)
    made_of = scene.with_material({p: "palm" if p == "palm" else "skin" for p in PART_NAMES})
    for name, again, settings in (
        ("alpha_0.5", scene, RAYS),
        ("physical", made_of, {"estimator": "physical"}),
    ):
        capture = open_capture(small / f"{name}.h5")
        found = clradar.simulate(
            again, capture.array, capture.waveform, **settings, seed=0, device="pocl"
        )
        assert np.array_equal(found.data, capture.data)


@pytest.mark.parametrize("full", [False, True])
def test_command(
    full: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calls = []
    monkeypatch.setattr(demo, "run_demo", lambda *given: calls.append(given))
    monkeypatch.chdir(tmp_path)
    arguments = ["demo", "--full"] if full else ["demo"]

    assert exit_status(*arguments) == 0
    ((folder, _, grid, _),) = calls
    assert folder == Path("demo")
    assert grid.spacing_m[0] == pytest.approx(1e-3 if full else 2e-3)
    printed = capsys.readouterr().out
    assert f"{'201 x 201 x 81' if full else '101 x 101 x 41'} voxels" in printed

    (tmp_path / "demo" / "notes.txt").write_text("mine")
    assert exit_status(*arguments) == 1
    assert capsys.readouterr().err.startswith("clradar: error: demo: holds files already")
    arguments.append("--force")
    assert exit_status(*arguments) == 0
    assert (tmp_path / "demo" / "notes.txt").read_text() == "mine"
